"""Variance of the height by noise, and its budget.

| file | holds |
|---|---|
| `closed_form` | variance of the height on a rectangle |
| `monte_carlo` | the response of the height to an error field; its variance by drawn noise |
| `sources` | the list of the sources of noise, whose variances add up; errors by a lens that was not given |
| `budget` | the uncertainty of a height, a depth, a difference, by its sources |
| `null_space` | height modes without a slope |
"""

#: Inside of reconstruct its files are imported one by one: none of their names is public.
__all__: list[str] = []
