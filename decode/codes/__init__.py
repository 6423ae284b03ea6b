"""From frames of one axis to an `Estimate`: place, variance, chance of a wrong order.

| file             | holds                                                                              |
|------------------|------------------------------------------------------------------------------------|
| `phase`          | N-step least squares: phase, variance, amplitude, chi2                             |
| `unwrap`         | fringe orders from coarse to fine, from a code or, of close periods, by a table    |
| `gray`           | bits -> word -> cell, posterior of a wrong bit                                     |
| `bit_levels`     | which bits are resolved; their levels behind a blur; posterior of a pixel's words  |
| `harmonics`      | variance of a phase by harmonics that few steps hide                               |
| `lookup`, `lookup_tables` | any known levels: stripes, free grey values, codes within cells; tables   |
| `lookup_kernels`, `lookup_light` | its loops, batch by batch; rows of frames as they read them       |
| `lookup_search`  | its codewords; one pixel among them                                                |
"""

#: Inside of decode its files are imported one by one: none of their names is public.
__all__: list[str] = []
