"""Dents of known pressure on a half-space or a bonded layer, by formulas that `contact` does not use.

A flat punch of radius t, pressed in by d, leaves d inside and 2 d / pi asin(t / r) outside, under
F = 2 E* t d (K. L. Johnson, Contact Mechanics, 1985, eq. 3.37 f.). A punch of any round form is a sum of flat
ones (I. N. Sneddon, Int. J. Engng Sci. 3:47, 1965). A layer's base is met by waves of Airy's stress.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from optolever.arrays import Floats
from optolever.scene import Surface

__all__ = ["Dent", "ball", "base", "flat_punch", "gaussian", "on_layer", "rounded_punch", "surface_of"]

_PUNCHES = 401
_FAR = 160.0  # mm


@dataclass(frozen=True)
class Dent:
    """height: of distances (n,), mm; depth (mm); radius (mm) of the pressure; load: force over E*, mm^2."""

    height: Callable[[Floats], Floats]
    depth: float
    radius: float
    load: float

    def table(self) -> "scipy.interpolate.CubicSpline":
        """Of heights, dense around the rim."""
        beside = self.radius * np.concatenate(
            [1 - np.geomspace(1, 1e-4, 300), 1 + np.geomspace(1e-4, 1, 300)]
        )
        r = np.unique(np.concatenate([beside, np.geomspace(2 * self.radius, _FAR, 600)]))
        return scipy.interpolate.CubicSpline(r, self.height(r))


def flat_punch(radius: float, depth: float) -> Dent:
    """A flat cylinder with a sharp edge."""

    def height(r: Floats) -> Floats:
        return np.asarray(depth * 2 / np.pi * np.arcsin(radius / np.maximum(r, radius)))

    return Dent(height, depth, radius, 2 * radius * depth)


def rounded_punch(radius: float, depth: float, flat: float) -> Dent:
    """Flat ones of `flat` to 1 radii, d growing with t from zero: a plateau with a rounded rim."""
    t = radius * (flat + (1 - flat) * (np.arange(_PUNCHES) + 0.5) / _PUNCHES)
    d = t - flat * radius
    d *= depth / d.sum()

    def height(r: Floats) -> Floats:
        return np.asarray(np.arcsin(t / np.maximum(np.ravel(r)[:, None], t)) @ d * 2 / np.pi).reshape(
            np.shape(r)
        )

    return Dent(height, depth, radius, float(2 * (t * d).sum()))


def ball(radius: float, depth: float) -> Dent:
    """Hertz: its radius is radius^2 / depth (Johnson, eq. 3.42)."""

    def height(r: Floats) -> Floats:
        q = r / radius
        far = np.maximum(q, 1.0)
        outside = ((2 - far**2) * np.arcsin(1 / far) + np.sqrt(far**2 - 1)) / np.pi
        return np.asarray(depth * np.where(q < 1, 1 - q**2 / 2, outside))

    return Dent(height, depth, radius, 4 / 3 * radius * depth)


def gaussian(radius: float, depth: float) -> Dent:
    """A finger that fades: no pressure on a half-space makes it."""
    return Dent(lambda r: np.asarray(depth * np.exp(-np.square(r / radius))), depth, radius, np.nan)


def on_layer(radius: float, depth: float, thickness: float, poisson: float) -> Dent:
    """The pressure of a ball of such a depth on a half-space, on a layer."""
    above, added = ball(radius, depth), base(radius, depth, thickness, poisson)

    def height(r: Floats) -> Floats:
        return np.asarray(above.height(r) + added(np.minimum(r, _FAR)))

    return Dent(height, float(height(np.zeros(1))[0]), radius, above.load)


def base(radius: float, depth: float, thickness: float, poisson: float) -> "scipy.interpolate.CubicSpline":
    """Change of a ball's dent by a rigid base, by distance: waves of Airy's stress f = (A + B z) e^-z +
    (C + D z) e^z in plane strain, f = 1 and f' = 0 where it presses; nothing moves at depth q = k h."""

    def terms(z: Any, order: int) -> Any:
        down, up = (-1) ** order * np.exp(-z), np.exp(z)
        return np.stack([down, (z - order) * down, up, (z + order) * up], axis=-1)

    step, nu = 16 / thickness / 4000, poisson
    k = step * (np.arange(4000) + 0.5)
    q = k * thickness
    still = (1 - nu) * terms(q, 2) + nu * terms(q, 0), (1 - nu) * terms(q, 3) - (2 - nu) * terms(q, 1)
    equations = np.stack([terms(0 * q, 0), terms(0 * q, 1), *still], axis=1)
    stress = np.linalg.solve(equations, np.eye(4)[:, :1])
    ratio = (terms(0 * q, 3) * stress[..., 0]).sum(axis=1) / 2  # over the deflection of a half-space
    load = (np.sin(k * radius) - k * radius * np.cos(k * radius)) / (k * radius) ** 3
    r = np.linspace(0, _FAR, 1200)
    added = scipy.special.j0(np.outer(r, k)) @ ((ratio - 1) * load) * step
    return scipy.interpolate.CubicSpline(r, 4 * depth * radius / np.pi * added)


def surface_of(dents: Sequence[tuple[Dent, float, float]]) -> Surface:
    """The sum of dents at places x, y: pressures add."""
    tables = {id(dent): dent.table() for dent, _, _ in dents}

    def both(x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
        z, zx, zy = np.zeros((3, *np.shape(x)))
        for dent, cx, cy in dents:
            r, table = np.hypot(x - cx, y - cy), tables[id(dent)]
            near = np.minimum(r, _FAR)
            slope = table(near, 1) / np.maximum(r, 1e-9)
            z, zx, zy = z + table(near), zx + slope * (x - cx), zy + slope * (y - cy)
        return z, zx, zy

    return Surface(lambda x, y: both(x, y)[0], lambda x, y: both(x, y)[1:], both=both)
