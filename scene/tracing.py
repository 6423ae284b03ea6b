"""Exact ray tracing (float64): camera pixel -> first meeting with the mirror -> reflection -> pattern; how
far a view moves across a pixel."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from optolever.blocks import over_rows
from optolever.files import save_arrays
from optolever.memory import require_room
from optolever.records import Axes, Comparable, plot_maps, span
from optolever.schema import load_record

from .fields import Float
from .meeting import Bounds, bounds_of, first_meeting, meets_again
from .scene import Scene
from .surface import Surface

__all__ = ["Trace", "mean_beside", "movement", "trace"]

_BLOCK = 16  # rows at a time: a block's temporaries stay in the cache


@dataclass(frozen=True, eq=False, repr=False)
class Trace(Comparable):
    """The ray of every camera pixel, (H, W), NaN where it meets no pattern.

    u, v: pattern coordinates in cells; x, y, z: point on the mirror (mm); normal (H, W, 3): unit, on the
    camera's side; incidence: angle between ray and normal (rad); visible: bool.
    """

    u: Annotated[Float, "H W"]
    v: Annotated[Float, "H W"]
    x: Annotated[Float, "H W"]
    y: Annotated[Float, "H W"]
    z: Annotated[Float, "H W"]
    normal: Annotated[Float, "H W 3"]
    incidence: Annotated[Float, "H W"]
    visible: Annotated[NDArray[np.bool_], "H W"]

    def __repr__(self) -> str:
        rows, cols = self.visible.shape
        seen = self.visible
        return (
            f"Trace: {rows} x {cols} pixels, {100 * seen.mean():.4g} % visible\n"
            f"  u {span(self.u, seen)}, v {span(self.v, seen)} pattern pixels\n"
            f"  x {span(self.x, seen)}, y {span(self.y, seen)}, z {span(self.z, seen)} mm\n"
            f"  incidence {span(np.degrees(self.incidence), seen)} degrees"
        )

    def plot(self, axes: Any = None) -> Axes:
        """Draw u, v and z with matplotlib; the axes, one per map."""
        return plot_maps({"u [pattern px]": self.u, "v [pattern px]": self.v, "z [mm]": self.z}, axes)

    def save(self, path: str | Path) -> None:
        """Write all fields as .npz."""
        save_arrays(path, {name: getattr(self, name) for name in _FIELDS})

    @classmethod
    def load(cls, path: str | Path) -> "Trace":
        """Read a file of `save`; InputError if it is another."""
        return load_record(cls, path)


_FIELDS = ("u", "v", "x", "y", "z", "normal", "incidence", "visible")


def trace(scene: Scene, surface: Surface) -> Trace:
    """Follow the ray of every pixel's centre to the pattern.

    Visible: it meets the mirror within its extent, is reflected once (n ~ (-dh/dx, -dh/dy, 1), then
    d' = d - 2 (d.n) n), reaches the pattern's surface without meeting the mirror again, and lands on a cell.

    >>> rig = resize(load("prism48"), 60, 80)
    >>> seen = trace(rig, dent("flat", rig))
    >>> seen.u.shape, round(float(seen.u[30, 40]), 1)
    ((60, 80), 32.5)
    """
    rows, cols = scene.camera.rows, scene.camera.cols
    require_room(f"camera of {rows}x{cols} pixels", rows * cols * (9 * 8 + 1))
    u, v, x, y, z, incidence = (np.full((rows, cols), np.nan) for _ in range(6))
    normal = np.full((rows, cols, 3), np.nan)
    result = Trace(u, v, x, y, z, normal, incidence, np.zeros((rows, cols), np.bool_))
    bounds = bounds_of(surface, scene.mirror)

    def block(start: int, stop: int) -> None:
        _trace_rows(scene, surface, bounds, result, start, stop)

    over_rows(block, rows, _BLOCK)
    return result


def _trace_rows(scene: Scene, surface: Surface, bounds: Bounds, result: Trace, start: int, stop: int) -> None:
    row, col = np.mgrid[start:stop, : scene.camera.cols].reshape(2, -1).astype(np.float64)
    o, d = (np.ascontiguousarray(rays.T) for rays in scene.camera.rays_at(row, col))
    t = first_meeting(o, d, surface, bounds)
    met = np.flatnonzero(np.isfinite(t))
    d = d[:, met]
    points = o[:, met] + t[met] * d
    normal = _normal(surface, points)
    cosine = -(d * normal).sum(axis=0)
    out = d + 2 * cosine * normal
    u, v, distance = scene.pattern.landing(points, out)
    seen = (distance > 0) & (cosine > 0) & _on_cells(scene, u, v)
    seen[seen] = ~meets_again(points[:, seen], out[:, seen], distance[seen], surface, bounds)
    at = met[seen]
    incidence = np.arccos(np.minimum(cosine, 1.0))
    for name, values in zip(("u", "v", "x", "y", "z", "incidence"), (u, v, *points, incidence), strict=True):
        getattr(result, name)[start:stop].reshape(-1)[at] = values[seen]
    result.normal[start:stop].reshape(-1, 3)[at] = normal[:, seen].T
    result.visible[start:stop].reshape(-1)[at] = True


def _normal(surface: Surface, points: Float) -> Float:
    """Unit normals (3, n) on the side of z > h."""
    slope_x, slope_y = surface.gradient(points[0], points[1])
    normal = np.ones_like(points)
    normal[0], normal[1] = np.negative(slope_x), np.negative(slope_y)
    normal /= np.sqrt((normal * normal).sum(axis=0))
    return normal


def _on_cells(scene: Scene, u: Float, v: Float) -> NDArray[np.bool_]:
    inside: NDArray[np.bool_] = (
        (u >= -0.5) & (u <= scene.pattern.cols - 0.5) & (v >= -0.5) & (v <= scene.pattern.rows - 0.5)
    )
    return inside


def movement(before: Float, centre: Float, behind: Float) -> Float:
    """Movement of a coordinate from one end of a pixel to the other; twice that of a half where one end sees
    nothing (NaN), 0 where both do."""
    half = np.where(np.isfinite(before), centre - before, behind - centre)
    whole = np.where(np.isfinite(before) & np.isfinite(behind), behind - before, 2.0 * half)
    moved: Float = np.nan_to_num(whole, nan=0.0)
    return moved


def mean_beside(coordinate: tuple[Float, Float, Float], light: tuple[Float, Float, Float]) -> Float:
    """Mean of a coordinate over a pixel's light less its value at the centre, by its values and the light at
    one end, the centre and the other end (Simpson's rule); 0 where one end sees nothing (NaN)."""
    (before, centre, behind), (first, middle, last) = coordinate, light
    with np.errstate(divide="ignore", invalid="ignore"):
        moment = first * (before - centre) + last * (behind - centre)
        apart: Float = np.nan_to_num(moment / (first + 4.0 * middle + last), nan=0.0, posinf=0.0, neginf=0.0)
    return apart
