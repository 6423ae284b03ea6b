"""A mirror's shape on the GPU: a closed form by its numbers, anything else as a height array."""

from dataclasses import dataclass

import moderngl
import numpy as np

from optolever.scene import Grid, Scene, Surface

__all__ = ["LoadedSurface", "load_surface"]

_SAMPLES = 384  # the bounds are sampled at this many points a side
_SLOPE_MARGIN = 1.25
_LEAST_NODES, _MOST_NODES = (
    256,
    2048,
)  # along the mirror, where a callable is sampled at the camera's resolution
_FLAGS = ("TILT", "RAISED_COSINE", "GAUSSIAN", "BALL", "NEEDLE", "ROUNDED_NEEDLE", "RIDGE")
_LENGTH = {"length": "length_mm"}  # `length` is a function in GLSL


@dataclass(frozen=True, slots=True)
class LoadedSurface:
    """flags: which shader code evaluates it; uniforms: by name; texture: of a height array.

    lowest, highest (mm), steepest: bounds of height and slope over the mirror, with margin (steepest 0: it
    is flat).
    """

    flags: dict[str, bool]
    uniforms: dict[str, float | tuple[float, float]]
    texture: moderngl.Texture | None
    lowest: float
    highest: float
    steepest: float

    def release(self) -> None:
        """Free its GPU memory."""
        if self.texture is not None:
            self.texture.release()


def load_surface(ctx: moderngl.Context, scene: Scene, surface: Surface) -> LoadedSurface:
    """Bring a surface to the GPU; one that is neither a known closed form nor a height array is sampled."""
    kind = "" if surface.formula is None else surface.formula.name.upper().replace("-", "_")
    if surface.formula is not None and kind == "FLAT":
        return LoadedSurface(_kinds("FLAT"), {}, None, *_bounds(scene, surface))
    if surface.formula is not None and kind in _FLAGS:
        params = surface.formula.params
        flags = _kinds("DENT") | {flag: flag == kind for flag in _FLAGS} | {"TAPERED": "taper" in params}
        uniforms: dict[str, float | tuple[float, float]] = {_LENGTH.get(k, k): v for k, v in params.items()}
        return LoadedSurface(flags, uniforms, None, *_bounds(scene, surface))
    if surface.grid is None:
        nodes = min(max(scene.camera.rows, scene.camera.cols, _LEAST_NODES), _MOST_NODES)
        surface = surface.sampled(scene, max(scene.mirror.length, scene.mirror.width) / (nodes - 1))
    return _load_grid(ctx, scene, surface)


def _kinds(chosen: str) -> dict[str, bool]:
    return {kind: kind == chosen for kind in ("FLAT", "DENT", "GRID")}


def _load_grid(ctx: moderngl.Context, scene: Scene, surface: Surface) -> LoadedSurface:
    grid = surface.grid
    assert isinstance(grid, Grid)
    high = grid.coefficients.astype(np.float32)
    pair = np.stack([high, (grid.coefficients - high).astype(np.float32)], axis=-1)
    rows, cols = high.shape
    texture = ctx.texture((cols, rows), 2, pair.tobytes(), dtype="f4")
    texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
    uniforms: dict[str, float | tuple[float, float]] = {
        "grid_origin": (grid.x0, grid.y0),
        "grid_step": (grid.dx, grid.dy),
    }
    return LoadedSurface(_kinds("GRID"), uniforms, texture, *_bounds(scene, surface))


def _bounds(scene: Scene, surface: Surface) -> tuple[float, float, float]:
    """Lowest, highest height (mm), largest slope over the mirror: samples, widened for the gaps."""
    length, width = scene.mirror.length, scene.mirror.width
    x, y = np.meshgrid(np.linspace(0.0, length, _SAMPLES), np.linspace(0.0, width, _SAMPLES))
    z = np.asarray(surface.height(x, y), np.float64)
    slope = float(np.nanmax(np.hypot(*surface.gradient(x, y))))
    low, high = float(np.nanmin(z)), float(np.nanmax(z))
    margin = 0.5 * (high - low) + 1e-3 * length
    return low - margin, high + margin, _SLOPE_MARGIN * slope
