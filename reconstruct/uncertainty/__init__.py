"""Variance of the height by noise, and its budget.

| file | holds |
|---|---|
| `monte_carlo` | the response of the height to an error field; its variance by drawn noise |
| `sources` | sources of noise, whose variances add up; the closed form on a rectangle; an unknown lens |
| `budget` | the uncertainty of a height, a depth, a difference, by its sources |
| `null_space` | height modes without a slope |
"""

#: Inside of reconstruct its files are imported one by one: none of their names is public.
__all__: list[str] = []
