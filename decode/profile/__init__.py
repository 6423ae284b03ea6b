"""What all frames of one rig have in common, estimated from a sample of a capture's lit pixels.

| file             | holds                                                                              |
|------------------|------------------------------------------------------------------------------------|
| `noise`          | photon transfer on the constraints of a sequence; pixels that see the pattern      |
| `shared_noise`   | noise that the pixels of a row, of a column, of a whole frame share                |
| `moved`          | shift of whole frames: a rig that shakes, or moves steadily                        |
| `unlike`         | lag of a slow display; misfit within and between fringes                           |
| `pixelation`     | shifts by the display's cells: blur by the map, taken off, and what stays unsure   |
| `lens`           | a lens's blur, by the contrast that it takes from fringes where the map is steep   |
| `border`         | light missing beside the display's border, and the blur that it shows              |
| `ends`           | what a lens's blur mixes into pixels beside the mirror's ends                      |
| `edge_lines`     | outermost lines of an image that a camera's filter made of repeated pixels         |
"""

#: Inside of decode its files are imported one by one: none of their names is public.
__all__: list[str] = []
