"""An independent renderer of colour pictures: light of every stripe of every cell, integrated over pixels.

It knows no frames and no fringes: only the pictures that a display gets, where its stripes are, and where the
pixels of a camera look on a flat mirror, whose map to the pattern is affine along both axes.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from optolever.patterns import Sequence
from optolever.scene import Scene, dent_from_text, trace

Floats = NDArray[np.float64]
MIX = np.array([[0.86, 0.12, 0.02], [0.10, 0.80, 0.10], [0.02, 0.12, 0.86]])
#: Samples of a cell, a multiple of three stripes; parts of a pixel.
_FINE, _PARTS = 48, 24


def seen_pictures(
    scene: Scene,
    shown: Sequence,
    stripes: str | None,
    rows: int,
    cols: int,
    gammas: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> Floats:
    """Light (E, rows, cols, 3) of 1 at white on the pixels of a camera over the scene's field of view."""
    place = trace(scene, dent_from_text("flat", scene))
    u = np.interp((np.arange(cols * _PARTS) + 0.5) / (cols * _PARTS), *_line(place.u[scene.camera.rows // 2]))
    v = np.interp(
        (np.arange(rows * _PARTS) + 0.5) / (rows * _PARTS), *_line(place.v[:, scene.camera.cols // 2])
    )
    seen = []
    for picture in shown.pictures():
        light = (picture.astype(np.float64) / 255) ** np.array(gammas)
        channels = []
        for channel in range(3):
            # every frame is the product of a row and a column, up to the rounding of its levels
            row, col = light[..., channel].max(axis=0), light[..., channel].max(axis=1)
            most = max(light[..., channel].max(), 1e-9)
            along = _integrated(
                row, u, scene.pattern.blur_px, None if stripes is None else stripes.index("rgb"[channel])
            )
            down = _integrated(col, v, scene.pattern.blur_px, None)
            channels.append(down[:, None] * along[None, :] / most)
        seen.append(np.tensordot(np.stack(channels, axis=-1), MIX.T, 1))
    return np.array(seen)


def _line(places: Floats) -> tuple[Floats, Floats]:
    """Share of the field of view and place, by a line through pixels' centres."""
    at = (np.arange(len(places)) + 0.5) / len(places)
    ok = np.isfinite(places)
    line = np.polyfit(at[ok], places[ok], 1)
    assert np.abs(np.polyval(line, at[ok]) - places[ok]).max() < 0.01
    ends = np.array([0.0, 1.0])
    return ends, np.polyval(line, ends)


def _integrated(levels: Floats, at: Floats, blur: float, third: int | None) -> Floats:
    """Means over the parts of each pixel of the light of cells, of which a third is lit if it is named."""
    lit = np.ones(_FINE)
    if third is not None:
        lit = 3.0 * (np.arange(_FINE) * 3 // _FINE == third)
    fine = gaussian_filter1d(np.kron(levels, lit), blur * _FINE, mode="constant", truncate=6)
    centres = (np.arange(fine.size) + 0.5) / _FINE - 0.5
    return np.interp(at, centres, fine, 0.0, 0.0).reshape(-1, _PARTS).mean(axis=1)
