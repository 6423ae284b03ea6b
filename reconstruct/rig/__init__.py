"""Errors of the rig in the height.

| file | holds |
|---|---|
| `model` | modes by the errors of the rig; whether these explain the slopes |
| `hypotheses` | mistakes in a description, tried one by one |
| `since_rest` | motion between rest and press; the picture's shift by it, which may be the mirror's sinking |
| `calibration` | a rest capture as reference; errors that are no numbers of the scene: cover glass, gauge |
"""

#: Inside of reconstruct its files are imported one by one: none of their names is public.
__all__: list[str] = []
