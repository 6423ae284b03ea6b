"""Records from plain values (JSON, arrays of an .npz) by their own annotations: types and shapes are asked
once, as they are read.

An array's shape stands in its annotation, Annotated[NDArray[np.float32], "3 R C"]: numbers, and letters for
extents that are equal wherever they occur in the record.

Arguments of the verbs are checked where the package is entered (`checked`): a record of another type, and a
masked array, are an InputError. Underflows are harmless, whatever np.seterr says.
"""

import inspect
import json
import types
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from functools import lru_cache, wraps
from pathlib import Path
from typing import (
    Annotated,
    Any,
    Literal,
    ParamSpec,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.files import load_arrays, plain

__all__ = ["built", "checked", "from_json", "from_table", "load_record", "require_shapes"]

T = TypeVar("T")
#: Of a kind of values: its name in messages, and the types that it accepts.
_PLAIN: dict[Any, tuple[str, tuple[type, ...]]] = {
    int: ("a whole number", (int,)),
    float: ("a number", (int, float)),
    bool: ("true or false", (bool,)),
    str: ("text", (str,)),
}
#: Types of arrays, the kinds that a stored one may have, and words for them.
_FAMILIES = (
    (np.floating, "fiu", "real numbers"),
    (np.integer, "iu", "whole numbers"),
    (np.bool_, "b", "true and false"),
    (np.str_, "U", "text"),
)
_LARGEST = 1 << 63
_HUGE = 1e18  # of an array, in its unit: squares fit in single precision
Extents = dict[str, int]


def load_record(
    kind: type[T], path: str | Path, texts: Sequence[str] = (), **made: Callable[[NDArray[Any]], Any]
) -> T:
    """A record from the .npz that `save_arrays` made of its fields. texts: fields that are JSON there, one
    text or one of each element; made: fields from their stored arrays. InputError names file and field."""
    hints = _hints(cast(Any, kind))
    needed = [name for name, (_, needs) in hints.items() if needs]
    words = [name for name, (hint, _) in hints.items() if _is_text(hint)]
    numbers = [name for name, (hint, _) in hints.items() if hint in _PLAIN and hint is not str]
    arrays = load_arrays(path, needed, [*texts, *words], numbers)
    try:
        values: dict[str, Any] = {name: arrays[name] for name in hints if name in arrays}
        for name in values.keys() & {*texts}:
            lines = [_parsed(line, name) for line in np.atleast_1d(values[name]).tolist()]
            values[name] = lines if values[name].ndim else lines[0]
        given = {name: make(values.pop(name)) for name, make in made.items() if name in values}
        found: T = _record(kind, values, "", {}, given)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return found


def from_json(kind: Any, text: Any, name: str) -> Any:
    """A value of a type from its JSON. InputError, which begins with the name."""
    return built(kind, _parsed(text, name), name)


def from_table(kind: type[T], table: Mapping[str, Any], where: str) -> T:
    """A record from a table of TOML. InputError, which begins with `where`, of unknown fields and of numbers
    that are not finite, too."""
    known = _hints(cast(Any, kind))
    try:
        for name, value in table.items():
            if name not in known:
                raise InputError(f"unknown field {name!r}, known are {', '.join(known)}")
            if plain(value) != value:
                raise _wrong(name, value, "finite")
        found: T = _record(kind, table, "", {}, {})
    except InputError as error:
        raise InputError(f"{where}: {error}") from error
    return found


def require_shapes(record: Any) -> None:
    """InputError unless the arrays of a record have the shapes of its annotations."""
    extents: Extents = {}
    for name, (hint, _) in _hints(cast(Any, type(record))).items():
        for part in (hint, *get_args(hint)):
            if get_origin(part) is Annotated and (value := getattr(record, name)) is not None:
                _require_shape(part.__metadata__[0], value, f"{type(record).__name__}.{name}", extents)


def _parsed(text: Any, name: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError, TypeError) as error:
        raise InputError(f"{name} is no JSON: {str(text)[:40]!r}") from error


def built(kind: Any, value: Any, name: str, extents: Extents | None = None) -> Any:
    """A value of a type: records (dataclasses, named tuples) from mappings, tuples from lists (whose elements
    have extents of their own), numbers from arrays (). Unknown fields are passed over. InputError names the
    field, its value and its kind."""
    extents, origin, parts = {} if extents is None else extents, get_origin(kind), get_args(kind)
    if isinstance(value, np.generic | np.ndarray) and not value.ndim and origin is not np.ndarray:
        value = value.item()
    if kind is Any or (value is None and type(None) in parts):
        return value
    if origin is Annotated:
        if isinstance(parts[1], str):
            _require_shape(parts[1], value, name, extents)
        return built(parts[0], value, name, extents)
    if origin in (Union, types.UnionType):
        return built(next(part for part in parts if part is not type(None)), value, name, extents)
    if origin is np.ndarray:
        return _array(get_args(parts[1])[0], value, name)
    if origin is tuple:
        return _tuple(parts, value, name, extents)
    if origin in (dict, Mapping):
        if not isinstance(value, Mapping):
            raise _wrong(name, value, "a table")
        return {str(key): built(parts[1], one, f"{name}.{key}", extents) for key, one in value.items()}
    if origin is Literal:
        if value not in parts:
            raise _wrong(name, value, " or ".join(map(str, parts)))
        return value
    return _number(kind, value, name) if kind in _PLAIN else _record(kind, value, name, extents, {})


def _number(kind: Any, value: Any, name: str) -> Any:
    """A number, a truth or a text."""
    words, kinds = _PLAIN[kind]
    if not isinstance(value, kinds) or (isinstance(value, bool) and kind is not bool):
        raise _wrong(name, value, words)
    if isinstance(value, int) and not -_LARGEST <= value < _LARGEST:
        raise _wrong(name, value, f"below {_LARGEST}")
    return kind(value)


def _tuple(parts: tuple[Any, ...], value: Any, name: str, extents: Extents) -> tuple[Any, ...]:
    value = np.atleast_1d(value).tolist() if isinstance(value, np.ndarray) else value
    many = parts[-1] is ...
    if not isinstance(value, list | tuple) or not (many or len(value) == len(parts)):
        raise _wrong(name, value, "a list" if many else f"a list of {len(parts)}")
    pairs = zip(parts[:1] * len(value) if many else parts, value, strict=True)
    return tuple(built(part, one, f"{name}[{i}]", {**extents}) for i, (part, one) in enumerate(pairs))


def _record(kind: Any, value: Any, name: str, extents: Extents, given: Mapping[str, Any]) -> Any:
    """given: fields that are made."""
    if not isinstance(value, Mapping):
        raise _wrong(name, value, f"a table with {', '.join(_hints(kind))}")
    made = dict(given)
    for field, (hint, needed) in _hints(kind).items():
        full = f"{name}.{field}" if name else field
        if field in value:
            made[field] = built(hint, value[field], full, extents)
        elif needed and field not in made:
            raise InputError(f"{full} is missing")
    return kind(**made)


@lru_cache(None)
def _hints(kind: Any) -> dict[str, tuple[Any, bool]]:
    """Type of each field of a record, and whether it has no default."""
    hints = get_type_hints(kind, include_extras=True)
    if is_dataclass(kind):
        needed = [each.name for each in fields(kind) if each.default is each.default_factory is MISSING]
    else:
        needed = [each for each in kind._fields if each not in kind._field_defaults]
    return {each: (hint, each in needed) for each, hint in hints.items()}


def _is_text(hint: Any) -> bool:
    return hint is str or hint is np.str_ or any(map(_is_text, get_args(hint)))


def _array(dtype: Any, value: Any, name: str) -> Any:
    """An array of the annotation's kind; of numbers with a fraction also of its type, single or double."""
    if dtype is Any:
        return value
    kind = get_origin(dtype) or dtype
    for family, known, words in _FAMILIES:
        if issubclass(kind, family):
            if not isinstance(value, np.ndarray) or value.dtype.kind not in known:
                raise _wrong(name, value, f"an array of {words}")
            if value.dtype == np.float16:  # holds neither the limit below nor others of later steps
                value = value.astype(np.float32)
            floats = value.dtype.kind == "f"
            most = float(np.max(np.abs(value), where=np.isfinite(value), initial=0)) if floats else 0.0
            if most > _HUGE:
                raise _wrong(name, most, f"at most {_HUGE:g} in size: single precision holds its square")
            return value.astype(kind, copy=False) if family is np.floating and kind is not family else value
    raise TypeError(f"{name}: {dtype} has no rule")


def _require_shape(shape: str, value: Any, name: str, extents: Extents) -> None:
    """InputError unless an array has the shape; letters that are new get their extent."""
    letters, found = shape.split(), np.shape(value)
    if len(found) == len(letters):
        both = zip(letters, found, strict=True)
        known = [int(one) if one.isdecimal() else extents.setdefault(one, size) for one, size in both]
        if list(found) == known:
            return
    must = " x ".join(f"{one} ({extents[one]})" if one in extents else one for one in letters)
    raise InputError(f"{name} has shape {found}, must be {must}")


def _wrong(name: str, value: Any, must: str) -> InputError:
    array = isinstance(value, np.ndarray)
    return InputError(
        f"{name} is {f'{value.dtype} of shape {value.shape}' if array else repr(value)[:60]}, must be {must}"
    )


P = ParamSpec("P")
R = TypeVar("R")
#: What makes the records that users pass on.
_MAKERS = {
    "Sequence": "patterns.sequence(name, rows, cols)",
    "Scene": "scene.load(preset or path)",
    "Surface": "scene.dent(name, scene)",
    "Correspondence": "decode.decode(frames, sequence)",
}


def checked(**records: Any) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Of a verb: the types of its parameters, [type] of a list's; None is allowed where it is the default.

    The InputError names the parameter, its value, the record that it must be, and what makes one.
    """

    def made(verb: Callable[P, R]) -> Callable[P, R]:
        parameters = inspect.signature(verb).parameters

        @wraps(verb)
        def call(*args: P.args, **kwargs: P.kwargs) -> R:
            for name, value in (*zip(parameters, args, strict=False), *kwargs.items()):
                if np.ma.is_masked(value):  # the mask would be lost
                    raise InputError(f"{name}: a masked array, must be plain: pass {name}.filled(nan)")
                if name in records and (value is not None or parameters[name].default is not None):
                    _require(name, value, records[name])
            with np.errstate(under="ignore"):
                return verb(*args, **kwargs)

        return call

    return made


def _require(name: str, value: object, kinds: Any) -> None:
    """InputError unless the value is of one of these types; [kind]: a list of such."""
    if isinstance(kinds, list) and isinstance(value, list | tuple):
        for i, each in enumerate(value):
            _require(f"{name}[{i}]", each, kinds[0])
        return
    types = tuple(kinds) if isinstance(kinds, tuple | list) else (kinds,)
    if isinstance(kinds, list) or not isinstance(value, types):
        cures = "; ".join(f"{_MAKERS[kind.__name__]} makes one" for kind in types if kind.__name__ in _MAKERS)
        found = repr(value)[:60] if isinstance(value, str | int | float | None) else type(value).__name__
        named = " or ".join(f"{_part(kind)}{kind.__name__}" for kind in types)
        many = "a list of" if isinstance(kinds, list) else "a"
        raise InputError(f"{name}: {found}, must be {many} {named}{cures and ': '}{cures}")


def _part(kind: type) -> str:
    """The part that a record comes from, as `scene.`."""
    return f"{kind.__module__.split('.')[1]}." if kind.__module__.startswith("optolever.") else ""
