"""Plain gradient fields: `integrate` and its family of solvers.

| file | holds |
|---|---|
| `integrate` | integrate(), its solvers by name |
| `quadrilateral` | edge increments of pixels that lie anywhere |
"""

#: Inside of reconstruct its files are imported one by one: none of their names is public.
__all__: list[str] = []
