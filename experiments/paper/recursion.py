"""The paper's recursion: from (m, w) along a line to slope angle and depth, marched from either edge.

Each step adds the rise of the step before (18), finds the place by (14), the angle by (17) and (9), and from
the change of angle the rise that serves the next step (19). The series of rises starts at l = 0 with d = 0,
the series of drops at l = L0; the paper's result is their mean. Any number of lines (image rows) marches at
once.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from .equations import angle_increment, height_increment, mirror_position, slope_angle

__all__ = ["PaperGeometry", "PaperResult", "Profile", "SeriesName", "recursion", "series"]

Array = NDArray[np.float64]
_TINY = 1e-12  # mm
#: Which of the paper's series: drops from l = L0, rises from l = 0, their mean.
SeriesName = Literal["mean", "rises", "drops"]


@dataclass(frozen=True, slots=True)
class PaperGeometry:
    """A prism cut: angles alpha0 and beta0 (rad) of pattern and capture face with the mirror, its length L0
    (mm).

    The camera is at infinity: beta1 = beta2 = beta0.
    """

    alpha0: float
    beta0: float
    length: float


@dataclass(frozen=True, slots=True)
class Profile:
    """Points of the mirror along lines, (..., points): place l, depth d (mm), slope angle theta (rad); NaN:
    none.
    """

    l: Array
    d: Array
    theta: Array

    def reversed(self) -> "Profile":
        """The same points in opposite order along the lines."""
        return Profile(self.l[..., ::-1], self.d[..., ::-1], self.theta[..., ::-1])


@dataclass(frozen=True, slots=True)
class PaperResult:
    """The series of rises (from l = 0), of drops (from l = L0), and their mean, the paper's answer."""

    rises: Profile
    drops: Profile
    mean: Profile

    def series(self, name: SeriesName) -> Profile:
        """One of the three by its name."""
        return {"rises": self.rises, "drops": self.drops, "mean": self.mean}[name]

    def reversed(self) -> "PaperResult":
        """The same points in opposite order along the lines."""
        return PaperResult(self.rises.reversed(), self.drops.reversed(), self.mean.reversed())


def series(m: Array, w: Array, geometry: PaperGeometry, *, sign: int = 1, gamma: bool = True) -> Profile:
    """March along the last axis of m, w (lines, points) in the order given, from d = 0 at the first point.

    sign: +1 the reflection law, -1 the paper's print; gamma: kept in (12), or set to 0 as in (16). Points
    without data (NaN) come back as NaN. The march steps over them with the last rise, as often as the gap
    in w holds the last step: once where a crease hides lattice lines, often where pixels are missing.
    """
    m_t, w_t = (np.ascontiguousarray(np.moveaxis(values, -1, 0)) for values in (m, w))
    l_t, d_t, theta_t = (np.full(m_t.shape, np.nan) for _ in range(3))
    started, gap = (np.zeros(m_t.shape[1:], dtype=bool) for _ in range(2))
    depth, rise, place, angle, last, step = (np.zeros(started.shape) for _ in range(6))
    first_step = _first_step(w_t, geometry)
    for n in range(m_t.shape[0]):
        jump = np.abs(w_t[n] - last)
        d = depth + rise * np.where(
            gap & (step > 0), np.maximum(np.rint(jump / np.maximum(step, _TINY)), 1), 1
        )
        l = mirror_position(w_t[n], d, geometry.beta0, geometry.length)
        theta = slope_angle(
            geometry.alpha0 + angle_increment(l, d, m_t[n], geometry.alpha0, gamma), geometry.beta0, sign
        )
        valid = np.isfinite(theta)
        next_rise = height_increment(l - place, angle, theta - angle)
        l_t[n], d_t[n], theta_t[n] = (np.where(valid, value, np.nan) for value in (l, d, theta))
        rise = np.where(valid, np.where(started, next_rise, first_step * np.tan(theta)), rise)
        step = np.where(valid & started & ~gap, jump, step)
        depth, place, angle, last = (
            np.where(valid, new, old) for new, old in ((d, depth), (l, place), (theta, angle), (w_t[n], last))
        )
        started, gap = started | valid, (started | gap) & ~valid
    return Profile(*(np.moveaxis(values, 0, -1) for values in (l_t, d_t, theta_t)))


def recursion(
    m: Array, w: Array, geometry: PaperGeometry, *, sign: int = 1, gamma: bool = True
) -> PaperResult:
    """Both series and their mean, points along the last axis of m, w (lines, points) ordered from l = 0 to l
    = L0.
    """
    rises = series(m, w, geometry, sign=sign, gamma=gamma)
    drops = series(m[..., ::-1], w[..., ::-1], geometry, sign=sign, gamma=gamma).reversed()
    depth = (rises.d + drops.d) / 2
    mean = Profile(
        mirror_position(w, depth, geometry.beta0, geometry.length), depth, (rises.theta + drops.theta) / 2
    )
    return PaperResult(rises, drops, mean)


def _first_step(w: Array, geometry: PaperGeometry) -> Array:
    """The first Dl: distance of the first two known points at depth 0, per line; w is (points, lines)."""
    known = np.isfinite(w)
    order = np.cumsum(known, axis=0)
    first, second = (np.where(known & (order == k), w, 0.0).sum(axis=0) for k in (1, 2))
    step = mirror_position(second, 0.0, geometry.beta0, geometry.length) - mirror_position(
        first, 0.0, geometry.beta0, geometry.length
    )
    return np.where(order[-1] >= 2, step, 0.0)
