"""Which slopes and edges are in doubt; which maps are.

| file | holds |
|---|---|
| `circulation` | chi2 of slopes that contradict each other |
| `discontinuities` | edges in doubt: cusps, ridges, rims, gaps; what they part from the anchors |
| `holes` | small holes bridged |
| `map_tests` | the tests of a map: figure, limit, words |
| `reweighting` | robust reweighting; wrong pixels |
"""

#: Inside of reconstruct its files are imported one by one: none of their names is public.
__all__: list[str] = []
