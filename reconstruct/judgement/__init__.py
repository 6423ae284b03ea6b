"""Which slopes and edges are in doubt.

| file | holds |
|---|---|
| `curl` | wrong pixels, by the curl of the slopes |
| `circulation` | by how much slopes contradict each other, which sigma then holds |
| `discontinuities` | edges whose increment is in doubt: cusps, ridges, rims, wrong pixels |
| `islands` | pixels that doubtful edges part from the anchors |
| `holes`, `gaps` | small holes bridged; the doubt of the edges across them |
| `reweighting` | robust reweighting |
"""

#: Inside of reconstruct its files are imported one by one: none of their names is public.
__all__: list[str] = []
