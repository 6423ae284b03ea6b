"""Frames by rays through the area of every camera pixel, whose light is summed: no model of a decoder."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from optolever.patterns import Sequence
from optolever.scene import Display, Scene, Sensor, Surface, TelecentricCamera, trace

F64 = NDArray[np.float64]
SIDE, FINE, REACH = 6, 64, 6  # rays along a pixel; places in a cell; cells into which the blur carries light
#: Shares of light that are missing at the corner farthest from BRIGHTEST, and in the image's corners.
BACKLIGHT, BRIGHTEST, VIGNETTING = 0.3, np.array([0.3, 0.6]), 0.5


@dataclass(frozen=True, eq=False)
class Area:
    """u, v (H, W, rays): cells; visible (H, W): all rays are in it; x, y (rays): in the pixel."""

    u: F64
    v: F64
    visible: NDArray[np.bool_]
    x: F64
    y: F64


def trace_area(scene: Scene, surface: Surface) -> Area:
    """SIDE^2 rays a pixel, on a turned grid: places along columns and along rows do not correlate."""
    j, i = np.divmod(np.arange(SIDE**2), SIDE)
    x, y = (i + (j + 0.5) / SIDE) / SIDE - 0.5, (j + (SIDE - i - 0.5) / SIDE) / SIDE - 0.5
    camera = scene.camera
    assert not isinstance(camera, TelecentricCamera)
    seen = [
        trace(replace(scene, camera=replace(camera, centre=camera.centre - np.array(at))), surface)
        for at in zip(x, y, strict=True)
    ]
    u, v = (np.stack([getattr(one, name) for one in seen], -1) for name in "uv")
    return Area(u, v, np.all([one.visible for one in seen], 0), x, y)


def area_frames(area: Area, scene: Scene, shown: Sequence, sensor: Sensor, seed: int) -> NDArray[np.uint8]:
    """Frames (N, H, W) of a dimmed display through a lens that vignettes, with read noise."""
    rows, cols = area.visible.shape
    size = np.array([scene.pattern.cols, scene.pattern.rows])
    place = (np.stack([area.u, area.v], -1) + 0.5) / size
    farthest = (np.maximum(BRIGHTEST, 1 - BRIGHTEST) ** 2).sum()
    weight = 1 - BACKLIGHT * ((place - BRIGHTEST) ** 2).sum(-1) / farthest
    y = 2 * (np.arange(rows)[:, None, None] + 0.5 + area.y) / rows - 1
    x = 2 * (np.arange(cols)[:, None] + 0.5 + area.x) / cols - 1
    weight = np.nan_to_num(weight) * (1 - 0.5 * VIGNETTING * (x * x + y * y))
    display, blur, rng = scene.display or Display(1.0), scene.pattern.blur_px, np.random.default_rng(seed)
    borders = [_profile(np.ones(n), blur, at) for n, at in zip(size, (area.u, area.v), strict=True)]
    frames = np.empty((len(shown), rows, cols), np.uint8)
    for index, tables in enumerate(zip(*shown.tables(), strict=True)):
        axis = int((tables[0] == 255).all())
        light = _profile(display.light(tables[axis]), blur, (area.u, area.v)[axis]) * borders[1 - axis]
        levels = sensor.levels((weight * light).mean(-1))
        levels += sensor.noise * rng.standard_normal(levels.shape)
        frames[index] = np.clip(np.rint(levels), 0, 255)
    return frames


def _profile(cells: F64, blur: float, at: F64) -> F64:
    """Light at places (...) of a row of cells (K,), dark around them, through a Gaussian of `blur` cells."""
    beside = np.arange(-REACH, REACH + 1)
    within = np.arange(FINE)[:, None] / FINE - 0.5 - beside
    shares = ndtr((within + 0.5) / blur) - ndtr((within - 0.5) / blur)
    near = np.lib.stride_tricks.sliding_window_view(np.pad(cells, 2 * REACH), beside.size)
    fine = (near @ shares.T).ravel()
    start = -REACH - 0.5
    return np.interp(np.nan_to_num(at, nan=-2.0 * REACH), start + np.arange(fine.size) / FINE, fine)
