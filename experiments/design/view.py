"""What a camera sees of a scene: the images that are decoded, and the maps that are solved.

A small camera is decoded whole. Of a large one every stride-th pixel is solved; what is decoded are windows
of BLOCK x BLOCK neighbouring pixels, one amid each BLOCK x BLOCK of those, set side by side in one image. The
error of a window's pixel stands for that of a pixel of the thinned camera: noise and everything that changes
from pixel to pixel then do to the thinned camera's height what they do to the whole one's, times the distance
of the pixels (see `sensitivity`). Errors that change more slowly than a window are not told.

A sequence is worth what the decoder makes of these images, before a frame is taken. They are those of the
virtual sensor: its light (footprint, blur, reflectance, border, the display's response), the sensor's levels,
noise and rounding. Noise is drawn in pairs of opposite sign: half the difference of two errors is what noise
does, half their sum what it does not.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from optolever.decode import Correspondence, Flag, decode
from optolever.errors import InputError
from optolever.patterns import Frame, Sequence
from optolever.projector import NOMINAL_SENSOR, Footprints, footprints, light_of
from optolever.scene import Scene, Sensor, Surface, Trace, resize, trace

from ..arrays import Floats, Mask
from ..metrics import rms

FINEST = 128  # pixels along the shorter side above which a camera is thinned
BLOCK, MARGIN = 24, 4  # pixels of a window, and of its rim, which is decoded but not used
BORDER = 0.01  # light lost beyond the pattern's border from which on a pixel is left out of every figure
#: Stated sigmas, and cells, beyond which an error is a wrong order or bit.
GROSS = 6.0, 1.0


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
    whole = View(scene, truth, image, np.stack([truth.u.ravel(), truth.v.ravel()]), shape, pick, 1.0)
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


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Draws of a sequence in a view, two by two of opposite noise. error, sigma (D, 2, H, W): of u and v and
    as the decoder states it, cells, 0 and inf where a pixel is refused; good (D, H, W): whether it is not;
    usable (H, W): pixels over which errors are taken."""

    error: Floats
    sigma: Floats
    good: Mask
    usable: Mask

    @property
    def failure(self) -> float:
        """Share of the usable pixels with a wrong order or bit that nobody flags."""
        far, cells = GROSS
        size = np.abs(self.error)
        gross = (size > cells) & (size > far * self.sigma)
        return float(np.asarray(gross.any(axis=1))[:, self.usable].mean())

    @property
    def rms(self) -> float:
        """Of the errors over the usable pixels that are not refused, cells."""
        error = self.error.swapaxes(0, 1)[:, self.good & self.usable]
        return rms(error)


def predict(view: View, sequence: Sequence, noise: float, *, pairs: int = 1) -> Prediction:
    """`pairs` pairs of draws under Gaussian noise (rms, 8-bit levels) besides the sensor's own.

    InputError if the sequence does not fit the pattern, does not encode both axes or cannot be decoded.
    """
    _require_fit(view, sequence)
    decoded = list(_decoded(view, sequence, noise, pairs))

    def picked(name: str) -> Floats:
        return np.stack([np.asarray(getattr(one, name)).ravel()[view.pick] for one in decoded])

    # the seams between windows are edges that no scene has
    seams = int(Flag.WRONG_FRAME) if view.stride > 1 else 0
    at, sigma = (np.stack([picked(name + axis) for axis in "uv"], axis=1) for name in ("", "sigma_"))
    good = ((picked("flags").astype(np.int64) & ~seams) == 0) & view.visible & np.isfinite(at).all(axis=1)
    keep, error = good[:, None], at - view.centre[:, view.pick]
    return Prediction(np.where(keep, error, 0.0), np.where(keep, sigma, np.inf), good, view.usable)


def _require_fit(view: View, sequence: Sequence) -> None:
    pattern = view.scene.pattern
    if (sequence.rows, sequence.cols) != (pattern.rows, pattern.cols):
        raise InputError(
            f"sequence {sequence.name}: made for {sequence.rows}x{sequence.cols} cells, the pattern of scene "
            f"{view.scene.name!r} has {pattern.rows}x{pattern.cols}"
        )
    for axis in "uv":
        if all(frame.axis != axis for frame in sequence.frames):
            raise InputError(f"sequence {sequence.name}: no frame encodes {axis}; a height needs both axes")


def _decoded(view: View, sequence: Sequence, noise: float, pairs: int) -> Iterator[Correspondence]:
    """What the decoder makes of images of the view, two for every pair."""
    sensor, white = view.sensor, 2**view.sensor.bits - 1
    kind = np.uint8 if sensor.bits == 8 else np.uint16
    light = light_of(view.image, sequence, view.scene.display, view.scene.pattern.blur_px)
    exposure = np.array([frame.exposure for frame in sequence.frames])
    level = sensor.levels(np.maximum(light, 0.0) * exposure[:, None])
    shot = np.maximum(level - sensor.offset, 0.0) / sensor.gain_e if sensor.gain_e > 0 else 0.0
    scatter = np.sqrt(noise**2 + sensor.noise**2 + shot)
    mean, scatter = (np.asarray(part * (white / 255), np.float32) for part in (level, scatter))
    for seed in range(pairs):
        drawn = scatter * np.random.default_rng([seed, 11]).standard_normal(mean.shape, np.float32)
        for sign in (1, -1):
            raw = np.rint(mean + sign * drawn).clip(0, white).astype(kind)
            yield decode(raw.reshape(-1, *view.shape), sequence, white_level=white, check=False)
