"""Hypotheses about frames: swapped, lost, repeated, replaced and torn ones.

| file             | holds                                                                              |
|------------------|------------------------------------------------------------------------------------|
| `integrity`      | `check`: names frames that contradict the sequence                                 |
| `spoilt`         | `Finding`: redundant frames of a code, pixels that a wrong frame may affect        |
| `contradictions` | captures of another description: codes of a pixel that contradict each other       |
| `sample_fit`     | place and misfit of single pixels, per axis                                        |
"""

#: Inside decode these files are imported one by one: none of their names is public.
__all__: list[str] = []
