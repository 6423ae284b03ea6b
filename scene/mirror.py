"""The mirror at rest: the rectangle z = 0, 0 <= x <= length, 0 <= y <= width, its form as a calibration
measures it, the medium in front, whose boundary it is, and the elastic layer that a force dents.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Annotated, Any

import numpy as np
from numpy.polynomial import legendre

from optolever import InputError

from .fields import Float, Record, freeze, non_negative, positive

__all__ = ["Layer", "Medium", "Mirror", "RestForm", "legendre_form", "legendre_orders"]

#: From gels to hard rubber, from films to blocks; the unit, and the one that is typed by mistake.
_PLAUSIBLE = {
    "youngs_modulus_mpa": ((1e-3, 100.0), "MPa (N/mm^2); divide Pa by 1000000, kPa by 1000"),
    "thickness_mm": ((0.05, 1000.0), "mm; multiply metres by 1000"),
}
_TYPED_MODULUS = 0.1  # of a silicone's modulus from a data sheet or by hardness
_index = partial(positive, below=10)


@dataclass(frozen=True, eq=False)
class Mirror(Record, section="mirror"):
    """Extent of the mirror in mm: `length` along x (L0), `width` along y."""

    length: Annotated[float, positive, "size_mm", 0]
    width: Annotated[float, positive, "size_mm", 1]


def legendre_orders(count: int) -> list[tuple[int, int]]:
    """Orders (i, j) along x and y of the first `count` Legendre shapes of total order 2, 3, ...

    >>> legendre_orders(4)
    [(2, 0), (1, 1), (0, 2), (3, 0)]
    """
    orders: list[tuple[int, int]] = []
    total = 2
    while len(orders) < count:
        orders += [(total - j, j) for j in range(total + 1)]
        total += 1
    return orders[:count]


@dataclass(frozen=True, eq=False)
class RestForm(Record):
    """z = sum c_ij P_i(2 x / length - 1) P_j(2 y / width - 1) over total orders i + j from 2 on; coefficients
    (n,) in mm, in the order of `legendre_orders`. The frame z = 0 is the plane that these shapes leave out.
    """

    coefficients: Float

    def __post_init__(self) -> None:
        values = np.array(self.coefficients, dtype=np.float64)
        if values.ndim != 1 or not np.isfinite(values).all():
            raise InputError(f"rest form: coefficients of shape {values.shape}, must be (n,) and finite")
        values.flags.writeable = False
        freeze(self, coefficients=values)

    @property
    def values(self) -> dict[str, float]:
        """The coefficients by name: L20, L11, L02, L30, ..."""
        orders = legendre_orders(self.coefficients.size)
        return {f"L{i}{j}": float(c) for (i, j), c in zip(orders, self.coefficients, strict=True)}

    def height(self, x: Float, y: Float, mirror: Mirror) -> Float:
        """z in mm at x, y."""
        return legendre_form(self._table, mirror)(x, y)[0]

    def slopes(self, x: Float, y: Float, mirror: Mirror) -> tuple[Float, Float]:
        """dz/dx and dz/dy at x, y."""
        return legendre_form(self._table, mirror)(x, y)[1:]

    @property
    def _table(self) -> Float:
        orders = legendre_orders(self.coefficients.size)
        size = 1 + max((max(each) for each in orders), default=0)
        table = np.zeros((size, size))
        for order, c in zip(orders, self.coefficients, strict=True):
            table[order] = c
        return table


def legendre_form(table: Float, mirror: Mirror) -> Callable[[Float, Float], tuple[Float, Float, Float]]:
    """The surface sum table[i, j] P_i(2 x / length - 1) P_j(2 y / width - 1) over i + j < len(table), mm: z,
    dz/dx and dz/dy at x, y."""
    order = len(table) - 1
    table = _monomials(order).T @ table @ _monomials(order)  # of s^i t^j, i + j <= order: by Horner's scheme
    rows = [line[order - i :: -1] for i, line in enumerate(table.tolist())][::-1]

    def form(x: Float, y: Float) -> tuple[Float, Float, Float]:
        s, t = 2 / mirror.length * x - 1, 2 / mirror.width * y - 1
        z, by_s, by_t = np.zeros((3, *x.shape))
        for highest, *others in rows:
            value: Any = highest
            slope: Any = 0.0
            for c in others:
                slope = slope * t + value
                value = value * t + c
            by_s = by_s * s + z
            z = z * s + value
            by_t = by_t * s + slope
        return z, 2 / mirror.length * by_s, 2 / mirror.width * by_t

    return form


@lru_cache
def _monomials(order: int) -> Float:
    """Rows: coefficients of the Legendre polynomials up to `order` in powers."""
    rows = [
        np.pad(legendre.leg2poly(unit[: k + 1]), (0, order - k)) for k, unit in enumerate(np.eye(order + 1))
    ]
    return np.stack(rows)


@dataclass(frozen=True, eq=False)
class Medium(Record, section="medium"):
    """Index of refraction inside, and `outside` behind the boundary; the boundary is the mirror."""

    index: Annotated[float, _index]
    outside: Annotated[float, _index] = 1.0

    @property
    def critical_angle(self) -> float:
        """Angle of incidence (rad) beyond which everything is reflected; pi/2 if there is none."""
        return math.asin(min(1.0, self.outside / self.index))

    def reflectance(self, cos_incidence: Float) -> Float:
        """Share of unpolarised light reflected at a cosine of incidence (any shape); 1: total reflection.

        Fresnel: R_s = ((n c - n' c')/(n c + n' c'))^2, R_p = ((n' c - n c')/(n' c + n c'))^2, c' by Snell's
        law (Born & Wolf, Principles of Optics, 1.5.2).
        """
        ratio = self.index / self.outside
        c = np.asarray(cos_incidence, np.float64)
        transmitted = 1 - ratio**2 * (1 - c * c)
        c_out = np.sqrt(np.maximum(transmitted, 0.0))
        with np.errstate(invalid="ignore", divide="ignore"):
            s = (ratio * c - c_out) / (ratio * c + c_out)
            p = (c - ratio * c_out) / (c + ratio * c_out)
        reflected: Float = np.where(
            transmitted > 0, 0.5 * (s * s + p * p), np.where(np.isnan(c), np.nan, 1.0)
        )
        return reflected


@dataclass(frozen=True, eq=False)
class Layer(Record, section="layer"):
    """Bonded to a rigid base; thickness_mm None: a half-space; youngs_modulus_mpa: N/mm^2, with its standard
    deviation (None: a tenth, as of a typed number); poisson: up to 0.5."""

    youngs_modulus_mpa: Annotated[float, positive]
    poisson: Annotated[float, non_negative] = 0.5
    thickness_mm: Annotated[float | None, positive] = None
    youngs_modulus_sigma_mpa: Annotated[float | None, non_negative] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for key, ((least, most), unit) in _PLAUSIBLE.items():
            value = getattr(self, key)
            if value is not None and not least <= value <= most:
                wrong = f"layer.{key} = {value:g}: must be {least:g} to {most:g}"
                raise InputError(f"{wrong}; its unit is {unit}")
        if (self.youngs_modulus_sigma_mpa or 0.0) > self.youngs_modulus_mpa:
            wrong = f"layer.youngs_modulus_sigma_mpa = {self.youngs_modulus_sigma_mpa:g}"
            limit = f"must be at most the modulus, {self.youngs_modulus_mpa:g}"
            raise InputError(f"{wrong}: {limit}; its unit is MPa, as that of the modulus, not per cent")
        if self.poisson > 0.5:
            raise InputError(f"layer.poisson = {self.poisson:g}: must be 0 to 0.5")

    @property
    def relative_sigma(self) -> float:
        """Standard deviation of the modulus over the modulus."""
        sigma = self.youngs_modulus_sigma_mpa
        return _TYPED_MODULUS if sigma is None else sigma / self.youngs_modulus_mpa

    @property
    def plane_modulus(self) -> float:
        """E / (1 - nu^2), N/mm^2."""
        return self.youngs_modulus_mpa / (1 - self.poisson**2)
