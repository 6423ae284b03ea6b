"""The linear and nonlinear solution of the mirror's equations for the height.

| file | holds |
|---|---|
| `edges` | increments along pixel edges, weights, and the operators on them |
| `newton` | Newton's method with an integrating factor |
| `poisson` | weighted Poisson: by columns (DCT and tridiagonal), or with any mask (conjugate gradients) |
| `multigrid` | the preconditioner of these |
| `anchors` | what is known of the mirror's height, and the free constant of every component from it |
"""

#: Inside of reconstruct its files are imported one by one: none of their names is public.
__all__: list[str] = []
