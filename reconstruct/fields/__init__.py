"""Plain gradient fields: `integrate` and its family of solvers.

| file | holds |
|---|---|
| `integrate` | integrate() |
| `integrators` | the family of solvers |
| `rectangle` | the same on a rectangle, by two cosine transforms |
| `quadrilateral` | the same for pixels that lie anywhere |
"""

#: Inside of reconstruct its files are imported one by one: none of their names is public.
__all__: list[str] = []
