"""Base of every record of a scene: equality over array fields, and checks that end in one line."""

import math
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever import InputError

__all__ = ["Float", "Record", "finite", "freeze", "integer", "number", "orthonormal", "positive", "vector"]

Float = NDArray[np.float64]

_UNIT = 1e-12  # an axis this close to unit length is not rescaled, so that a saved scene loads back equal
#: Numbers of a scene (mm, px): up to a thousand kilometres, positive ones from a nanometre on. Squares
#: of larger numbers may overflow float64, and larger ratios leave no digits to a solver.
_MOST, _LEAST = 1e9, 1e-6
_RIGHT_ANGLE = 1e-9  # largest cosine between two axes that are called perpendicular


class Record:
    """Equality and hash over the fields of a frozen dataclass whose fields may be arrays."""

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())

    def _key(self) -> tuple[Any, ...]:
        values = (getattr(self, field.name) for field in fields(self))  # type: ignore[arg-type]
        return tuple(tuple(v.ravel().tolist()) if isinstance(v, np.ndarray) else v for v in values)


def freeze(record: Any, **values: Any) -> None:
    """Set fields of a frozen dataclass (in __post_init__ only)."""
    for name, value in values.items():
        object.__setattr__(record, name, value)


def number(name: str, value: Any) -> float:
    """A finite float; InputError otherwise."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        raise InputError(f"{name} = {value!r}: must be a number")
    return finite(name, float(value))


def finite(name: str, value: float) -> float:
    """`value`, if it is neither NaN nor infinite nor beyond all that a scene has."""
    if not math.isfinite(value):
        raise InputError(f"{name} = {value}: must be finite")
    if abs(value) > _MOST:
        raise InputError(f"{name} = {value}: must be at most {_MOST:g}")
    return value


def positive(name: str, value: Any, zero: bool = False, below: float = math.inf) -> float:
    """A float in (0, below), or [0, below) if `zero`; InputError otherwise."""
    checked = number(name, value)
    if checked < 0 or (checked == 0 and not zero):
        raise InputError(f"{name} = {value!r}: must be {'at least' if zero else 'greater than'} 0")
    if 0 < checked < _LEAST and not zero:
        raise InputError(f"{name} = {value!r}: must be at least {_LEAST:g}")
    if checked >= below:
        raise InputError(f"{name} = {value!r}: must be less than {below:g}")
    return checked


def integer(name: str, value: Any, least: int = 1, most: int = 65536) -> int:
    """An int in [least, most]; InputError otherwise."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise InputError(f"{name} = {value!r}: must be a whole number")
    if not least <= value <= most:
        raise InputError(f"{name} = {value}: must be {least} to {most}")
    return int(value)


def vector(name: str, value: Any, size: int = 3) -> Float:
    """A read-only float64 array of `size` finite numbers; InputError otherwise."""
    if isinstance(value, str) or not isinstance(value, Sequence | np.ndarray) or len(value) != size:
        raise InputError(f"{name} = {value!r}: must be {size} numbers")
    array = np.array([number(name, component) for component in value], dtype=np.float64)
    array.flags.writeable = False
    return array


def orthonormal(name: str, u_axis: Any, v_axis: Any) -> tuple[Float, Float]:
    """Two unit vectors at right angles, normalised where they are not; InputError if zero or askew."""
    u = _unit(f"{name}.u_axis", vector(f"{name}.u_axis", u_axis))
    v = _unit(f"{name}.v_axis", vector(f"{name}.v_axis", v_axis))
    cosine = float(u @ v)
    if abs(cosine) > _RIGHT_ANGLE:
        angle = math.degrees(math.acos(max(-1.0, min(1.0, cosine))))
        raise InputError(
            f"{name}.v_axis = {v.tolist()}: must be perpendicular to u_axis (is at {angle:.9g} deg)"
        )
    return u, v


def _unit(name: str, axis: Float) -> Float:
    length = float(np.linalg.norm(axis))
    if length < _LEAST:
        raise InputError(f"{name} = {axis.tolist()}: must not be zero")
    if abs(length - 1) <= _UNIT:
        return axis
    unit = axis / length
    unit.flags.writeable = False
    return unit
