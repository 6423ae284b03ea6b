"""Hypotheses about frames: swapped, lost, repeated, replaced and torn ones.

| file             | holds                                                                              |
|------------------|------------------------------------------------------------------------------------|
| `integrity`      | `check`: frames that are not those described, named                                |
| `spoilt`         | `Finding`: frames that a code can do without, pixels that a wrong one could spoil  |
| `contradictions` | captures of another description: codes of a pixel that contradict each other       |
| `sample_fit`     | places and misfit of single pixels, by each axis                                   |
"""

#: Inside of decode its files are imported one by one: none of their names is public.
__all__: list[str] = []
