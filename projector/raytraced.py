"""Frames by rays through the area of every camera pixel: no footprint, no Jacobian, no model of a decoder.

`side`^2 rays a pixel (36 by default) are traced exactly (`scene.trace`: lens distortion, refraction at the
face, dent, reflection). They form a turned grid: ray (i, j) of a pixel stands at

    ((i + (j + 1/2) / side) / side, (j + (side - i - 1/2) / side) / side)

of it: all of them differ along columns and along rows, and the two do not correlate. Each looks up the light
of the display at the place that it meets: cells of uniform level (`Frame.tables`), dark around them, blurred
by a Gaussian of `pattern.blur_px` cells; the pixel's light is their mean. It serves tests of
models of a pixel: maps that bend, fold or end inside of one are averaged as they are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.special import ndtr

from optolever.blocks import over_rows
from optolever.kernels import exact
from optolever.patterns import Sequence
from optolever.scene import Camera, Scene, Sensor, Surface, Trace, scene_window, trace

from .electronics import FrameElectronics
from .groups import FrameGroup, frame_groups
from .optics_numpy import HeldNowhere

__all__ = ["AreaTrace", "Lighting", "RayOptics", "area_frames", "area_light", "expose", "trace_area"]

Float = NDArray[np.float64]
Light = NDArray[np.float32]

_REACH = 5.0  # the blur is cut off here, in units of its rms: 6e-7 of the light
_FINE = 128  # places in a cell at which the blurred light is tabulated; in between it is interpolated
_BLOCK = 1024  # pixels at a time per thread
_TRACED = 1 << 14  # pixels whose rays are in memory at a time


@dataclass(frozen=True, slots=True)
class Lighting:
    """Losses of light. backlight: share that is missing at the display's corner farthest from `brightest`
    (u, v, shares of its sides); vignetting: share that is missing in the image's corners (with the square of
    the distance, both); dark: dark current, 8-bit levels, with the shot noise of as much light.
    """

    backlight: float = 0.0
    brightest: tuple[float, float] = (0.5, 0.5)
    vignetting: float = 0.0
    dark: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class AreaTrace:
    """Intersections of the rays of every pixel's area.

    u, v (H, W, R): pattern coordinates in cells, NaN where a ray meets neither the pattern nor the
    margin into which its blur carries light; reflected (H, W, R): share of
    the light that the mirror passes on; hit (H, W, R): rays that meet a cell; centre: of the pixels' centres.
    """

    scene: Scene
    u: Float
    v: Float
    reflected: Float
    hit: NDArray[np.bool_]
    centre: Trace

    @property
    def visible(self) -> NDArray[np.bool_]:
        """Pixels (H, W) all of whose rays meet the pattern."""
        return np.asarray(self.hit.all(axis=-1))

    @property
    def partly(self) -> NDArray[np.bool_]:
        """Pixels (H, W) some, but not all, of whose rays meet the pattern."""
        return np.asarray(self.hit.any(axis=-1) & ~self.visible)

    def mean(self) -> tuple[Float, Float]:
        """u, v (H, W) in cells: mean over the rays that meet the pattern; NaN where none does."""
        count = self.hit.sum(axis=-1)
        with np.errstate(invalid="ignore", divide="ignore"):
            u, v = (np.where(self.hit, at, 0.0).sum(axis=-1) / count for at in (self.u, self.v))
        return u, v

    def extent(self) -> tuple[Float, Float]:
        """How far u and v (H, W), in cells, vary over the rays that meet the pattern; 0 where none does."""
        found = []
        for at in (self.u, self.v):
            most = np.where(self.hit, at, -np.inf).max(axis=-1)
            least = np.where(self.hit, at, np.inf).min(axis=-1)
            found.append(np.where(most >= least, most - least, 0.0))
        return found[0], found[1]


class _AreaCamera:
    """A camera whose pixel (row, col) is ray col % R of pixel (row, col // R) of another one."""

    def __init__(self, camera: Camera, side: int) -> None:
        self._camera, self._side = camera, side
        self.rows, self.cols = camera.rows, camera.cols * side * side

    def rays_at(self, row: Float, col: Float) -> tuple[Float, Float]:
        """Origins (..., 3) in mm and unit directions (..., 3)."""
        pixel, ray = np.divmod(col, self._side**2)
        down, along = _within(ray, self._side)
        return self._camera.rays_at(row + down, pixel + along)


def _within(ray: Float, side: int) -> tuple[Float, Float]:
    """Where in a pixel a ray passes: rows and columns from the centre."""
    j, i = np.divmod(ray, side)
    return (j + (side - i - 0.5) / side) / side - 0.5, (i + (j + 0.5) / side) / side - 0.5


def trace_area(scene: Scene, surface: Surface, side: int = 6) -> AreaTrace:
    """Trace side^2 rays through every pixel."""
    pattern, margin = scene.pattern, _margin(scene)
    wide = pattern.resampled(pattern.rows + 2 * margin, pattern.cols + 2 * margin, 1.0, margin)
    finer = replace(scene, pattern=wide)
    object.__setattr__(finer, "camera", _AreaCamera(scene.camera, side))  # no camera that a scene takes
    rays = trace(finer, surface)
    shape = scene.camera.rows, scene.camera.cols, side * side
    u, v = rays.u.reshape(shape) - margin, rays.v.reshape(shape) - margin
    met = rays.visible.reshape(shape)
    reflected = met.astype(np.float64)
    if scene.medium is not None:
        passed = scene.medium.reflectance(np.cos(rays.incidence)).reshape(shape)
        reflected = np.where(met, passed, 0.0)
    with np.errstate(invalid="ignore"):
        hit = np.abs(u - 0.5 * (pattern.cols - 1)) <= 0.5 * pattern.cols
        hit &= np.abs(v - 0.5 * (pattern.rows - 1)) <= 0.5 * pattern.rows
    return AreaTrace(scene, u, v, reflected, np.asarray(met & hit), trace(scene, surface))


def area_light(seen: AreaTrace, sequence: Sequence, lighting: Lighting | None = None) -> Light:
    """Light (N, H, W) on the pixels, relative to one fully lit through an ideal mirror."""
    rows, cols = seen.u.shape[:2]
    light = np.empty((len(sequence), rows, cols), np.float32)
    weight = seen.reflected * _dimming(seen, lighting or Lighting())
    staggered = seen.scene.pattern.stagger != 0
    for group in frame_groups(sequence, seen.scene.display, staggered=staggered):
        if group.axis == "uv":
            for index in group.indices:
                light[index] = _look_up_two(seen, group.response[sequence.render_frame(index)], weight)
        else:
            light[list(group.indices)] = np.moveaxis(_look_up(seen, group, weight), -1, 0)
    return light


class RayOptics(HeldNowhere):
    """Light on the camera's pixels for the virtual sensor, relative to a fully lit, fully reflecting one."""

    def __init__(self, scene: Scene, sequence: Sequence) -> None:
        self._scene, self._sequence = scene, sequence

    def render(
        self, surface: Surface, start: int, stop: int, frame: int | None = None
    ) -> list[tuple[int, Light]]:
        """(frame index, light (stop - start, W) float32) of all frames, or of one."""
        indices = range(len(self._sequence)) if frame is None else (frame,)
        shown = replace(self._sequence, frames=tuple(self._sequence.frames[index] for index in indices))
        cols = self._scene.camera.cols
        light = np.empty((len(shown), stop - start, cols), np.float32)
        step = max(1, _TRACED // cols)
        for row in range(start, stop, step):
            window = scene_window(self._scene, row, 0, min(step, stop - row), cols)
            light[:, row - start : row - start + step] = area_light(trace_area(window, surface), shown)
        return list(zip(indices, light, strict=True))


def area_frames(
    seen: AreaTrace, sequence: Sequence, sensor: Sensor, lighting: Lighting | None = None, seed: int = 0
) -> NDArray[Any]:
    """Frames (N, H, W) of a camera that sees `area_light`; see expose."""
    return expose(area_light(seen, sequence, lighting), sequence, sensor, lighting, seed)


def expose(
    lights: Light, sequence: Sequence, sensor: Sensor, lighting: Lighting | None = None, seed: int = 0
) -> NDArray[Any]:
    """Frames (N, H, W) of light (N, H, W): dark current, offset, read and shot noise, clipping, rounding;
    uint8, or uint16 from `sensor.bits` > 8 on. The noise of a pixel goes by `seed`, frame and place alone.
    """
    dark = 0.0 if lighting is None else lighting.dark / (255.0 * sensor.exposure)
    frames = np.empty(lights.shape, np.uint8 if sensor.bits == 8 else np.uint16)
    for index in range(len(sequence)):
        electronics = FrameElectronics.of_frame(sensor, 1.0, sensor.noise, sensor.bits, seed, index)
        electronics.expose(lights[index] + np.float32(dark), frames[index])
    return frames


def _margin(scene: Scene) -> int:
    """Cells around the pattern into which its blur carries light."""
    return int(np.ceil(_REACH * scene.pattern.blur_px)) + 1


def _dimming(seen: AreaTrace, lighting: Lighting) -> Float:
    """Factor (H, W, R) of the backlight's falloff and the lens's vignetting; 0 for rays without light."""
    pattern = seen.scene.pattern
    at = np.stack([(seen.u + 0.5) / pattern.cols, (seen.v + 0.5) / pattern.rows])
    brightest = np.array(lighting.brightest)[:, None, None, None]
    farthest = (np.maximum(brightest, 1.0 - brightest) ** 2).sum()
    emitted = 1.0 - lighting.backlight * ((at - brightest) ** 2).sum(axis=0) / farthest
    rows, cols, rays = seen.u.shape
    down, along = _within(np.arange(float(rays)), round(rays**0.5))
    y = 2.0 * (np.arange(rows)[:, None, None] + 0.5 + down) / rows - 1.0
    x = 2.0 * (np.arange(cols)[:, None] + 0.5 + along) / cols - 1.0
    passed = 1.0 - 0.5 * lighting.vignetting * (x * x + y * y)
    dimmed: Float = np.nan_to_num(np.maximum(emitted, 0.0)) * passed
    return dimmed


def _look_up(seen: AreaTrace, group: FrameGroup, weight: Float) -> Light:
    """Light (H, W, n) of a group's frames."""
    scene, rays = seen.scene, seen.u.shape[2]
    blur, margin = scene.pattern.blur_px, _margin(scene)
    along, across = (seen.u, seen.v) if group.axis == "u" else (seen.v, seen.u)
    table = _blurred(group.light.astype(np.float64), blur, margin)
    edges = _blurred(np.ones((group.across, 1)), blur, margin)[:, 0]
    start = margin + 0.5
    at, beside = (np.nan_to_num(part + start).reshape(-1, rays) for part in (along, across))
    weights = weight.reshape(-1, rays)
    out = np.empty((at.shape[0], table.shape[1]), np.float32)
    fine = _FINE if blur > 0.0 else 1

    def work(first: int, last: int) -> None:
        part = slice(first, last)
        _pixel_means(at[part], beside[part], weights[part], table, edges, fine, out[part])

    over_rows(work, at.shape[0], _BLOCK)
    return out.reshape(*seen.u.shape[:2], -1)


def _look_up_two(seen: AreaTrace, image: Light, weight: Float) -> Light:
    """Light (H, W) of a frame that varies along both axes: image (rows, cols) of its cells' light."""
    blur, margin, rays = seen.scene.pattern.blur_px, _margin(seen.scene), seen.u.shape[2]
    stagger = seen.scene.pattern.stagger
    reach = margin if blur > 0.0 else 0
    padded = np.pad(image.astype(np.float64), (margin + reach, margin + reach + 1))
    shares = _shares(blur, reach)
    places = [np.nan_to_num(at + margin + 0.5).reshape(-1, rays) for at in (seen.u, seen.v)]
    weights = weight.reshape(-1, rays)
    out = np.empty(weights.shape[0], np.float32)

    def work(first: int, last: int) -> None:
        part = slice(first, last)
        at = places[0][part], places[1][part]
        _image_means(*at, weights[part], padded, shares, 0.5 * stagger, margin + reach, out[part])

    over_rows(work, out.size, _BLOCK)
    return out.reshape(seen.u.shape[:2])


def _shares(blur: float, reach: int) -> Float:
    """Shares (F + 1, K) of the cells -reach..reach in the light at F + 1 places from the lower to the upper
    edge of cell 0.
    """
    if blur == 0.0:
        return np.ones((2, 1))
    place = np.arange(_FINE + 1)[:, None] / _FINE - 0.5
    cell = np.arange(-reach, reach + 1)[None, :]
    shares: Float = ndtr((cell + 0.5 - place) / blur) - ndtr((cell - 0.5 - place) / blur)
    return shares


def _blurred(levels: Float, blur: float, margin: int) -> Float:
    """Light (F, n) of cells (K, n), dark around them, through a Gaussian of `blur` cells: from the lower edge
    of cell -margin on, in steps of 1 / _FINE of a cell (no blur: one value per cell).
    """
    reach = margin if blur > 0.0 else 0
    padded = np.pad(levels, ((margin + reach, margin + reach + 1), (0, 0)))
    if blur == 0.0:
        return np.ascontiguousarray(padded)
    windows = sliding_window_view(padded, 2 * reach + 1, axis=0)
    table: Float = np.einsum("cnk,pk->cpn", windows, _shares(blur, reach)[:-1], optimize=True)
    return np.ascontiguousarray(table.reshape(-1, levels.shape[1]))


@exact
def _pixel_means(
    at: Float, beside: Float, weights: Float, table: Float, edges: Float, fine: int, out: Light
) -> None:
    """Mean light (P, n) over the rays of pixels.

    at, beside (P, R): places along and across the axis of the frames, cells from the tables' start; weights
    (P, R): 0 where a ray meets no light; table (F, n), edges (E,): light along, and share of it across,
    `fine` entries a cell, interpolated where that is more than one.
    """
    smooth = 1.0 if fine > 1 else 0.0
    sums = np.empty(table.shape[1])
    for p in range(at.shape[0]):
        sums[:] = 0.0
        for r in range(at.shape[1]):
            if weights[p, r] <= 0.0:
                continue
            x, y = at[p, r] * fine, beside[p, r] * fine
            i, j = min(int(x), table.shape[0] - 2), min(int(y), edges.shape[0] - 2)
            s, t = smooth * (x - i), smooth * (y - j)
            weight = weights[p, r] * ((1.0 - t) * edges[j] + t * edges[j + 1])
            for n in range(sums.size):
                sums[n] += weight * ((1.0 - s) * table[i, n] + s * table[i + 1, n])
        for n in range(sums.size):
            out[p, n] = sums[n] / at.shape[1]


@exact
def _image_means(
    at_u: Float,
    at_v: Float,
    weights: Float,
    image: Float,
    shares: Float,
    aside: float,
    padding: int,
    out: Light,
) -> None:
    """Mean light (P,) over the rays of pixels.

    at_u, at_v (P, R): places in cells from the image's start, to which `shares` (F + 1, K) reaches K / 2
    cells beyond; weights (P, R): 0 where a ray sees nothing; image (rows, cols); aside: of odd rows to the
    right, of even ones to the left, counted from the image's row `padding`.
    """
    fine, reach = shares.shape[0] - 1, shares.shape[1]
    for p in range(out.size):
        total = 0.0
        for r in range(at_u.shape[1]):
            if weights[p, r] <= 0.0:
                continue
            row = int(at_v[p, r])
            y = (at_v[p, r] - row) * fine
            j = min(int(y), fine - 1)
            t = y - j
            for k in range(reach):
                u = at_u[p, r] + (aside if (row + k - padding) % 2 == 0 else -aside)
                col = min(max(int(u), 0), image.shape[1] - reach)
                x = (u - col) * fine
                i = min(max(int(x), 0), fine - 1)
                s = x - i
                along = 0.0
                for m in range(reach):
                    along += ((1.0 - s) * shares[i, m] + s * shares[i + 1, m]) * image[row + k, col + m]
                total += weights[p, r] * ((1.0 - t) * shares[j, k] + t * shares[j + 1, k]) * along
        out[p] = total / at_u.shape[1]
