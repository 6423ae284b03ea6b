"""Base of every record of a scene: fields declared once, with their limit and their key in a TOML table;
equality over array fields; checks that end in one line.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import MISSING, dataclass, fields
from functools import cache, partial
from typing import Any, TypeVar, get_type_hints

import numpy as np
from numpy.typing import NDArray

from optolever import InputError

__all__ = [
    "Declared", "Float", "Record", "axis", "changed", "declared", "freeze", "integer", "non_negative",
    "number", "pair", "positive", "table_of", "text", "unit", "vector",
]  # fmt: skip

Float = NDArray[np.float64]
R = TypeVar("R", bound="Record")

_UNIT = 1e-12  # an axis this close to unit length is not rescaled, so that a saved scene loads back equal
_TYPED = 0.01  # of a unit length whose numbers have three digits
#: Numbers of a scene (mm, px): up to a thousand kilometres, positive ones from a nanometre on. Squares
#: of larger numbers may overflow float64, and larger ratios leave no digits to a solver.
_MOST, _LEAST = 1e9, 1e-6


@dataclass(frozen=True, slots=True)
class Declared:
    """A field annotated as Annotated[type, check, key, place]: check(name, value) gives its value or raises;
    key: in the record's TOML table (the field's name if none is given), in degrees where it ends in _deg;
    place: in the list at that key, None: no list."""

    name: str
    default: Any
    check: Callable[[str, Any], Any]
    key: str
    place: int | None


def _declared(kind: type) -> tuple[Declared, ...]:
    hints = get_type_hints(kind, include_extras=True)
    found: list[Declared] = []
    for field in fields(kind):
        meta: tuple[Any, ...] = getattr(hints[field.name], "__metadata__", ())
        if meta:
            default = field.default if field.default_factory is MISSING else field.default_factory()
            check, key, place = (*meta, field.name, None)[:3] if len(meta) == 1 else (*meta, None)[:3]
            found.append(Declared(field.name, default, check, key, place))
    return tuple(found)


#: The annotated fields of a record.
declared: Callable[[type], tuple[Declared, ...]] = cache(_declared)


class Record:
    """A frozen dataclass whose declared fields are checked; section: its table in a scene's TOML."""

    section = ""

    def __init_subclass__(cls, section: str = "") -> None:
        cls.section = section or cls.section

    def __post_init__(self) -> None:
        for each in declared(type(self)):
            value = getattr(self, each.name)
            if value is not None or each.default is not None:
                freeze(self, **{each.name: each.check(f"{self.section}.{each.key}", value)})

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())

    def _key(self) -> tuple[Any, ...]:
        values = (getattr(self, field.name) for field in fields(self) if field.compare)  # type: ignore[arg-type]
        return tuple(tuple(v.ravel().tolist()) if isinstance(v, np.ndarray) else v for v in values)


def table_of(record: Record) -> dict[str, Any]:
    """A record's declared fields, and the records in it, as plain TOML types; None is left out."""
    table: dict[str, Any] = {}
    for each in declared(type(record)):
        value = getattr(record, each.name)
        if each.place is not None:
            table.setdefault(each.key, [None, None])[each.place] = value
        elif value is not None:
            value = math.degrees(value) if each.key.endswith("_deg") else value
            table[each.key] = value.tolist() if isinstance(value, np.ndarray) else value
    parts = (getattr(record, field.name) for field in fields(record))  # type: ignore[arg-type]
    return table | {
        p.section.rpartition(".")[2]: table_of(p) for p in parts if isinstance(p, Record) and p.section
    }


def freeze(record: Any, **values: Any) -> None:
    """Set fields of a frozen dataclass (in __post_init__ only)."""
    for name, value in values.items():
        object.__setattr__(record, name, value)


def changed(record: R, **values: Any) -> R:
    """The record with other values of some fields, unchecked: for those that are right by construction."""
    other: R = object.__new__(type(record))
    other.__dict__.update(record.__dict__, **values)
    return other


def number(name: str, value: Any) -> float:
    """A float, neither NaN nor infinite nor beyond all that a scene has; InputError otherwise."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        raise InputError(f"{name} = {value!r}: must be a number")
    checked = float(value)
    if not math.isfinite(checked):
        raise InputError(f"{name} = {checked}: must be finite")
    if abs(checked) > _MOST:
        raise InputError(f"{name} = {checked}: must be at most {_MOST:g}")
    return checked


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


non_negative = partial(positive, zero=True)


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


def pair(name: str, value: Any) -> Float:
    """Two numbers greater than 0; one is both."""
    both = vector(name, value if isinstance(value, Sequence | np.ndarray) else [value, value], 2)
    for component in both.tolist():
        positive(name, component)
    return both


def unit(name: str, value: Any) -> Float:
    """A direction (3,) of length 1; InputError if it is zero."""
    axis = vector(name, value)
    length = float(np.linalg.norm(axis))
    if length < _LEAST:
        raise InputError(f"{name} = {axis.tolist()}: must not be zero")
    return axis if abs(length - 1) <= _UNIT else vector(name, axis / length)


def axis(name: str, value: Any) -> Float:
    """`unit` of a vector whose length is 1 to the digits that were typed; InputError otherwise."""
    direction, length = unit(name, value), float(np.linalg.norm(vector(name, value)))
    if abs(length - 1) > _TYPED:
        wrong = f"{name} = {list(value)}: its length is {length:.4g}, must be 1 within {100 * _TYPED:g} %"
        raise InputError(f"{wrong}; a digit is wrong, or divide its numbers by {length:.4g}")
    return direction


def text(name: str, value: Any) -> str:
    """A text that is not empty; InputError otherwise."""
    if not isinstance(value, str) or not value:
        raise InputError(f"{name} = {value!r}: must be a text that is not empty")
    return value
