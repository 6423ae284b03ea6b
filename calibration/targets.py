"""Calibration targets: mirrors of a known form, in the mirror's frame z = h(x, y).

Each target has unknowns (pose, radius, shape) with priors, and computes height and slopes at x, y for given
values of them. One capture defines the frame: its plane is z = 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from optolever.arrays import Floats
from optolever.errors import InputError
from optolever.scene import Mirror, legendre_form, legendre_orders

__all__ = ["Ball", "Flat", "Plate", "Rest", "Shape", "Target", "target_from_text"]

Shape = Callable[[Floats, Floats], tuple[Floats, Floats, Floats]]
Values = Mapping[str, float]

_FAR = 1e3  # mm: prior of an unknown position
_STEEP = 0.5  # rad: prior of an unknown tilt


class _Form:
    """A plane in an unknown pose, and Legendre shapes of total order 2 to `order`, each 0 +- sigma (mm)."""

    __slots__ = ()
    _posed = True

    def _shapes(self) -> tuple[str, int, float]:
        """Prefix of the shapes' names, order, sigma."""
        return "", 1, 1.0

    def unknowns(self, name: str, frame: bool) -> dict[str, float]:
        """Name -> standard deviation of its prior, mean 0; captures of one surface share its shapes. The
        capture that defines the frame has no pose: its plane is z = 0."""
        prefix, order, sigma = self._shapes()
        pose = {"height": _FAR, "tilt_x": _STEEP, "tilt_y": _STEEP} if self._posed and not frame else {}
        shapes = dict.fromkeys(_names(prefix, order), sigma)
        return {f"{name}.{key}": wide for key, wide in pose.items()} | shapes

    def shape(self, name: str, values: Values, mirror: Mirror) -> Shape:
        """Height and slopes for these values."""
        prefix, order, _ = self._shapes()
        table = np.zeros((order + 1, order + 1))
        height, a, b = (values.get(f"{name}.{key}", 0.0) for key in ("height", "tilt_x", "tilt_y"))
        table[0, 0], table[1, 0], table[0, 1] = height, 0.5 * a * mirror.length, 0.5 * b * mirror.width
        for key, at in _names(prefix, order).items():
            table[at] = values[key]
        return legendre_form(table, mirror)


@dataclass(frozen=True, slots=True)
class Flat(_Form):
    """A reference mirror in an unknown pose; flatness: standard deviation (mm) of each of its three quadratic
    Legendre shapes over the scene's mirror, common to all captures of the same flatness."""

    flatness: float = 1e-3

    def __post_init__(self) -> None:
        _require(self, "flatness")

    def _shapes(self) -> tuple[str, int, float]:
        return f"flatness_{1e3 * self.flatness:g}um", 2, self.flatness


@dataclass(frozen=True, slots=True)
class Rest(_Form):
    """The sensor's undeformed surface: Legendre shapes of total order 2 to `order`, each 0 +- sigma (mm)."""

    order: int = 3
    sigma: float = 0.05
    _posed = False

    def __post_init__(self) -> None:
        if self.order not in range(1, 9):
            raise InputError(f"Rest.order = {self.order}: must be a whole number, 1 (a plane) to 8")
        _require(self, "sigma")

    def _shapes(self) -> tuple[str, int, float]:
        return "rest", self.order, self.sigma


@dataclass(frozen=True, slots=True)
class Plate(_Form):
    """A flat plate pressed against the mirror or lying in its place, in an unknown pose; taken as plane."""


@dataclass(frozen=True, slots=True)
class Ball:
    """The cap of a ball of `radius` +- sigma (mm), convex into the medium; position unknown. Of a pressed
    ball only the contact is used: outside it the mirror is no sphere."""

    radius: float
    sigma: float

    def __post_init__(self) -> None:
        _require(self, "radius", "sigma")

    def unknowns(self, name: str, frame: bool) -> dict[str, float]:
        """Name -> standard deviation of its prior; x and y from the mirror's middle, depth of its top."""
        far = {f"{name}.{key}": _FAR for key in ("x", "y", "depth")}
        return far | {f"{name}.radius": self.sigma}

    def shape(self, name: str, values: Values, mirror: Mirror) -> Shape:
        """Height and slopes for these values; `NAME.radius` is the deviation from the nominal radius."""
        radius = self.radius + values[f"{name}.radius"]
        x0 = 0.5 * mirror.length + values[f"{name}.x"]
        y0 = 0.5 * mirror.width + values[f"{name}.y"]
        depth = values[f"{name}.depth"]

        def cap(x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
            dx, dy = x - x0, y - y0
            root = np.sqrt(np.maximum(radius**2 - dx * dx - dy * dy, (0.1 * radius) ** 2))
            return depth - radius + root, -dx / root, -dy / root

        return cap


#: Any target of a calibration's capture.
Target = Flat | Rest | Plate | Ball
#: By the word for a target: its class, how many numbers it takes, and how they are written.
_WRITTEN: dict[str, tuple[Callable[..., Target], range, str]] = {
    "flat": (Flat, range(2), "flat or flat:FLATNESS"),
    "rest": (Rest, range(3), "rest, rest:ORDER or rest:ORDER,SIGMA"),
    "ball": (Ball, range(2, 3), "ball:RADIUS,SIGMA, such as ball:30,0.003"),
    "plate": (Plate, range(1), "plate"),
}


def target_from_text(text: str) -> Target:
    """KIND[:NUMBERS], such as rest, flat:0.001 or ball:30,0.003 (mm). InputError names what is wrong."""
    kind, _, numbers = text.partition(":")
    if kind not in _WRITTEN:
        raise InputError(f"target {kind!r}: unknown, must be one of {', '.join(_WRITTEN)}")
    made, counts, form = _WRITTEN[kind]
    parts = numbers.split(",") if numbers else []
    try:
        values = [int(value) if value.is_integer() else value for value in map(float, parts)]
    except ValueError:
        raise InputError(f"target {text!r}: {numbers!r} must be a number each, as in {form}") from None
    if len(values) not in counts:
        raise InputError(f"target {kind}: given {len(values)} of its numbers, must be {form} (mm)")
    return made(*values)


def _require(record: object, *names: str) -> None:
    for name in names:
        value = getattr(record, name)
        if not (isinstance(value, int | float) and math.isfinite(value) and value > 0):
            raise InputError(f"{type(record).__name__}.{name} = {value!r}: must be greater than 0 mm")


@lru_cache
def _names(prefix: str, order: int) -> dict[str, tuple[int, int]]:
    """Names of the Legendre shapes of total order 2 to `order`, with their orders along x and y."""
    count = (order + 1) * (order + 2) // 2 - 3
    return {f"{prefix}.L{i}{j}": (i, j) for i, j in legendre_orders(count)}
