"""The seed's own simulation, exact: one line through the dent, by the reflection law or by the printed sign.

For a point of the mirror (12) and (14) give where its ray leaves the pattern and meets the capture face; a
given place on either face is found by bisection.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optolever.reconstruct import PaperGeometry, capture_position, pattern_angle, pattern_position
from optolever.scene import Scene, Surface

__all__ = ["Points", "lattice_points", "pixel_points", "seen_points"]

Array = NDArray[np.float64]
_HALVINGS = 60


@dataclass(frozen=True, slots=True)
class Points:
    """Mirror points along a line (points,), l rising: measured m and w (mm); true l, d (mm) and theta
    (rad).
    """

    m: Array
    w: Array
    l: Array
    d: Array
    theta: Array


@dataclass(frozen=True, slots=True)
class Line:
    """The cut y = const through a dent, one y for all points or one each (mm)."""

    surface: Surface
    geometry: PaperGeometry
    y: Array | float

    def depth(self, l: Array) -> Array:
        """d at l."""
        return np.asarray(self.surface.height(l, np.broadcast_to(self.y, l.shape)), dtype=np.float64)

    def theta(self, l: Array) -> Array:
        """The slope angle along the line at l."""
        return np.arctan(np.asarray(self.surface.gradient(l, np.broadcast_to(self.y, l.shape))[0]))

    def m(self, l: Array, sign: int) -> Array:
        """The pattern position that the ray at l comes from."""
        g = self.geometry
        alpha = pattern_angle(g.beta0, self.theta(l), sign)
        return pattern_position(l, self.depth(l), alpha, g.alpha0)

    def w(self, l: Array) -> Array:
        """The capture position that sees l."""
        g = self.geometry
        return capture_position(l, self.depth(l), g.beta0, g.beta0, g.length)

    def points(self, l: Array, sign: int) -> Points:
        """Everything about the mirror points at l."""
        return Points(self.m(l, sign), self.w(l), l, self.depth(l), self.theta(l))


def lattice_points(scene: Scene, surface: Surface, geometry: PaperGeometry, count: int, sign: int) -> Points:
    """`count` lines, equally spaced (half a space from the ends) on the stretch of the pattern seen at rest.

    Lines that no mirror point shows (a cusp skips some) are left out; of a line that several show, one is
    found.
    """
    line = Line(surface, geometry, scene.mirror.width / 2)
    rest = geometry.length * np.cos(geometry.beta0) / np.cos(geometry.beta0 - geometry.alpha0)
    m = rest * (np.arange(count) + 0.5) / count
    l = _where_rising(lambda x: line.m(x, sign), m, geometry.length)
    found = np.abs(line.m(l, sign) - m) < 1e-6 * rest
    return line.points(l[found], sign)


def pixel_points(scene: Scene, surface: Surface, geometry: PaperGeometry, w: Array, sign: int) -> Points:
    """The mirror points that the capture positions w (mm) see, in order of l."""
    line = Line(surface, geometry, scene.mirror.width / 2)
    return line.points(np.sort(_seen(line, w)), sign)


def seen_points(surface: Surface, geometry: PaperGeometry, m: Array, w: Array, y: Array) -> Points:
    """Measured points m, w with the truth at the places that were measured: where w sees the mirror at
    this y.
    """
    line = Line(surface, geometry, np.nan_to_num(y))
    l = np.where(np.isfinite(w), _seen(line, w), np.nan)
    order = np.argsort(m)
    return Points(m[order], w[order], l[order], line.depth(l)[order], line.theta(l)[order])


def _seen(line: Line, w: Array) -> Array:
    return _where_rising(lambda x: -line.w(x), -w, line.geometry.length)


def _where_rising(function: Callable[[Array], Array], values: Array, length: float) -> Array:
    """Bisection on (0, length): where a rising function takes the values."""
    low, high = np.zeros_like(values), np.full_like(values, length)
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        below = function(middle) < values
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return (low + high) / 2
