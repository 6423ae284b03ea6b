"""Arguments of the verbs, checked where the package is entered: a record of another type, and a masked array,
are an InputError. Underflows are harmless, whatever np.seterr says.
"""

import inspect
from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import numpy as np

from optolever.errors import InputError

__all__ = ["checked"]

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
