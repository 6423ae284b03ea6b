"""The paper's method, apart from the product's.

| file | holds |
|---|---|
| `recursion` | the paper's recursion |
| `paper_equations` | its equations |
| `paper_scene` | the same on a scene |
"""

#: Inside of reconstruct its files are imported one by one: none of their names is public.
__all__: list[str] = []
