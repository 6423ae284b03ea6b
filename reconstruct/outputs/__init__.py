"""A height map on a regular grid, its derivatives, and files.

| file | holds |
|---|---|
| `resampling` | the regular grid, with conserved sigma |
| `slope_map` | slopes from the normals, with sigma |
| `curvature` | curvature from the slopes, with sigma |
"""

#: Inside of reconstruct its files are imported one by one: none of their names is public.
__all__: list[str] = []
