"""Plain gradient fields: `integrate` and its family of solvers.

| file | holds |
|---|---|
| `integrate` | integrate(), its solvers by name |
"""

#: Inside of reconstruct its files are imported one by one: none of their names is public.
__all__: list[str] = []
