"""Prediction of a sequence's decoding errors: images for the decoder, maps for the solver.

A small camera is decoded completely. Of a large one the solver uses every stride-th pixel; the decoder uses
windows of BLOCK x BLOCK adjacent pixels, one at the centre of each BLOCK x BLOCK solved pixels, tiled in one
image. The error of a window's pixel is assigned to a pixel of the thinned camera. The effect of noise and of
other pixel-to-pixel errors on the height then scales with the pixel distance (see `sensitivity`). Errors that
vary more slowly than a window are not predicted.

The images are those of the virtual sensor: its light (footprint, blur, reflectance, border, the display's
response), the sensor's levels, noise and rounding. Noise is drawn in pairs of opposite sign: half the
difference of the two errors is noise, half their sum is bias.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.arrays import Floats, Mask
from optolever.decode import Correspondence, Flag, Response, decode
from optolever.errors import InputError
from optolever.patterns import Frame, Sequence
from optolever.projector import (
    NOMINAL_SENSOR,
    ColourCapture,
    ColourResponse,
    Footprints,
    exact_response,
    footprints,
    light_of,
)
from optolever.scene import Display, Scene, Sensor, Surface, Trace, resize, trace

FINEST = 128  # pixels along the shorter side above which a camera is thinned
BLOCK, MARGIN = 24, 4  # pixels of a window, and of its margin, which is decoded but not used
BORDER = 0.01  # share of light lost beyond the pattern's border, above which a pixel is unusable
#: Stated sigmas, and cells, beyond which an error is a wrong order or bit.
GROSS = 6.0, 1.0


@dataclass(frozen=True, eq=False)
class View:
    """A camera's view of the pattern.

    scene, truth: of the solved pixels (H, W); image: footprints of the decoded image of `shape` pixels;
    centre (2, pixels): u and v at its pixels' centres; pick (H, W): index of the decoded pixel whose error is
    assigned to a solved one; stride: distance of solved pixels in pixels of the full camera.
    """

    scene: Scene
    truth: Trace
    image: Footprints
    centre: Floats
    shape: tuple[int, int]
    pick: NDArray[np.intp]
    stride: float

    @property
    def visible(self) -> Mask:
        """Pixels (H, W) that view the pattern."""
        return np.asarray(self.truth.visible & (self.image.light[self.pick] > 0))

    @property
    def sensor(self) -> Sensor:
        """The scene's sensor, or the nominal one."""
        return self.scene.sensor or NOMINAL_SENSOR

    @property
    def colours(self) -> ColourResponse:
        """The sensor's, with three values in every pixel."""
        return exact_response(replace(self.sensor, mosaic=None))

    @cached_property
    def usable(self) -> Mask:
        """Pixels (H, W) whose footprint is clear of the pattern's border: they lose less than BORDER of the
        light of an infinite white pattern."""
        pattern = self.scene.pattern
        white = Sequence((Frame("white"),), pattern.rows, pattern.cols)
        light = light_of(self.image, white, None, pattern.blur_px)[0][self.pick]
        return np.asarray(self.visible & (light > (1 - BORDER) * self.image.light[self.pick]))


def stride_for(scene: Scene, finest: int = FINEST) -> int:
    """Thinning factor that keeps at least `finest` pixels on the camera's shorter side."""
    return max(1, min(scene.camera.rows, scene.camera.cols) // finest)


def view_of(scene: Scene, surface: Surface, stride: int = 1) -> View:
    """The view of a mirror with this surface."""
    rows, cols = scene.camera.rows, scene.camera.cols
    image, shape = footprints(scene, surface, 0, rows), (rows, cols)
    pick = np.arange(rows * cols).reshape(shape)
    truth = trace(scene, surface)
    view = View(scene, truth, image, np.stack([truth.u.ravel(), truth.v.ravel()]), shape, pick, 1.0)
    if stride == 1:
        return view
    thin_rows, thin_cols = (max(8, round(n / stride)) for n in shape)
    thin = replace(resize(scene, thin_rows, thin_cols), pattern=scene.pattern)
    return thinned(view, thin, trace(thin, surface))


def thinned(view: View, scene: Scene, truth: Trace) -> View:
    """The view of a thinned camera from the full one; scene, truth: of the thinned camera."""
    size, full = truth.u.shape, view.shape
    (down, rows), (across, cols) = (_windows(n, count) for n, count in zip(full, size, strict=True))
    index = (down[:, None] * full[1] + across).ravel()
    image = Footprints(
        *(getattr(view.image, name)[index] for name in ("u", "v", "light", "boxes_u", "boxes_v"))
    )
    stride = float(np.sqrt(full[0] / size[0] * full[1] / size[1]))
    pick = rows[:, None] * len(across) + cols
    return View(scene, truth, image, view.centre[:, index], (len(down), len(across)), pick, stride)


def _windows(full: int, count: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Indices of the decoded rows among `full`, and (count,) the position of each solved row among them."""
    taken, pick, used = [], [], 0
    for part in np.array_split(np.arange(count), -(-count // BLOCK)):
        size = min(full, len(part) + 2 * MARGIN)
        middle = (part[0] + part[-1] + 1) / 2 * full / count
        first = int(np.clip(round(middle - size / 2), 0, full - size))
        taken.append(np.arange(first, first + size))
        pick.append(used + (size - len(part)) // 2 + np.arange(len(part)))
        used += size
    return np.concatenate(taken), np.concatenate(pick)


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Two draws of opposite noise of a sequence in a view.

    error, sigma (2, 2, H, W): error of u and v, and the decoder's sigma, cells, 0 and inf where a pixel is
    flagged; good (2, H, W): not flagged; usable (H, W): pixels of the error statistics.
    """

    error: Floats
    sigma: Floats
    good: Mask
    usable: Mask

    @property
    def failure(self) -> float:
        """Share of the usable pixels with an unflagged wrong order or bit."""
        far, cells = GROSS
        size = np.abs(self.error)
        gross = (size > cells) & (size > far * self.sigma)
        return float(np.asarray(gross.any(axis=1))[:, self.usable].mean())


def predict(view: View, sequence: Sequence, noise: float, *, response: Response | None = None) -> Prediction:
    """A pair of draws under Gaussian noise (rms, 8-bit levels) in addition to the sensor's noise; response:
    of the display, as the decoder knows it.

    InputError if the sequence does not fit the pattern, does not encode both axes or cannot be decoded.
    """
    _require_fit(view, sequence)
    decoded = list(_decoded(view, sequence, noise, response))

    def picked(name: str) -> Floats:
        return np.stack([np.asarray(getattr(one, name)).ravel()[view.pick] for one in decoded])

    # seams between windows look like frame faults to the decoder
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


def _decoded(
    view: View, sequence: Sequence, noise: float, response: Response | None
) -> Iterator[Correspondence]:
    """Correspondences of images of the view with noise of either sign."""
    if sequence.packing is not None:  # drawn for its stripes, a fringe is as good as without
        sequence = replace(sequence, packing=replace(sequence.packing, stripes="none"))
    sensor, white = view.sensor, 2**view.sensor.bits - 1
    kind = np.uint8 if sensor.bits == 8 else np.uint16
    level = sensor.levels(np.maximum(_light(view, sequence), 0.0))
    shot = np.maximum(level - sensor.offset, 0.0) / sensor.gain_e if sensor.gain_e > 0 else 0.0
    scatter = np.sqrt(noise**2 + sensor.noise**2 + shot)
    mean, scatter = (np.asarray(part * (white / 255), np.float32) for part in (level, scatter))
    drawn = scatter * np.random.default_rng([0, 11]).standard_normal(mean.shape, np.float32)
    for sign in (1, -1):
        raw: NDArray[Any] = np.rint(mean + sign * drawn).clip(0, white).astype(kind)
        if sequence.packing is None:
            yield decode(raw.reshape(-1, *view.shape), sequence, white_level=white, response=response)
        else:
            images = raw.reshape(-1, *view.shape, 3)
            taken = ColourCapture(images, sequence, bits=sensor.bits).unmixed(view.colours)
            yield decode(taken.frames, taken.sequence)


def _light(view: View, sequence: Sequence) -> NDArray[np.float32]:
    """Of the image's pixels (N, pixels), or (E, pixels, 3) of a colour camera."""
    display, blur = view.scene.display or Display(), view.scene.pattern.blur_px
    if sequence.packing is None:
        return light_of(view.image, sequence, display, blur)
    lights = [light_of(view.image, sequence.channel(c), display.channel(c), blur) for c in range(3)]
    mix = view.colours.mix / view.sensor.exposure
    return np.asarray(np.stack(lights, axis=-1) @ mix.T, np.float32)
