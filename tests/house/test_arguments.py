"""Public functions that are given a record of another type name it in one line, and what makes one."""

import importlib
import inspect
import typing
from collections.abc import Callable, Iterator
from pathlib import Path
from types import UnionType
from typing import Any

import numpy as np
import pytest

from optolever import InputError
from optolever.patterns import Frame, sequence
from optolever.scene import load

PARTS = (
    "patterns", "scene", "projector", "decode", "reconstruct", "calibration", "live", "metrology",
    "formats",
)  # fmt: skip
#: Values of no record: what users pass by mistake.
WRONG = ["gray+phase", 7, np.zeros((3, 4)), object(), ["gray"]]
#: Records mistaken for others.
RECORDS = [Frame("white"), sequence("gray", 4, 4), load("prism48")]


def _callables(part: str) -> Iterator[tuple[str, Callable[..., Any]]]:
    """Public functions, constructors and methods of a part."""
    face = importlib.import_module(f"optolever.{part}")
    for name in face.__all__:
        value = getattr(face, name)
        if inspect.isfunction(value):
            yield name, value
        elif inspect.isclass(value) and not getattr(value, "_is_protocol", False):
            yield name, value.__init__
            for key, member in vars(value).items():
                function = member.__func__ if isinstance(member, classmethod | staticmethod) else member
                if not key.startswith("_") and inspect.isfunction(function):
                    yield f"{name}.{key}", function


def _alternatives(hint: Any) -> list[Any]:
    union = isinstance(hint, UnionType) or typing.get_origin(hint) is typing.Union
    return list(typing.get_args(hint)) if union else [hint]


def _records(hint: Any) -> list[type]:
    """Classes of the package that an annotation names, as themselves or as elements of a list."""
    if inspect.isclass(hint) and typing.get_origin(hint) is None:
        return [hint] if hint.__module__.startswith("optolever.") else []
    return [one for part in typing.get_args(hint) for one in _records(part)]


def _cases(named: Callable[[Any], Any] = _records) -> list[Any]:
    """Function, parameter, its annotation; anchors, which are texts and tuples, too, have their tests."""
    return [
        pytest.param(function, parameter, hint, id=f"{part}.{name}({parameter})")
        for part in PARTS
        for name, function in _callables(part)
        for parameter, hint in typing.get_type_hints(function).items()
        if parameter not in ("return", "anchor") and named(hint)
    ]


def _is_path(hint: Any) -> bool:
    return Path in _alternatives(hint) and "[" not in str(hint)


def _stand_in(hint: Any) -> object:
    """An empty object of the annotated type, as the check asks for no more."""
    kinds = _alternatives(hint)
    if type(None) in kinds:
        return None
    if Path in kinds:
        return "x"
    if not inspect.isclass(kinds[0]):
        return []
    return tuple.__new__(kinds[0]) if issubclass(kinds[0], tuple) else object.__new__(kinds[0])


@pytest.mark.parametrize(("function", "parameter", "hint"), [*_cases(), *_cases(_is_path)])
def test_a_wrong_record_is_one_line(function: Callable[..., Any], parameter: str, hint: Any) -> None:
    """Arguments that are no records are None: the check comes before any of them is used."""
    hints = typing.get_type_hints(function)
    others = {
        name: _stand_in(hints[name]) if wanted and name != "anchor" else None
        for name in inspect.signature(function).parameters
        for wanted in [_is_path(hints.get(name)) or _records(hints.get(name))]
    }
    for value in (*WRONG, *RECORDS, *([] if type(None) in _alternatives(hint) else [None])):
        if isinstance(value, (*_records(hint), *([str] if _is_path(hint) else []))) and "[" not in str(hint):
            continue
        with pytest.raises(InputError) as caught:
            function(**{**others, parameter: value})
        line = str(caught.value)
        assert line.startswith((f"{parameter}: ", f"{parameter}[0]: ")), line
        assert "must be a" in line
        assert "\n" not in line
