"""A rig at rest, prepared for live frames, and what has moved since.

| file | holds |
|---|---|
| `prepare`, `prepared` | prepare(): precomputation for a rig at rest; its record and file |
| `rig_errors` | common error of heights by the rig's numbers |
| `rig_motion` | the picture's shift and roll, and the load at the mirror's edge, in one fit |
"""

#: Inside of live its files are imported one by one: none of their names is public.
__all__: list[str] = []
