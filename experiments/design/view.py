"""What a camera pixel has to work with: where it looks, how large it is on the pattern, how much light
comes back.

Traced on every stride-th pixel of the camera, the pattern as it is: the geometry of the full sensor at
the cost of a small one. Heights of independent pixel noise then scale with the pixels' distance; see
`sensitivity`.
"""

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from optolever.projector import NOMINAL_SENSOR
from optolever.scene import Scene, Surface, Trace, movement, resize, scene_window, trace

__all__ = ["Levels", "View", "stride_for", "view_of"]

Floats = NDArray[np.float64]
T = TypeVar("T")
FINEST = 128  # pixels along the shorter side above which the camera is thinned


@dataclass(frozen=True, slots=True)
class Levels:
    """Light as the camera's 8-bit levels, and their noise: variance = read2 + shot * (level - dark).

    half: (H, W) levels from mid grey to white of a pattern that nothing blurs; dark: level without light.
    """

    half: Floats
    dark: float
    read2: float
    shot: float

    def variance(self, level: Floats | float) -> Floats:
        """Variance of one sample at a level above dark."""
        return np.asarray(self.read2 + self.shot * np.maximum(level, 0.0))


@dataclass(frozen=True, slots=True)
class View:
    """A thinned camera (scene.camera) before the whole pattern.

    truth: exact trace of its pixels; widths: per axis 'u', 'v' the extent in cells of an unthinned pixel
    along its columns and its rows, each (H, W); light: reflectance, 0 where no pattern is seen; stride:
    pixels of the full camera between two of these.
    """

    scene: Scene
    truth: Trace
    widths: dict[str, tuple[Floats, Floats]]
    light: Floats
    stride: float
    _kept: dict[Hashable, object] = field(default_factory=dict, init=False, repr=False, compare=False)

    def kept(self, key: Hashable, make: Callable[[], T]) -> T:
        """What `make` returns, made once for a key: sequences share their periods."""
        if key not in self._kept:
            self._kept[key] = make()
        return self._kept[key]  # type: ignore[return-value]

    @property
    def visible(self) -> NDArray[np.bool_]:
        """Pixels that see the pattern."""
        return self.truth.visible

    def extent(self, axis: str) -> int:
        """Cells along an axis."""
        return self.scene.pattern.cols if axis == "u" else self.scene.pattern.rows

    def coordinate(self, axis: str) -> Floats:
        """True coordinate, cells."""
        return self.truth.u if axis == "u" else self.truth.v

    def bend(self, axis: str) -> Floats:
        """Second differences of the coordinate between unthinned pixels, along and across, added up (cells,
        (H, W)); 0 beside what sees nothing."""
        at = self.coordinate(axis)
        along, across = np.zeros(at.shape), np.zeros(at.shape)
        along[:, 1:-1] = np.abs(np.diff(at, 2, axis=1))
        across[1:-1] = np.abs(np.diff(at, 2, axis=0))
        return (np.nan_to_num(along) + np.nan_to_num(across)) / self.stride**2

    def gradient(self, axis: str, along: int, reach: int) -> Floats:
        """Change of the coordinate per unthinned pixel, from its mean over `reach` of them on either side."""
        at, apart = self.coordinate(axis), max(1, round(reach / self.stride))
        place = np.arange(at.shape[along])
        low, high = np.maximum(place - apart, 0), np.minimum(place + apart, len(place) - 1)
        change = np.abs(np.take(at, high, along) - np.take(at, low, along))
        steps = (high - low) * self.stride
        return np.nan_to_num(change / (steps if along == 1 else steps[:, None]))

    def levels(self, noise: float) -> Levels:
        """Levels under added Gaussian noise (rms, 8-bit levels) and the sensor's own."""
        sensor = self.scene.sensor or NOMINAL_SENSOR
        dark = float(sensor.levels(np.zeros(1))[0])
        black = 0.0 if self.scene.display is None else self.scene.display.black
        half = 0.5 * (np.minimum(sensor.levels(self.light), 255.0) - sensor.levels(black * self.light))
        step = 255 / (2**sensor.bits - 1)
        read2 = noise**2 + sensor.noise**2 + step**2 / 12
        return Levels(half, dark, read2, 1 / sensor.gain_e if sensor.gain_e > 0 else 0.0)


def stride_for(scene: Scene, finest: int = FINEST) -> int:
    """How much to thin a camera so that its shorter side keeps at least `finest` pixels."""
    return max(1, min(scene.camera.rows, scene.camera.cols) // finest)


def view_of(scene: Scene, surface: Surface, stride: int = 1) -> View:
    """Trace every stride-th pixel (sizes are rounded; the field of view stays)."""
    rows, cols = (max(8, round(n / stride)) for n in (scene.camera.rows, scene.camera.cols))
    thin = scene if stride == 1 else replace(resize(scene, rows, cols), pattern=scene.pattern)
    truth = trace(thin, surface)
    by = scene.camera.cols / thin.camera.cols, scene.camera.rows / thin.camera.rows
    along, across = _ends(thin, surface, 0.0, 0.5 / by[0]), _ends(thin, surface, 0.5 / by[1], 0.0)
    widths = {axis: (_extent(truth, axis, *along), _extent(truth, axis, *across)) for axis in ("u", "v")}
    light = np.where(truth.visible, 1.0, 0.0)
    if scene.medium is not None:
        cosine = np.cos(np.where(truth.visible, truth.incidence, 0.0))
        light = np.where(truth.visible, scene.medium.reflectance(cosine), 0.0)
    return View(thin, truth, widths, light, float(np.sqrt(by[0] * by[1])))


def _ends(scene: Scene, surface: Surface, down: float, right: float) -> tuple[Trace, Trace]:
    """What is seen so far before and behind every pixel's middle (fractions of a pixel)."""
    rows, cols = scene.camera.rows, scene.camera.cols
    before, behind = (
        trace(scene_window(scene, way * down, way * right, rows, cols), surface) for way in (-1, 1)
    )
    return before, behind


def _extent(middle: Trace, axis: str, before: Trace, behind: Trace) -> Floats:
    """|change of a coordinate| between the ends of a pixel."""
    return np.abs(movement(*(getattr(seen, axis) for seen in (before, middle, behind))))
