"""What a capture shows: mirrors of a known form, in the mirror's frame z = h(x, y).

Every target names its own unknowns (pose, radius, shape), each with the prior that it has, and tells height
and slopes at x, y for given values of these. The frame is that of one capture: its plane is z = 0.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.scene import Mirror

__all__ = ["Ball", "Flat", "Plate", "Points", "Rest", "Shape", "Target"]

Floats = NDArray[np.float64]
Shape = Callable[[Floats, Floats], tuple[Floats, Floats, Floats]]
Values = Mapping[str, float]

_FAR = 1e3  # mm: prior of a position of which nothing is known
_STEEP = 0.5  # rad: prior of a tilt of which nothing is known


@dataclass(frozen=True, slots=True)
class Flat:
    """A reference mirror in an unknown pose; flatness: standard deviation (mm) of each of its three quadratic
    Legendre shapes over the scene's mirror, common to all captures of the same flatness."""

    flatness: float = 1e-3

    def __post_init__(self) -> None:
        _require(self, "flatness")

    def unknowns(self, name: str, frame: bool) -> dict[str, float]:
        """Name -> standard deviation of its prior, mean 0."""
        return _pose(name, frame) | dict.fromkeys(_shapes(f"flat {self.flatness:g}", 2), self.flatness)

    def shape(self, name: str, values: Values, mirror: Mirror) -> Shape:
        """Height and slopes for these values."""
        bulge = {key: values[key] for key in _shapes(f"flat {self.flatness:g}", 2)}
        return _sum(_plane(name, values, mirror), _legendre(bulge, 2, mirror))


@dataclass(frozen=True, slots=True)
class Rest:
    """The sensor's own surface: Legendre shapes of total order 2 to `order`, each 0 +- sigma (mm)."""

    order: int = 3
    sigma: float = 0.05

    def __post_init__(self) -> None:
        if not 1 <= self.order <= 8:
            raise InputError(f"Rest.order = {self.order}: must be 1 (a plane) to 8")
        _require(self, "sigma")

    def unknowns(self, name: str, frame: bool) -> dict[str, float]:
        """Name -> standard deviation of its prior, mean 0; several captures of it share one shape."""
        return dict.fromkeys(_shapes("rest", self.order), self.sigma)

    def shape(self, name: str, values: Values, mirror: Mirror) -> Shape:
        """Height and slopes for these values."""
        return _legendre({key: values[key] for key in _shapes("rest", self.order)}, self.order, mirror)


@dataclass(frozen=True, slots=True)
class Plate:
    """A flat plate pressed against the mirror or lying in its place, in an unknown pose; taken as plane."""

    def unknowns(self, name: str, frame: bool) -> dict[str, float]:
        """Name -> standard deviation of its prior, mean 0."""
        return _pose(name, frame)

    def shape(self, name: str, values: Values, mirror: Mirror) -> Shape:
        """Height and slopes for these values."""
        return _plane(name, values, mirror)


@dataclass(frozen=True, slots=True)
class Ball:
    """The cap of a ball of `radius` +- sigma (mm), convex into the medium; place unknown. Of a
    pressed one only the contact is of use: beside it the mirror is no sphere."""

    radius: float
    sigma: float

    def __post_init__(self) -> None:
        _require(self, "radius", "sigma")

    def unknowns(self, name: str, frame: bool) -> dict[str, float]:
        """Name -> standard deviation of its prior; x and y from the mirror's middle, depth of its top."""
        far = {f"{name}.{key}": _FAR for key in ("x", "y", "depth")}
        return far | {f"{name}.radius": self.sigma}

    def shape(self, name: str, values: Values, mirror: Mirror) -> Shape:
        """Height and slopes for these values; `radius` is what it is more than announced."""
        radius = self.radius + values[f"{name}.radius"]
        x0 = 0.5 * mirror.length + values[f"{name}.x"]
        y0 = 0.5 * mirror.width + values[f"{name}.y"]
        depth = values[f"{name}.depth"]

        def cap(x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
            dx, dy = x - x0, y - y0
            root = np.sqrt(np.maximum(radius**2 - dx * dx - dy * dy, (0.1 * radius) ** 2))
            return depth - radius + root, -dx / root, -dy / root

        return cap


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """Known heights z (n,) of the surface at rest at x, y (n,), each +- sigma; mm. Needs a `Rest` capture."""

    x: Floats
    y: Floats
    z: Floats
    sigma: float

    def __post_init__(self) -> None:
        _require(self, "sigma")
        shapes = {np.shape(part) for part in (self.x, self.y, self.z)}
        if len(shapes) != 1 or len(next(iter(shapes))) != 1:
            raise InputError(f"Points: x, y, z have shapes {shapes}, must be (n,) each")


#: What a capture for a calibration shows.
Target = Flat | Rest | Plate | Ball


def _require(record: object, *names: str) -> None:
    for name in names:
        value = getattr(record, name)
        if not (isinstance(value, int | float) and math.isfinite(value) and value > 0):
            raise InputError(f"{type(record).__name__}.{name} = {value!r}: must be greater than 0 mm")


def _pose(name: str, frame: bool) -> dict[str, float]:
    """Two tilts and a height, or nothing: the frame's own plane is z = 0."""
    tilts = {f"{name}.tilt_x": _STEEP, f"{name}.tilt_y": _STEEP}
    return {} if frame else {f"{name}.height": _FAR} | tilts


def _plane(name: str, values: Values, mirror: Mirror) -> Shape:
    height, a, b = (values.get(f"{name}.{key}", 0.0) for key in ("height", "tilt_x", "tilt_y"))

    def plane(x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
        z = height + a * (x - 0.5 * mirror.length) + b * (y - 0.5 * mirror.width)
        return z, np.full_like(z, a), np.full_like(z, b)

    return plane


def _shapes(name: str, order: int) -> dict[str, tuple[int, int]]:
    """Names of the Legendre shapes of total order 2 to `order`, with their orders along x and y."""
    return {
        f"{name}.L{total - j}{j}": (total - j, j) for total in range(2, order + 1) for j in range(total + 1)
    }


def _legendre(values: Values, order: int, mirror: Mirror) -> Shape:
    """sum c_ij P_i(2 x / L - 1) P_j(2 y / W - 1)."""
    table = np.zeros((order + 1, order + 1))
    for key, value in values.items():
        table[int(key[-2]), int(key[-1])] = value
    powers = np.arange(order + 1)
    table = _monomials(order).T @ table @ _monomials(order)  # of s^i t^j: these cost a third
    by_x, by_y = np.zeros_like(table), np.zeros_like(table)
    by_x[:-1] = (powers[:, None] * table)[1:] * 2 / mirror.length
    by_y[:, :-1] = (powers * table)[:, 1:] * 2 / mirror.width
    tables = np.hstack([table, by_x, by_y])

    def shape(x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
        along_x = np.vander(2 * x.ravel() / mirror.length - 1, order + 1, increasing=True) @ tables
        along_y = np.vander(2 * y.ravel() / mirror.width - 1, order + 1, increasing=True)
        z, zx, zy = np.einsum("nkj,nj->kn", along_x.reshape(-1, 3, order + 1), along_y).reshape(3, *x.shape)
        return z, zx, zy

    return shape


@lru_cache
def _monomials(order: int) -> Floats:
    """Rows: Legendre's polynomials up to `order` as sums of powers."""
    rows = [
        np.pad(legendre.leg2poly(unit[: k + 1]), (0, order - k)) for k, unit in enumerate(np.eye(order + 1))
    ]
    return np.stack(rows)


def _sum(first: Shape, second: Shape) -> Shape:
    def both(x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
        a, b = first(x, y), second(x, y)
        return a[0] + b[0], a[1] + b[1], a[2] + b[2]

    return both
