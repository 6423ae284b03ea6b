"""Arguments of public functions, checked where the package is entered: a record of another type than the
annotation's, and a masked array, are an InputError. Underflows are harmless, whatever np.seterr says.
"""

import inspect
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache, wraps
from os import PathLike
from pathlib import Path
from threading import local
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
    "HeightMap": "reconstruct.reconstruct(correspondence, scene)",
    "SlopeMap": "reconstruct.slope_map(height, correspondence, scene)",
    "SofastRig": "formats.load_sofast_rig(path)",
    "Calibration": "calibration.calibrate(scene, observations)",
    "RigResponse": "calibration.measure_response(ramp, captures)",
}
_entered = local()  # inside: whether this thread is in a checked call


def check_face(face: str) -> None:
    """Let every public function, constructor and method of a part check the records that it is given.

    The InputError names the parameter, its value, the record that it must be, and what makes one.
    """
    module = sys.modules[face]
    for name in module.__all__:
        value = getattr(module, name)
        if inspect.isfunction(value):
            checked = _checked(value)
            checked.__module__ = face  # pickle finds it there
            setattr(module, name, checked)
        elif inspect.isclass(value) and value.__module__.startswith(f"{face}."):
            for key, member in list(vars(value).items()):
                if key != "__init__" and key.startswith("_"):
                    continue
                if isinstance(member, classmethod | staticmethod):
                    setattr(value, key, type(member)(_checked(member.__func__)))
                elif inspect.isfunction(member):
                    setattr(value, key, _checked(member))


def _checked(function: Function) -> Function:
    @cache
    def types() -> dict[str, tuple[list[Any], list[Any]] | None]:
        """Types of every parameter that is a record; known once all parts are loaded."""
        hints = get_type_hints(function)
        return {name: _types(hints.get(name)) for name in inspect.signature(function).parameters}

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        if getattr(_entered, "inside", False):
            return function(*args, **kwargs)
        for name, value in (*zip(types(), args, strict=False), *kwargs.items()):
            if np.ma.is_masked(value):  # the mask would be lost
                raise InputError(f"{name}: a masked array, must be plain: pass {name}.filled(nan)")
            if found := types().get(name):
                _require(name, value, *found)
        _entered.inside = True
        try:
            with np.errstate(under="ignore"):
                return function(*args, **kwargs)
        finally:
            _entered.inside = False

    return call


def _members(hint: Any) -> tuple[Any, ...]:
    """The alternatives of an annotation."""
    return get_args(hint) if isinstance(hint, UnionType) or get_origin(hint) is Union else (hint,)


def _is_record(hint: Any) -> bool:
    return inspect.isclass(hint) and hint.__module__.startswith("optolever.")


def _types(hint: Any) -> tuple[list[Any], list[Any]] | None:
    """Types of an annotation's values and, of lists, of their elements; None unless it names records or
    files and besides them only None, texts and callables."""
    kinds: list[Any] = []
    elements: list[Any] = []
    for one in _members(hint):
        origin = get_origin(one)
        if one is type(None) or _is_record(one):
            kinds.append(one)
        elif one in (Path, str) and Path in _members(hint):
            kinds += [PathLike, str]
        elif origin is Callable:
            kinds.append(Callable)
        elif origin in (tuple, list, Sequence, Iterable) and all(map(_is_record, _members(get_args(one)[0]))):
            elements += _members(get_args(one)[0])
            kinds += [Iterator] if origin is Iterable else []  # its elements come later
        else:
            return None
    return (kinds, elements) if elements or PathLike in kinds or any(map(_is_record, kinds)) else None


def _require(name: str, value: Any, kinds: list[Any], elements: list[Any]) -> None:
    """InputError unless the value, or each of a list's elements, is of one of these types."""
    if elements and isinstance(value, list | tuple):
        for i, each in enumerate(value):
            _require(f"{name}[{i}]", each, elements, [])
    elif not isinstance(value, tuple(kinds)):
        records = [one for one in (*kinds, *elements) if _is_record(one)]
        file = ["path"] if PathLike in kinds else []
        named = " or ".join([*(f"{one.__module__.split('.')[1]}.{one.__name__}" for one in records), *file])
        cures = "; ".join(f"{_MAKERS[one.__name__]} makes one" for one in records if one.__name__ in _MAKERS)
        plain = isinstance(value, str | Path | int | float | None)
        found = repr(value)[:60] if plain else type(value).__name__
        raise InputError(
            f"{name}: {found}, must be {'a list of' if elements else 'a'} {named}{cures and ': '}{cures}"
        )
