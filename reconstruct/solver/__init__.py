"""Equations of the mirror's slopes, and their solution for the height.

| file | holds |
|---|---|
| `equations` | slopes of the mirror per pixel, in closed form, and their variances |
| `edges` | increments along pixel edges, weights, and the operators on them |
| `newton` | Newton's method with an integrating factor |
| `poisson` | weighted Poisson by columns (DCT and tridiagonal) |
| `linear` | choice of the solver |
| `masked` | any mask, any weights: conjugate gradients |
| `multigrid`, `multigrid_kernels` | their preconditioner and its kernels |
| `alternatives` | sparse factorisation and marching |
| `anchors` | what is known of the mirror's height |
| `gauge` | the free constant of every component, from the anchors |
"""

#: Inside of reconstruct its files are imported one by one: none of their names is public.
__all__: list[str] = []
