"""Arguments of public functions checked: a record of another type than the annotation's, and a masked array,
are an InputError. What they compute does not depend on the caller's np.seterr: underflows are harmless.
"""

import inspect
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache, wraps
from pathlib import Path
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np

from optolever.errors import InputError

__all__ = ["check_face"]

Function = Callable[..., Any]
#: Functions that make the records which users pass on, by class.
_MAKERS = {
    "Sequence": "patterns.sequence(name, rows, cols)",
    "Scene": "scene.load(preset or path)",
    "Surface": "scene.dent(name, scene)",
    "Trace": "scene.trace(scene, surface)",
    "Capture": "projector.capture(scene, surface, sequence)",
    "Footprints": "projector.footprints(scene, surface)",
    "Correspondence": "decode.decode(frames, sequence)",
    "PatternMap": "decode.decode(frames, sequence)",
    "HeightMap": "reconstruct.reconstruct(correspondence, scene)",
    "SlopeMap": "reconstruct.slope_map(height, correspondence, scene)",
    "SofastRig": "scene.load_sofast_rig(path)",
    "Calibration": "calibration.calibrate(scene, observations)",
    "RigResponse": "calibration.measure_response(ramp, captures)",
}


def check_face(face: str) -> None:
    """Let every public function, constructor and method of a part check the records that it is given.

    The InputError names the parameter, its value, the record that it must be, and what makes one.
    """
    module = sys.modules[face]
    for name in module.__all__:
        value = getattr(module, name)
        if inspect.isfunction(value):
            checked = _guarded(_checked(value))
            checked.__module__ = face  # pickle finds it there
            setattr(module, name, checked)
        elif inspect.isclass(value) and value.__module__.startswith(f"{face}."):
            for key, member in list(vars(value).items()):
                if key == "__init__" or not key.startswith("_"):
                    _check_member(value, key, member)


def _check_member(owner: type, name: str, member: object) -> None:
    if isinstance(member, classmethod | staticmethod):
        setattr(owner, name, type(member)(_guarded(_checked(member.__func__))))
    elif inspect.isfunction(member):
        setattr(owner, name, _checked(member) if name == "__init__" else _guarded(_checked(member)))


def _guarded(function: Function) -> Function:
    """The function, for plain arrays only, with underflows ignored."""

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        if any(isinstance(each, np.ma.MaskedArray) for each in (*args, *kwargs.values())):
            named = dict(zip(inspect.signature(function).parameters, args, strict=False)) | kwargs
            _require_plain(named)
        with np.errstate(under="ignore"):
            return function(*args, **kwargs)

    return call


def _require_plain(values: Mapping[str, Any]) -> None:
    """InputError for a masked array that masks something: the mask would be lost."""
    for name, value in values.items():
        count = int(np.count_nonzero(value.mask)) if isinstance(value, np.ma.MaskedArray) else 0
        if count:
            raise InputError(
                f"{name}: a masked array that masks {count} of {value.size} values, must be plain: pass "
                f"{name}.filled(nan), or the valid pixels as mask= where there is one"
            )


def _checked(function: Function) -> Function:
    hints = [hint for name, hint in function.__annotations__.items() if name != "return"]
    if not any(isinstance(hint, str) or "optolever." in str(hint) for hint in hints):
        return function

    @cache
    def records() -> list[tuple[int, str, Any]]:
        """Place, name and annotation of every record; known once all parts are loaded."""
        hints = get_type_hints(function)
        named = enumerate(inspect.signature(function).parameters)
        return [(i, name, hints[name]) for i, name in named if _is_checked(hints.get(name))]

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        for place, name, hint in records():
            if place < len(args):
                _require(name, args[place], hint)
            elif name in kwargs:
                _require(name, kwargs[name], hint)
        return function(*args, **kwargs)

    return call


def _members(hint: Any) -> Iterator[Any]:
    """The alternatives of an annotation."""
    if isinstance(hint, UnionType) or get_origin(hint) is Union:
        for part in get_args(hint):
            yield from _members(part)
    else:
        yield hint


def _is_checked(hint: Any) -> bool:
    """Whether an annotation names records or lists of records, and besides them only None and callables."""
    kinds = list(_members(hint))
    others = [one for one in kinds if not _is_record(one) and _element(one) is None]
    return len(others) < len(kinds) and all(
        one is type(None) or get_origin(one) is Callable for one in others
    )


def _is_record(hint: Any) -> bool:
    return inspect.isclass(hint) and hint.__module__.startswith("optolever.")


def _element(hint: Any) -> Any:
    """Annotation of the elements of a list, tuple or iterable of records, else None."""
    if get_origin(hint) not in (tuple, list, Sequence, Iterable):
        return None
    element = get_args(hint)[0]
    return element if all(_is_record(one) for one in _members(element)) else None


def _require(name: str, value: Any, hint: Any) -> None:
    """InputError unless the value is of one of the annotation's alternatives."""
    kinds = list(_members(hint))
    elements = [one for one in map(_element, kinds) if one is not None]
    if elements and isinstance(value, list | tuple):
        for i, each in enumerate(value):
            _require(f"{name}[{i}]", each, elements[0])
        return
    if any(_fits(value, kind) for kind in kinds):
        return
    records = [one for kind in (*kinds, *elements) for one in _members(kind) if _is_record(one)]
    wanted = " or ".join(f"{one.__module__.split('.')[1]}.{one.__name__}" for one in records)
    cures = "; ".join(filter(None, (_cure(value, one) for one in records)))
    raise InputError(
        f"{name}: {_shown(value)}, must be {'a list of' if elements else 'a'} {wanted}{cures and ': '}{cures}"
    )


def _fits(value: Any, kind: Any) -> bool:
    if kind is type(None):
        return value is None
    if get_origin(kind) is Callable:
        return callable(value)
    if get_origin(kind) is Iterable:
        return isinstance(value, Iterator)  # its elements come later
    return _is_record(kind) and isinstance(value, kind)


def _shown(value: Any) -> str:
    """A text or a number; of anything else the type."""
    if isinstance(value, str | Path):
        return repr(str(value)[:60])
    return str(value) if isinstance(value, int | float | None) else type(value).__name__


def _cure(value: Any, record: type) -> str:
    """The functions that make and read a record."""
    if type(value).__name__ == "Displacement" and record.__name__ == "Correspondence":
        return "displacement.added_to(correspondence at rest) makes one"
    made = _MAKERS.get(record.__name__)
    part = record.__module__.split(".")[1]
    read = f"{part}.{record.__name__}.load(path) reads one" if hasattr(record, "load") else ""
    return " or ".join(filter(None, (f"{made} makes one" if made else "", read)))
