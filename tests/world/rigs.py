"""Drawn rigs and their exact rays: presets rolled, zoomed, with other cells, another blur and a dent."""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from optolever.scene import (
    Camera,
    Face,
    PinholeCamera,
    Scene,
    Surface,
    Trace,
    dent,
    load,
    prism_pattern,
    resize,
    scene_window,
    trace,
)

F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]

PRESETS = ("prism48", "monitor-mirror", "paper-prototype", "paper-simulation")
FORMS = ("gaussian", "raised-cosine", "ball", "ridge", "flat")
SIZE = 120, 150
MARGIN = 4  # pixels around the image, cells around the pattern, whose light a blur reaches


@dataclass(frozen=True, eq=False)
class Rig:
    """scene, truth: of the image of SIZE; wide: MARGIN pixels more on every side; side: least number of rays
    along a pixel's side.
    """

    name: str
    scene: Scene
    wide: Scene
    surface: Surface
    truth: Trace
    side: int = 4


@dataclass(frozen=True, eq=False)
class Rays:
    """Of side x side points in every pixel of the wide image, (H side, W side): place on the pattern in cells
    (NaN: no mirror) and share of the light that is reflected; lit (H, W): pixels of the image of SIZE all of
    whose points meet the pattern.
    """

    u: F64
    v: F64
    reflected: F64
    lit: Mask
    side: int


@lru_cache(maxsize=32)
def draw_rig(number: int, critical: bool = False) -> Rig:
    """The rig of a number, which sees the pattern in a third of its image or more; critical: a prism on whose
    mirror total reflection begins."""
    rng = np.random.default_rng([72, number])
    rows, cols = SIZE[0] + 2 * MARGIN, SIZE[1] + 2 * MARGIN
    preset = "critical" if critical else PRESETS[number % len(PRESETS)]
    while True:
        wide = _critical(rng, rows, cols) if critical else resize(load(preset, exact=True), rows, cols)
        roll = float(np.radians(rng.uniform(-15, 15)) + 0.5 * np.pi * rng.integers(4))
        wide = replace(wide, camera=_turned(wide.camera, roll, float(rng.uniform(0.75, 1.3))))
        density, blur = np.exp(rng.uniform(*np.log([0.6, 1.7]))), float(rng.uniform(0.3, 0.9))
        surface = _dent(rng, wide)
        seen = trace(wide, surface)
        if seen.visible.mean() < 0.3:
            continue
        moves = [np.hypot(np.diff(seen.u, axis=axis), np.diff(seen.v, axis=axis)) for axis in (0, 1)]
        by = float(density / np.sqrt(np.nanmedian(moves[0]) * np.nanmedian(moves[1])))
        size = [round(by * count) for count in (wide.pattern.rows, wide.pattern.cols)]
        cells = wide.pattern.resampled(size[0], size[1], by, 0.5 * (by - 1))
        wide = replace(wide, pattern=replace(cells, blur_px=blur), covariance=None)
        scene = scene_window(wide, MARGIN, MARGIN, *SIZE)
        side = 8 if critical else 4
        return Rig(f"{preset} {number}", scene, wide, surface, trace(scene, surface), side)


def _critical(rng: np.random.Generator, rows: int, cols: int) -> Scene:
    """A silicone prism of 45/45 degrees, seen by a pinhole through its face."""
    prism, distance = load("prism48", exact=True), float(rng.uniform(120, 250))
    index, edge = float(rng.uniform(1.38, 1.43)), np.array([prism.mirror.length, 0.0, 0.0])
    ahead, right = np.array([-1.0, 0.0, -1.0]) / np.sqrt(2), np.array([-1.0, 0.0, 1.0]) / np.sqrt(2)
    start = np.array([0.5 * prism.mirror.length, 0.5 * prism.mirror.width, 0.0]) - distance * ahead
    focal = np.full(2, distance * rows / prism.mirror.width)
    centre = 0.5 * np.array([cols - 1.0, rows - 1.0])
    face = Face(edge, ahead, index)
    camera = PinholeCamera(start, right, np.array([0.0, 1.0, 0.0]), focal, centre, rows, cols, face=face)
    pattern = prism_pattern(0.25 * np.pi, 750, 750, 0.06).resampled(1250, 1250, 1.0, 250.0)
    medium = replace(prism.medium, index=index) if prism.medium is not None else None
    return replace(prism, camera=camera, pattern=pattern, medium=medium, covariance=None)


def _dent(rng: np.random.Generator, scene: Scene) -> Surface:
    """A third of a default dent to the whole, somewhere on the mirror."""
    form, mirror = str(rng.choice(FORMS)), scene.mirror
    share, at = float(rng.uniform(0.3, 1.0)), rng.uniform(0.25, 0.75, 2)
    params = {} if form == "flat" else {"peak": share * _params(form, scene)["peak"]}
    if {"x", "y"} <= set(_params(form, scene)):
        params |= {"x": float(at[0] * mirror.length), "y": float(at[1] * mirror.width)}
    return dent(form, scene, **params)


def _params(form: str, scene: Scene) -> dict[str, float]:
    formula = dent(form, scene).formula
    return {} if formula is None else dict(formula.params)


def _turned(camera: Camera, roll: float, zoom: float) -> Camera:
    """Rolled about the middle of its view by `roll` (rad), with a field `zoom` times as wide."""
    u = np.cos(roll) * camera.u_axis + np.sin(roll) * camera.v_axis
    v = np.cos(roll) * camera.v_axis - np.sin(roll) * camera.u_axis
    if isinstance(camera, PinholeCamera):
        return replace(camera, u_axis=u, v_axis=v, focal=camera.focal / zoom)
    half = 0.5 * np.array([camera.cols - 1, camera.rows - 1]) * camera.pitch
    middle = camera.origin + half[0] * camera.u_axis + half[1] * camera.v_axis
    start = middle - zoom * (half[0] * u + half[1] * v)
    return replace(camera, origin=start, u_axis=u, v_axis=v, pitch=camera.pitch * zoom)


@lru_cache(maxsize=6)
def rays_of(rig: Rig, side: int, growth: float = 0.0) -> Rays:
    """Rays of the mirror whose dent is by a share of `growth` deeper."""
    wide = rig.wide
    pattern = wide.pattern.resampled(
        wide.pattern.rows + 2 * MARGIN, wide.pattern.cols + 2 * MARGIN, 1.0, MARGIN
    )
    fine = resize(wide, wide.camera.rows * side, wide.camera.cols * side)
    seen = trace(replace(fine, pattern=pattern), grown(rig.surface, growth))
    reflected = seen.visible.astype(np.float64)
    if wide.medium is not None:
        passed = wide.medium.reflectance(np.cos(seen.incidence))
        reflected = np.where(seen.visible, passed, 0.0)
    u, v = seen.u - MARGIN, seen.v - MARGIN
    with np.errstate(invalid="ignore"):
        on = (np.abs(u - 0.5 * (wide.pattern.cols - 1)) < 0.5 * wide.pattern.cols) & (
            np.abs(v - 0.5 * (wide.pattern.rows - 1)) < 0.5 * wide.pattern.rows
        )
    inside = slice(MARGIN, -MARGIN)
    return Rays(u, v, reflected, pixels(on & seen.visible, side).min(axis=(1, 3))[inside, inside], side)


def pixels(fine: NDArray[np.generic], side: int) -> NDArray[np.generic]:
    """(H side, W side) as (H, side, W, side)."""
    return fine.reshape(fine.shape[0] // side, side, fine.shape[1] // side, side)


def grown(surface: Surface, share: float) -> Surface:
    """Heights and slopes by a share larger."""
    if not share:
        return surface

    def form(x: F64, y: F64) -> tuple[F64, F64, F64]:
        z, slope_x, slope_y = surface.evaluate(x, y)
        return (1 + share) * z, (1 + share) * slope_x, (1 + share) * slope_y

    return Surface(lambda x, y: form(x, y)[0], lambda x, y: form(x, y)[1:], both=form)
