"""Codes of one axis: from levels of a row to places.

| file     | holds                                                                                  |
|----------|----------------------------------------------------------------------------------------|
| `fringe` | phase, its variance, amplitude, residual; harmonics and aliasing                       |
| `bits`   | interval of the cells that stay possible                                               |
| `orders` | fringe orders: ladder, close periods; their posterior                                  |
| `match`  | samples of a pixel against codewords, compiled                                         |
| `lookup` | known levels: stripes, micro phase, free grey values                                   |
"""

#: Inside decode these files are imported one by one: none of their names is public.
__all__: list[str] = []
