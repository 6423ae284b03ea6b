"""Pressure and force behind the contacts, by the elasticity of the layer whose boundary the mirror is.

Pressure is even on squares of a grid around the contacts and presses only; where it presses, the boundary
follows the measured height:  sum_j A_ij p_j = z_i,  p >= 0,  found by leaving out squares that would pull. A
is

- of a half-space, Love's deflection under an evenly loaded square (A. E. H. Love, Phil. Trans. R. Soc. A
228:377,
  1929; K. L. Johnson, Contact Mechanics, 1985, eq. 3.25), times 1 / (pi E*), E* = E / (1 - nu^2);
- of a layer bonded to a rigid base, in the Fourier domain  2 / (E* k) S(k h)  with

      S(q) = ((3 - 4 nu) sinh 2q - 2q) / ((3 - 4 nu) cosh 2q + 2 q^2 + 5 - 12 nu + 8 nu^2)

  (J. A. Greenwood and J. R. Barber, Int. J. Mech. Sci. 54:78, 2012; its limits: S = 1 is the half-space,
  small q a Winkler foundation), times the transform of the square.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import scipy.fft
import scipy.linalg

from optolever.blocks import blas_on_one
from optolever.scene import Layer

from .arrays import Cells, Float, Labels, Mask
from .contact import Force, Touch
from .prepared import Prepared
from .reading import Reading

__all__ = ["Forces", "deflection", "forces_on"]

_SQUARES = 350  # of the grid around all contacts
_PITCHES = tuple(0.0625 * 2 ** (k / 2) for k in range(16))  # mm: a table of deflections each
_REACH = 1.6  # of the radius of a contact's area: where pressure is looked for
_RIDGE = 1e-6  # of a square's own deflection: a thin incompressible layer's matrix is nearly singular
_ROUNDS = 20  # of leaving out squares
_DEGREE = 4  # of the polynomial that gives a cell's row and column from x and y
_SPAN = 96  # squares to each side that a table holds


class Forces:
    """Forces of the contacts of a prepared rig's readings; each frame for itself."""

    def __init__(self, prepared: Prepared, layer: Layer) -> None:
        self._prepared, self._layer = prepared, layer
        lit = prepared.rig.lit
        x, y = (prepared.points[i][lit].astype(np.float64) for i in (0, 1))
        self._middle = np.array([x.mean(), y.mean()])
        self._extent = float(max(np.ptp(x), np.ptp(y), 1e-6))
        basis = self._basis(x, y)
        self._to_row, self._to_col = (
            np.linalg.lstsq(basis, index.astype(np.float64), rcond=None)[0] for index in np.nonzero(lit)
        )

    def update(
        self, reading: Reading, touches: tuple[Touch, ...], common: Cells | None = None
    ) -> tuple[Force, ...]:
        """The force of every contact, in the contacts' order. common (R, C): the part of the heights' sigma
        that they have in common, in the contacts' sigmas too."""
        if not touches:
            return ()
        circles = [(one.x, one.y, math.sqrt(one.area / math.pi)) for one in touches]
        found = forces_on(self._layer, circles, lambda at, pitch: self._sampled(reading.z, at, pitch))
        pressure, owner, area = found.pressure, found.owner, found.pitch**2
        peak = max(touches, key=lambda one: one.depth)
        shared = np.zeros_like(reading.z) if common is None else common
        at_peak = float(self._sampled(shared, np.array([[peak.x, peak.y]]), found.pitch)[0])
        noise = math.sqrt(max(peak.depth_sigma**2 - at_peak**2, 0.0))
        factor = noise / float(np.median(self._prepared.noise.sigma[self._prepared.rig.lit]))
        draws = self._sampled(self._prepared.noise.draws, found.places, found.pitch)
        spread = np.sqrt(np.mean(np.square(draws @ found.weights.T), axis=0)) * factor
        spread = np.hypot(spread, found.weights @ self._sampled(shared, found.places, found.pitch))
        newton = [float(pressure[owner == k].sum() * area) for k in range(len(touches))]
        modulus = self._layer.relative_sigma
        return tuple(
            Force(
                touch.identity,
                newton[k],
                math.hypot(float(spread[k] * area), newton[k] * modulus),
                float(pressure[owner == k].max(initial=0.0)),
            )
            for k, touch in enumerate(touches)
        )

    def _basis(self, x: Float, y: Float) -> Float:
        a, b = (x - self._middle[0]) / self._extent, (y - self._middle[1]) / self._extent
        powers = [a**i * b**j for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)]
        return np.stack(powers, axis=-1)

    def _sampled(self, z: Cells, places: Float, pitch: float) -> Float:
        """Mean heights (..., n) of squares around places (n, 2); z (..., R, C)."""
        basis = self._basis(places[:, 0], places[:, 1])
        row, col = (
            np.clip(basis @ part, 0, size - 1.001)
            for part, size in zip((self._to_row, self._to_col), z.shape[-2:], strict=True)
        )
        i, j = row.astype(np.int64), col.astype(np.int64)
        down, along = row - i, col - j
        side = max(1, round(pitch / math.sqrt(self._prepared.area)))
        smooth = _blurred(z, side)
        above = (1 - along) * smooth[..., i, j] + along * smooth[..., i, j + 1]
        below = (1 - along) * smooth[..., i + 1, j] + along * smooth[..., i + 1, j + 1]
        return np.asarray((1 - down) * above + down * below, np.float64)


def _blurred(z: Cells, side: int) -> Cells:
    """Means over squares of cells; z (..., R, C)."""
    flat = z.reshape(-1, *z.shape[-2:])
    return np.stack([cv2.blur(one, (side, side)) for one in flat]).reshape(z.shape)


@dataclass(frozen=True, slots=True, eq=False)
class Pressed:
    """Pressures (n,), N/mm^2, on squares of a pitch, mm, at places (n, 2); owner (n,): number of the contact;
    weights (contacts, n): of the heights in the sums of the pressures."""

    pressure: Float
    places: Float
    pitch: float
    owner: Labels
    weights: Float


def forces_on(
    layer: Layer, circles: list[tuple[float, float, float]], height: Callable[[Float, float], Float]
) -> Pressed:
    """Pressures behind contacts, circles (x, y, radius) of their areas; height: function of places (n, 2) and
    a pitch: mean heights (n,) of squares there, mm."""
    reached = [(x, y, _REACH * radius) for x, y, radius in circles]
    wanted = math.sqrt(sum(math.pi * radius**2 for _, _, radius in reached) / _SQUARES)
    pitch = next((one for one in _PITCHES if one >= wanted), _PITCHES[-1])
    places, owner = _squares(reached, pitch)
    with blas_on_one():
        pressure, weights = _pressed(deflection(layer, pitch, places), height(places, pitch), owner)
    return Pressed(pressure, places, pitch, owner, weights)


def deflection(layer: Layer, pitch: float, places: Float) -> Float:
    """A (n, n), mm per N/mm^2: deflection at places (n, 2) of a grid of that pitch under its squares, mm."""
    table = _table(layer, pitch)
    x, y = (np.minimum(np.abs(at[:, None] - at), _SPAN) for at in np.rint(places.T / pitch).astype(np.int64))
    return np.asarray(table.take(y * (_SPAN + 1) + x))


def _squares(circles: list[tuple[float, float, float]], pitch: float) -> tuple[Float, Labels]:
    """Places (n, 2) on a grid in the circles (x, y, radius), and the circle that each belongs to (n,)."""
    low = [min(one[k] - one[2] for one in circles) for k in (0, 1)]
    high = [max(one[k] + one[2] for one in circles) for k in (0, 1)]
    spans = [(math.floor(a / pitch), math.ceil(b / pitch) + 1) for a, b in zip(low, high, strict=True)]
    x, y = (np.arange(*span) * pitch for span in spans)
    at = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    relative = np.stack([np.hypot(at[:, 0] - a, at[:, 1] - b) / radius for a, b, radius in circles])
    owner = relative.argmin(axis=0)
    inside = relative.min(axis=0) <= 1
    return at[inside], owner[inside]


def _pressed(matrix: Float, height: Float, owner: Labels) -> tuple[Float, Float]:
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
def _table(layer: Layer, pitch: float) -> Float:
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


def _layer_transform(layer: Layer, k: Float) -> Float:
    """Deflection over pressure of waves of wave number k (rad/mm), mm per N/mm^2."""
    h, nu = float(layer.thickness_mm or 0.0), layer.poisson
    q = np.minimum(k * h, 50.0)
    a, b = 3 - 4 * nu, 5 - 12 * nu + 8 * nu**2
    ratio = (a * np.sinh(2 * q) - 2 * q) / (a * np.cosh(2 * q) + 2 * q**2 + b)
    still = h * (1 - 2 * nu) / (1 - nu) ** 2 / layer.plane_modulus
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(q > 1e-6, 2 * ratio / (layer.plane_modulus * k), still)


def _love(x: Float, y: Float, side: float) -> Float:
    """pi E* times the deflection at (x, y) of a half-space under unit pressure on a square at the origin."""
    a, b, c, d = x + side / 2, x - side / 2, y + side / 2, y - side / 2

    def term(u: Float, v: Float, w: Float) -> Float:
        return u * np.log((v + np.hypot(u, v)) / (w + np.hypot(u, w)))

    return term(a, c, d) - term(b, c, d) + term(c, a, b) - term(d, a, b)
