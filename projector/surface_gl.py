"""A mirror's shape on the GPU: a closed form by its numbers, anything else as a height array."""

from collections.abc import Mapping
from dataclasses import dataclass

import moderngl
import numpy as np

from optolever.scene import Grid, Scene, Surface

__all__ = ["LoadedSurface", "load_surface"]

_SAMPLES = 384  # the bounds are sampled at this many points a side
_SLOPE_MARGIN = 1.25
_LEAST_NODES, _MOST_NODES = 256, 2048  # along the mirror, of a callable, sampled at the camera's resolution
_FORMULAS = ("TILT", "RAISED_COSINE", "GAUSSIAN", "BALL", "NEEDLE", "ROUNDED_NEEDLE", "RIDGE")
_FLAGS = ("FLAT", "DENT", "GRID", "TAPERED", *_FORMULAS)
_LENGTH = {"length": "length_mm"}  # `length` is a function in GLSL


@dataclass(frozen=True, slots=True)
class LoadedSurface:
    """flags: which shader code evaluates it; uniforms: by name; texture: of a height array.

    lowest, highest (mm), steepest: bounds of height and slope over the mirror, with margin (steepest 0: it
    is flat).
    """

    flags: dict[str, bool]
    uniforms: Mapping[str, float | tuple[float, float]]
    texture: moderngl.Texture | None
    lowest: float
    highest: float
    steepest: float


def load_surface(ctx: moderngl.Context, scene: Scene, surface: Surface) -> LoadedSurface:
    """Bring a surface to the GPU; one that is neither a known closed form nor a height array is sampled."""
    kind = "" if surface.formula is None else surface.formula.name.upper().replace("-", "_")
    off = dict.fromkeys(_FLAGS, False)
    if kind == "FLAT":
        return LoadedSurface(off | {"FLAT": True}, {}, None, *_bounds(scene, surface))
    if surface.formula is not None and kind in _FORMULAS:
        params = surface.formula.params
        flags = off | {"DENT": True, kind: True, "TAPERED": "taper" in params}
        uniforms = {_LENGTH.get(name, name): value for name, value in params.items()}
        return LoadedSurface(flags, uniforms, None, *_bounds(scene, surface))
    if surface.grid is None:
        nodes = min(max(scene.camera.rows, scene.camera.cols, _LEAST_NODES), _MOST_NODES)
        surface = surface.sampled(scene, max(scene.mirror.length, scene.mirror.width) / (nodes - 1))
    grid = surface.grid
    assert isinstance(grid, Grid)
    high = grid.coefficients.astype(np.float32)
    pair = np.stack([high, (grid.coefficients - high).astype(np.float32)], axis=-1)
    texture = ctx.texture(high.shape[::-1], 2, pair.tobytes(), dtype="f4")
    texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
    place = {"grid_origin": (grid.x0, grid.y0), "grid_step": (grid.dx, grid.dy)}
    return LoadedSurface(off | {"GRID": True}, place, texture, *_bounds(scene, surface))


def _bounds(scene: Scene, surface: Surface) -> tuple[float, float, float]:
    """Lowest, highest height (mm), largest slope over the mirror: samples, widened for the gaps."""
    length, width = scene.mirror.length, scene.mirror.width
    x, y = np.meshgrid(np.linspace(0.0, length, _SAMPLES), np.linspace(0.0, width, _SAMPLES))
    z = np.asarray(surface.height(x, y), np.float64)
    slope = float(np.nanmax(np.hypot(*surface.gradient(x, y))))
    low, high = float(np.nanmin(z)), float(np.nanmax(z))
    margin = 0.5 * (high - low) + 1e-3 * length
    return low - margin, high + margin, _SLOPE_MARGIN * slope
