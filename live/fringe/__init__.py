"""The picture of a crossed fringe, and one frame of it to a height.

| file | holds |
|---|---|
| `picture` | model of the image, and Gauss-Newton steps of its fit |
| `unwrap` | phase unwrapping of the displacement |
| `chord` | a step of the coupled equations of height and slope |
| `rays_at_rest` | rays and anchor on cells, linearised at rest |
| `chain` | one frame, from the image to the height |
| `strays` | pixels that do not show the fringe |
| `circulation` | circulation of the slopes: their inconsistency |
"""

#: Inside of live its files are imported one by one: none of their names is public.
__all__: list[str] = []
