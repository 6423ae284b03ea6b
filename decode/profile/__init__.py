"""Properties common to all frames of one rig, estimated from a sample of a capture's illuminated pixels.

| file             | holds                                                                              |
|------------------|------------------------------------------------------------------------------------|
| `noise`          | photon transfer on the constraints of a sequence; illuminated pixels               |
| `shared_noise`   | noise common to a row, to a column, to a frame                                     |
| `moved`          | shift of frames by vibration or steady motion of the rig                           |
| `unlike`         | lag of a slow display; misfit within and between fringes                           |
| `pixelation`     | shifts by the display's cells: blur from the map, correction, residual variance    |
| `lens`           | lens blur, from the contrast of fringes where the map is steep                     |
| `border`         | light that is missing at the display's border, and the blur from it                |
| `ends`           | edge blur at the mirror's ends, and the variance that it adds                      |
| `edge_lines`     | outermost lines of an image, shifted by the camera's filters                       |
"""

#: Inside decode these files are imported one by one: none of their names is public.
__all__: list[str] = []
