"""What a camera sees of a scene: the images that are decoded, and the maps that are solved.

A small camera is decoded whole. Of a large one every stride-th pixel is solved; what is decoded are windows
of BLOCK x BLOCK neighbouring pixels, one amid each BLOCK x BLOCK of those, set side by side in one image. The
error of a window's pixel stands for that of a pixel of the thinned camera: noise and everything that changes
from pixel to pixel then do to the thinned camera's height what they do to the whole one's, times the distance
of the pixels (see `sensitivity`). Errors that change more slowly than a window are not told.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from optolever.patterns import Frame, Sequence
from optolever.projector import NOMINAL_SENSOR, Footprints, footprints, light_of
from optolever.scene import Scene, Sensor, Surface, Trace, resize, trace

__all__ = ["Floats", "Mask", "View", "stride_for", "thinned", "view_of"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
FINEST = 128  # pixels along the shorter side above which a camera is thinned
BLOCK, MARGIN = 24, 4  # pixels of a window, and of its rim, which is decoded but not used
BORDER = 0.01  # light lost beyond the pattern's border from which on a pixel is left out of every figure


@dataclass(frozen=True, eq=False)
class View:
    """A camera before the pattern. scene, truth: whose pixels (H, W) are solved; image: what is decoded, of
    `shape` pixels; centre (2, pixels): what their centres see, u and v; pick (H, W): its pixel whose error
    stands for one that is solved; stride: pixels of the whole camera between two that are solved."""

    scene: Scene
    truth: Trace
    image: Footprints
    centre: Floats
    shape: tuple[int, int]
    pick: NDArray[np.intp]
    stride: float

    @property
    def visible(self) -> Mask:
        """Pixels (H, W) that see the pattern."""
        return np.asarray(self.truth.visible & (self.image.light[self.pick] > 0))

    @property
    def sensor(self) -> Sensor:
        """The scene's, or the one of a scene that names none."""
        return self.scene.sensor or NOMINAL_SENSOR

    @cached_property
    def usable(self) -> Mask:
        """Pixels (H, W) that the pattern's border does not touch: those that count. Beside it light is
        missing that a white, endless pattern would send."""
        pattern = self.scene.pattern
        white = Sequence((Frame("white"),), pattern.rows, pattern.cols)
        seen = light_of(self.image, white, None, pattern.blur_px)[0][self.pick]
        return np.asarray(self.visible & (seen > (1 - BORDER) * self.image.light[self.pick]))


def stride_for(scene: Scene, finest: int = FINEST) -> int:
    """How much to thin a camera so that its shorter side keeps at least `finest` pixels."""
    return max(1, min(scene.camera.rows, scene.camera.cols) // finest)


def view_of(scene: Scene, surface: Surface, stride: int = 1) -> View:
    """The view of a mirror of that shape."""
    rows, cols = scene.camera.rows, scene.camera.cols
    image, shape = footprints(scene, surface, 0, rows), (rows, cols)
    pick = np.arange(rows * cols).reshape(shape)
    truth = trace(scene, surface)
    whole = View(scene, truth, image, _centre(truth), shape, pick, 1.0)
    if stride == 1:
        return whole
    thin_rows, thin_cols = (max(8, round(n / stride)) for n in shape)
    thin = replace(resize(scene, thin_rows, thin_cols), pattern=scene.pattern)
    return thinned(whole, thin, trace(thin, surface))


def thinned(whole: View, scene: Scene, truth: Trace) -> View:
    """Of a whole camera's view that of a thinned one: its scene, and the truth of its pixels."""
    size, full = truth.u.shape, whole.shape
    (down, rows), (across, cols) = (_windows(n, few) for n, few in zip(full, size, strict=True))
    index = (down[:, None] * full[1] + across).ravel()
    image = Footprints(
        *(getattr(whole.image, name)[index] for name in ("u", "v", "light", "boxes_u", "boxes_v"))
    )
    stride = float(np.sqrt(full[0] / size[0] * full[1] / size[1]))
    pick = rows[:, None] * len(across) + cols
    return View(scene, truth, image, whole.centre[:, index], (len(down), len(across)), pick, stride)


def _centre(truth: Trace) -> Floats:
    return np.stack([truth.u.ravel(), truth.v.ravel()])


def _windows(full: int, few: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Of `full` rows those that are decoded, and (few,) the place among them of each that is solved."""
    taken, pick, used = [], [], 0
    for part in np.array_split(np.arange(few), -(-few // BLOCK)):
        size = min(full, len(part) + 2 * MARGIN)
        middle = (part[0] + part[-1] + 1) / 2 * full / few
        first = int(np.clip(round(middle - size / 2), 0, full - size))
        taken.append(np.arange(first, first + size))
        pick.append(used + (size - len(part)) // 2 + np.arange(len(part)))
        used += size
    return np.concatenate(taken), np.concatenate(pick)
