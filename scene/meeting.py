"""Where rays meet a surface: the first crossing of F(t) = z(t) - h(x(t), y(t)) over the mirror's extent.

Where |d_z| exceeds the surface's largest slope times |d_xy|, F falls steadily: one crossing, by Newton's
method inside a shrinking bracket. Only the other rays are marched, in steps that F cannot cross (F over its
largest slope), but not in shorter ones than 1/4096 of the mirror.
"""

from dataclasses import dataclass

import numpy as np

from optolever.arrays import Mask

from .fields import Float
from .mirror import Mirror
from .surface import Surface

__all__ = ["Bounds", "bounds_of", "first_meeting", "meets_again"]

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
