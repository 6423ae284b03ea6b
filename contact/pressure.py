"""Pressure and force behind the contacts, by the elasticity of the layer whose boundary the mirror is.

Pressure is even on squares of a grid around the contacts and presses only; where it presses, the boundary
follows the measured height:  sum_j A_ij p_j = z_i,  p >= 0,  found by leaving out squares that would pull.
A is

- of a half-space, Love's deflection under an evenly loaded square (A. E. H. Love, Phil. Trans. R. Soc. A
  228:377, 1929; K. L. Johnson, Contact Mechanics, 1985, eq. 3.25), times 1 / (pi E*), E* = E / (1 - nu^2);
- of a layer bonded to a rigid base, in the Fourier domain  2 / (E* k) S(k h)  with

      S(q) = ((3 - 4 nu) sinh 2q - 2q) / ((3 - 4 nu) cosh 2q + 2 q^2 + 5 - 12 nu + 8 nu^2)

  (J. A. Greenwood and J. R. Barber, Int. J. Mech. Sci. 54:78, 2012; its limits: S = 1 is the half-space,
  small q a Winkler foundation), times the transform of the square.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy

from optolever.arrays import Floats, Ints, Mask
from optolever.scene import Layer

__all__ = ["BONDED", "Pressed", "bonded", "deflection", "forces_on"]

_SQUARES, _MOST = 350, 450  # of the grid around all contacts: aimed at, at most
_PITCHES = tuple(0.0625 * 2 ** (k / 2) for k in range(16))  # mm: a table of deflections each
_BESIDE = 0.6  # of the radius of a contact's area: as far beside its cells pressure is looked for
_RIDGE = 1e-6  # of a square's own deflection: a thin incompressible layer's matrix is nearly singular
_ROUNDS = 20  # of leaving out squares
BONDED = 12  # thicknesses: beyond, the base leaves no deflection
_DEEPEST = 20.0  # wave numbers times thickness: of larger ones S is 1
_SPAN = 96  # squares to each side that a table holds

#: Of places (n, 2) and a pitch: mean heights (n,) of squares there, mm.
_Height = Callable[[Floats, float], Floats]


@dataclass(frozen=True, slots=True, eq=False)
class Pressed:
    """Pressures (n,), N/mm^2, on squares of a pitch, mm, at places (n, 2); owner (n,): number of the contact;
    weights (contacts, n): of the heights in the sums of the pressures."""

    pressure: Floats
    places: Floats
    pitch: float
    owner: Ints
    weights: Floats


def forces_on(layer: Layer, cells: list[Floats], radii: list[float], height: _Height) -> Pressed:
    """Pressures behind contacts: places (k, 2) of each one's cells, radii of circles of their areas."""
    wanted = (1 + _BESIDE) * math.sqrt(math.pi * sum(radius**2 for radius in radii) / _SQUARES)
    for pitch in (*(one for one in _PITCHES[:-1] if one >= wanted), _PITCHES[-1]):
        places, owner = _squares(cells, radii, pitch)
        if len(places) < _MOST:
            break
    pressure, weights = _pressed(deflection(layer, pitch, places), height(places, pitch), owner)
    return Pressed(pressure, places, pitch, owner, weights)


def deflection(layer: Layer, pitch: float, places: Floats) -> Floats:
    """A (n, n), mm per N/mm^2: deflection at places (n, 2) of a grid of that pitch under its squares, mm."""
    table = _table(layer, pitch)
    x, y = (np.minimum(np.abs(at[:, None] - at), _SPAN) for at in np.rint(places.T / pitch).astype(np.int64))
    return np.asarray(table.take(y * (_SPAN + 1) + x))


@lru_cache(maxsize=8)
def bonded(poisson: float) -> "scipy.interpolate.CubicSpline":
    """What a base adds to the deflection under a force, pi E* h w over the force less h / r, at distances r
    in units of the thickness h: the integral of (S(q) - 1) J0(q r / h) over q; as good as -h / r from 12 h
    on."""
    r, (nodes, weights) = np.linspace(0.0, BONDED, 1 + 32 * BONDED), np.polynomial.legendre.leggauss(256)
    q, weights = _DEEPEST * (nodes + 1) / 2, _DEEPEST * weights / 2
    return scipy.interpolate.CubicSpline(
        r, scipy.special.j0(np.outer(r, q)) @ (weights * (_ratio(poisson, q) - 1))
    )


def _squares(cells: list[Floats], radii: list[float], pitch: float) -> tuple[Floats, Ints]:
    """Places (n, 2) on a grid in and beside the contacts, and the contact that each is nearest to (n,)."""
    owner = np.repeat(np.arange(len(cells)), [len(at) for at in cells])
    reach = _BESIDE / pitch * np.array(radii)
    index, first = np.unique(np.rint(np.concatenate(cells) / pitch), axis=0, return_index=True)
    sides = map(np.arange, index.min(axis=0) - math.ceil(reach.max()), index.max(axis=0) + reach.max() + 1)
    places = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 2)
    away, nearest = scipy.spatial.KDTree(index).query(places)
    owner = owner[first][nearest]
    kept = away <= reach[owner]
    return places[kept] * pitch, owner[kept]


def _pressed(matrix: Floats, height: Floats, owner: Ints) -> tuple[Floats, Floats]:
    """Pressures (n,) >= 0, and the weights (contacts, n) by which heights add up to the sums of the
    pressures."""
    pressing: Mask = height > 0
    pressure = np.zeros(height.size)
    factor = None
    for _ in range(_ROUNDS):
        if not pressing.any():
            break
        part = matrix[np.ix_(pressing, pressing)]
        factor = scipy.linalg.cho_factor(part + _RIDGE * part[0, 0] * np.eye(len(part)))
        pressure[:] = 0.0
        pressure[pressing] = scipy.linalg.cho_solve(factor, height[pressing])
        if not (pressure < 0).any():
            break
        pressing = pressing & (pressure > 0)
    count = int(owner.max()) + 1 if owner.size else 0
    weights = np.zeros((count, height.size))
    if factor is not None and pressing.any():
        sums = (owner[pressing][:, None] == np.arange(count)).astype(np.float64)
        weights[:, pressing] = scipy.linalg.cho_solve(factor, sums).T
    return np.maximum(pressure, 0.0), weights


@lru_cache(maxsize=32)
def _table(layer: Layer, pitch: float) -> Floats:
    """Deflection (SPAN + 1, SPAN + 1) so many squares away along y, along x; mm per N/mm^2."""
    if layer.thickness_mm is None:
        at = np.arange(_SPAN + 1, dtype=np.float64) * pitch
        return _love(at[None, :], at[:, None], pitch) / (math.pi * layer.plane_modulus)
    count = scipy.fft.next_fast_len(2 * _SPAN + math.ceil(12 * layer.thickness_mm / pitch), real=True)
    along, across = scipy.fft.rfftfreq(count, pitch), scipy.fft.fftfreq(count, pitch)
    kernel = _layer_transform(layer, 2 * math.pi * np.hypot(across[:, None], along))
    kernel *= np.sinc(across[:, None] * pitch) * np.sinc(along * pitch)
    table = scipy.fft.irfft2(kernel, (count, count))
    return np.asarray(table[: _SPAN + 1, : _SPAN + 1])


def _layer_transform(layer: Layer, k: Floats) -> Floats:
    """Deflection over pressure of waves of wave number k (rad/mm), mm per N/mm^2."""
    h, nu = float(layer.thickness_mm or 0.0), layer.poisson
    q = np.minimum(k * h, _DEEPEST)
    still = h * (1 - 2 * nu) / (1 - nu) ** 2 / layer.plane_modulus
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(q > 1e-6, 2 * _ratio(nu, q) / (layer.plane_modulus * k), still)


def _ratio(poisson: float, q: Floats) -> Floats:
    """S, deflection over that of a half-space, of waves of wave number q / h."""
    a, b = 3 - 4 * poisson, 5 - 12 * poisson + 8 * poisson**2
    return (a * np.sinh(2 * q) - 2 * q) / (a * np.cosh(2 * q) + 2 * q**2 + b)


def _love(x: Floats, y: Floats, side: float) -> Floats:
    """pi E* times the deflection at (x, y) of a half-space under unit pressure on a square at the origin."""
    a, b, c, d = x + side / 2, x - side / 2, y + side / 2, y - side / 2

    def term(u: Floats, v: Floats, w: Floats) -> Floats:
        return u * np.log((v + np.hypot(u, v)) / (w + np.hypot(u, w)))

    return term(a, c, d) - term(b, c, d) + term(c, a, b) - term(d, a, b)
