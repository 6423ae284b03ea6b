"""Exact ray tracing (float64): camera pixel -> first meeting with the mirror -> reflection -> pattern; how
far a view moves across a pixel.

The meeting is the first crossing of F(t) = z(t) - h(x(t), y(t)) over the mirror's extent. Where |d_z| exceeds
the surface's largest slope times |d_xy|, F falls steadily: one crossing, by Newton's method inside a
shrinking bracket. Only the other rays are marched, in steps that F cannot cross (F over its largest slope),
but not in shorter ones than 1/4096 of the mirror.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from optolever.arrays import Mask, require_room
from optolever.blocks import over_rows
from optolever.files import save_arrays
from optolever.records import Axes, Comparable, plot_maps, span
from optolever.schema import load_record

from .fields import Float
from .mirror import Mirror
from .scene import Scene
from .surface import Surface

__all__ = ["Bounds", "Trace", "bounds_of", "first_meeting", "mean_beside", "meets_again", "movement", "trace"]

_SAMPLES = 384  # the surface's bounds are sampled at this many points a side
_MOST_SAMPLES = 2048
_SLOPE_MARGIN = 1.25
_DEPTH_MARGIN = 0.1  # of the mirror's length
_STEPS = 100  # of Newton or bisection; the bracket is exhausted after about 60
_EXHAUSTED = 1e-15  # of the distance: a bracket this narrow holds no other number
_NEARLY = 1e-12  # of the mirror's length: a Newton step this short is followed by no other
_MARCH = 4096  # shortest marching steps that cross the mirror
_INSIDE = 1e-9  # of the mirror's length: distance that counts as on the surface; marching rays meet it deeper


@dataclass(frozen=True)
class Bounds:
    """Limits of a surface over a mirror: no height below `lowest` (mm), no slope above `slope`."""

    mirror: Mirror
    lowest: float
    slope: float


def bounds_of(surface: Surface, mirror: Mirror) -> Bounds:
    """Bounds from samples of the surface (as fine as its grid, if any), widened for heights between them."""
    fine = _SAMPLES if surface.grid is None else min(max(_SAMPLES, *surface.grid.z.shape), _MOST_SAMPLES)
    x, y = np.meshgrid(np.linspace(0.0, mirror.length, fine), np.linspace(0.0, mirror.width, fine))
    height, slope_x, slope_y = surface.evaluate(x, y)
    heights, slopes = _finite(height), _finite(np.hypot(slope_x, slope_y))
    lowest = heights.min() - (heights.max() - heights.min()) - _DEPTH_MARGIN * mirror.length
    return Bounds(mirror, float(lowest), float(_SLOPE_MARGIN * slopes.max() + 1e-6))


def _finite(values: Float) -> Float:
    values = np.atleast_1d(np.asarray(values, np.float64))
    finite = values[np.isfinite(values)]
    return finite if finite.size else np.zeros(1)


def first_meeting(origins: Float, directions: Float, surface: Surface, bounds: Bounds) -> Float:
    """Distances t (n,) in mm at which rays (3, n), coming from z > h, first meet the surface; NaN: never."""
    low, high = _span(origins, directions, bounds.mirror)
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        high = np.minimum(high, (bounds.lowest - origins[2]) / directions[2])
    t = np.full_like(low, np.nan)
    able = np.flatnonzero((low < high) & (directions[2] < 0))
    o, d, low, high = origins[:, able], directions[:, able], low[able], high[able]
    above = ~(_clearance(o, d, surface, low) < 0)  # NaN, where the surface has a hole, is above
    crosses = above & ~(_clearance(o, d, surface, high) > 0)
    wanders = above & ~_is_steady(d, bounds, -1.0)
    if wanders.any():
        bracket = _march(o[:, wanders], d[:, wanders], surface, bounds, low[wanders], high[wanders])
        low[wanders], high[wanders] = bracket
        crosses[wanders] = np.isfinite(high[wanders])
    t[able[crosses]] = _newton(o[:, crosses], d[:, crosses], surface, bounds, low[crosses], high[crosses])
    return t


def meets_again(points: Float, directions: Float, distances: Float, surface: Surface, bounds: Bounds) -> Mask:
    """Whether rays (3, n) that leave the surface at `points` meet it again within `distances` (mm)."""
    again = np.zeros(distances.shape, np.bool_)
    risky = ~_is_steady(directions, bounds, 1.0)
    if not risky.any():
        return again
    o, d = points[:, risky], directions[:, risky]
    _, high = _span(o, d, bounds.mirror)
    _, reached = _march(o, d, surface, bounds, np.zeros(o.shape[1]), np.minimum(high, distances[risky]))
    again[risky] = np.isfinite(reached)
    return again


def _is_steady(directions: Float, bounds: Bounds, sign: float) -> Mask:
    """Rays on which F only rises (sign 1) or falls (sign -1)."""
    steady: Mask = sign * directions[2] > bounds.slope * np.hypot(directions[0], directions[1])
    return steady


def _span(origins: Float, directions: Float, mirror: Mirror) -> tuple[Float, Float]:
    """Interval of t >= 0 in which rays (3, n) are above or below the mirror's extent (low >= high: none)."""
    low, high = np.zeros(origins.shape[1]), np.full(origins.shape[1], np.inf)
    for start, step, most in zip(origins, directions, (mirror.length, mirror.width), strict=False):
        with np.errstate(divide="ignore", invalid="ignore"):
            before, after = (0.0 - start) / step, (most - start) / step
        always = (step == 0) & (start >= 0) & (start <= most)
        never = (step == 0) & ~always
        first, last = np.minimum(before, after), np.maximum(before, after)
        low = np.maximum(low, np.where(always, 0.0, np.where(never, np.inf, first)))
        high = np.minimum(high, np.where(always, np.inf, np.where(never, 0.0, last)))
    return low, high


def _clearance(origins: Float, directions: Float, surface: Surface, t: Float) -> Float:
    x, y, z = origins + t * directions
    clearance: Float = z - surface.height(x, y)
    return clearance


def _newton(o: Float, d: Float, surface: Surface, bounds: Bounds, low: Float, high: Float) -> Float:
    """Crossing of F between low (F >= 0) and high (F <= 0), to machine precision; NaN where F jumps."""
    result = np.full_like(low, np.nan)
    near = _NEARLY * bounds.mirror.length
    t = np.clip(-o[2] / d[2], low, high)  # where the resting mirror is
    left = np.arange(t.size)
    for _ in range(_STEPS):
        x, y, z = o + t * d
        height, slope_x, slope_y = surface.evaluate(x, y)
        f = z - height
        below = f < 0
        low, high = np.where(below, low, t), np.where(below | (f == 0), t, high)
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = t - f / (d[2] - slope_x * d[0] - slope_y * d[1])
        inside = (newton >= low) & (newton <= high)
        arrived = inside & (np.abs(newton - t) <= near)
        done = arrived | (high - low <= _EXHAUSTED * high)
        t = np.where(inside, newton, 0.5 * (low + high))
        found = arrived | (
            np.abs(f) <= _INSIDE * bounds.mirror.length
        )  # else the bracket closed on a step of the surface, not on the surface
        result[left[done & found]] = t[done & found]
        left, t, low, high = left[~done], t[~done], low[~done], high[~done]
        if not left.size:
            break
        if done.any():
            o, d = o[:, ~done], d[:, ~done]
    return result


def _march(
    o: Float, d: Float, surface: Surface, bounds: Bounds, low: Float, high: Float
) -> tuple[Float, Float]:
    """Bracket (before, after) of the first place in low..high where F < 0; after is NaN if there is none."""
    shortest = np.hypot(bounds.mirror.length, bounds.mirror.width) / _MARCH
    below = -_INSIDE * bounds.mirror.length
    steepest = np.abs(d[2]) + bounds.slope * np.hypot(d[0], d[1])
    before, after = low.copy(), np.full_like(low, np.nan)
    left, t = np.arange(low.size), low.copy()
    while left.size:
        f = _clearance(o[:, left], d[:, left], surface, t)
        hit = f < below
        after[left[hit]] = t[hit]
        before[left[~hit]] = t[~hit]
        going = ~hit & (t < high[left])
        left, f, t = left[going], f[going], t[going]
        t = np.minimum(t + np.maximum(f / steepest[left], shortest), high[left])
    return before, after


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
