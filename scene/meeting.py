"""Where rays meet a surface: the first crossing of F(t) = z(t) - h(x(t), y(t)) over the mirror's extent.

Where |d_z| exceeds the surface's largest slope times |d_xy|, F falls steadily: one crossing, found by Newton's method
inside a shrinking bracket. Only the other rays are marched, in steps that F cannot cross (F over its largest slope).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .mirror import Mirror
from .record import Float
from .surface import Surface

__all__ = ["Bounds", "bounds_of", "first_meeting", "meets_again"]

_SAMPLES = 384  # the surface's bounds are sampled at this many points a side
_SLOPE_MARGIN = 1.25
_STEPS = 100  # of Newton or bisection; the bracket is exhausted after about 60
_NEARLY = 1e-9  # of the mirror's length: a Newton step this short is followed by no other, being quadratic
_MARCH = 4096  # shortest marching steps that cross the mirror
_INSIDE = 1e-9  # of the mirror's length: a ray this far below the surface has met it

Bool = NDArray[np.bool_]


@dataclass(frozen=True)
class Bounds:
    """Limits of a surface over a mirror: heights lowest..highest (mm, with margin), largest slope (with margin)."""

    mirror: Mirror
    lowest: float
    highest: float
    slope: float


def bounds_of(surface: Surface, mirror: Mirror) -> Bounds:
    """Bounds from samples of the surface, widened for what lies between them."""
    x = np.linspace(0.0, mirror.length, _SAMPLES)
    y = np.linspace(0.0, mirror.width, _SAMPLES)[:, None]
    x, y = np.broadcast_arrays(x, y)
    z = np.asarray(surface.height(x, y), np.float64)
    slope_x, slope_y = surface.gradient(x, y)
    low, high, slope = (
        _extreme(z, np.nanmin),
        _extreme(z, np.nanmax),
        _extreme(np.hypot(slope_x, slope_y), np.nanmax),
    )
    margin = 0.5 * (high - low) + 1e-3 * mirror.length
    return Bounds(mirror, low - margin, high + margin, _SLOPE_MARGIN * slope + 1e-6)


def _extreme(values: Float, pick: object) -> float:
    finite = values[np.isfinite(values)]
    return float(pick(finite)) if finite.size else 0.0  # type: ignore[operator]


def first_meeting(origins: Float, directions: Float, surface: Surface, bounds: Bounds) -> Float:
    """Distances t (n,) in mm at which rays (3, n), coming from z > h, first meet the surface; NaN where they do not."""
    low, high = _span(origins, directions, bounds)
    start, stop = (
        _clearance(origins, directions, surface, low),
        _clearance(origins, directions, surface, high),
    )
    steady = _is_steady(directions, bounds, -1.0)
    crosses = (low < high) & (start >= 0)
    wanders = crosses & ~steady
    if wanders.any():
        reached = np.full_like(low, np.nan)
        low[wanders], reached[wanders] = _march(
            origins[:, wanders], directions[:, wanders], surface, bounds, low[wanders], high[wanders]
        )
        high[wanders] = reached[wanders]
        crosses &= ~wanders | np.isfinite(high)
    crosses &= wanders | (stop <= 0)
    t = np.full_like(low, np.nan)
    t[crosses] = _newton(
        origins[:, crosses], directions[:, crosses], surface, bounds, low[crosses], high[crosses]
    )
    return t


def meets_again(points: Float, directions: Float, distances: Float, surface: Surface, bounds: Bounds) -> Bool:
    """Whether rays (3, n) that leave the surface at `points` meet it again within `distances` (mm) and the mirror's extent."""
    again = np.zeros(distances.shape, np.bool_)
    risky = ~_is_steady(directions, bounds, 1.0)
    if not risky.any():
        return again
    o, d = points[:, risky], directions[:, risky]
    _, high = _span(o, d, bounds)
    _, reached = _march(o, d, surface, bounds, np.zeros(o.shape[1]), np.minimum(high, distances[risky]))
    again[risky] = np.isfinite(reached)
    return again


def _is_steady(directions: Float, bounds: Bounds, sign: float) -> Bool:
    """Rays on which F only rises (sign 1) or falls (sign -1)."""
    steady: Bool = sign * directions[2] > bounds.slope * np.hypot(directions[0], directions[1])
    return steady


def _span(origins: Float, directions: Float, bounds: Bounds) -> tuple[Float, Float]:
    """Interval of t >= 0 in which a ray is within the mirror's extent and the surface's heights (empty: low >= high)."""
    low, high = np.zeros(origins.shape[1]), np.full(origins.shape[1], np.inf)
    limits = ((0.0, bounds.mirror.length), (0.0, bounds.mirror.width), (bounds.lowest, bounds.highest))
    for start, step, (least, most) in zip(origins, directions, limits, strict=True):
        with np.errstate(divide="ignore", invalid="ignore"):
            a, b = (least - start) / step, (most - start) / step
        still = step == 0
        within = (start >= least) & (start <= most)
        a = np.where(still, np.where(within, -np.inf, np.inf), a)
        b = np.where(still, np.where(within, np.inf, -np.inf), b)
        low, high = (
            np.maximum(low, np.where(still, a, np.minimum(a, b))),
            np.minimum(high, np.where(still, b, np.maximum(a, b))),
        )
    bad = ~(low < high)
    low[bad], high[bad] = 0.0, 0.0
    return low, high


def _clearance(origins: Float, directions: Float, surface: Surface, t: Float) -> Float:
    x, y, z = origins + t * directions
    clearance: Float = z - surface.height(x, y)
    return clearance


def _newton(o: Float, d: Float, surface: Surface, bounds: Bounds, low: Float, high: Float) -> Float:
    """Crossing of F between low (F >= 0) and high (F <= 0), to machine precision."""
    result = np.empty_like(low)
    near = _NEARLY * bounds.mirror.length
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.clip(-o[2] / d[2], low, high)  # where the resting mirror is
    left = np.arange(t.size)
    for _ in range(_STEPS):
        if not left.size:
            break
        x, y, z = o + t * d
        f = z - surface.height(x, y)
        slope_x, slope_y = surface.gradient(x, y)
        low, high = np.where(f >= 0, t, low), np.where(f <= 0, t, high)
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = t - f / (d[2] - slope_x * d[0] - slope_y * d[1])
        inside = (newton >= low) & (newton <= high)
        moved = np.where(inside, newton, 0.5 * (low + high))
        done = (inside & (np.abs(moved - t) <= near)) | (f == 0) | (high - low <= 1e-15 * np.abs(high))
        t = np.where(f == 0, t, moved)
        if done.any():
            result[left[done]] = t[done]
            keep = ~done
            left, t, low, high = left[keep], t[keep], low[keep], high[keep]
            o, d = o[:, keep], d[:, keep]
    result[left] = t
    return result


def _march(
    o: Float, d: Float, surface: Surface, bounds: Bounds, low: Float, high: Float
) -> tuple[Float, Float]:
    """Bracket (before, after) of the first place in low..high where F < 0; after is NaN where there is none."""
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
