"""From frames of one axis to an `Estimate`: place, variance, probability of a wrong order.

| file             | holds                                                                              |
|------------------|------------------------------------------------------------------------------------|
| `phase`          | N-step least squares: phase, variance, amplitude, chi2                             |
| `unwrap`         | fringe orders from coarse to fine, from a code or, of close periods, by a table    |
| `gray`           | bits -> word -> cell, posterior of a wrong bit                                     |
| `bit_levels`     | resolved bits; their levels behind a blur; posterior of a pixel's words            |
| `harmonics`      | variance of a phase by aliased harmonics                                           |
| `lookup`, `lookup_tables` | any known levels: stripes, free grey values, codes within cells; tables   |
| `lookup_kernels`, `lookup_light` | loops over batches of pixels; conversion of frames to samples      |
| `lookup_search`  | codewords, and the search of one pixel among them                                  |
"""

#: Inside decode these files are imported one by one: none of their names is public.
__all__: list[str] = []
