"""Functions of a user, by 'module:function'; modules of the working folder can be imported."""

import importlib
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from optolever.errors import InputError

__all__ = ["imported", "working_folder"]


@contextmanager
def working_folder() -> Iterator[None]:
    """Modules of the working folder can be imported; it comes last, so that it hides no other module."""
    before = list(sys.path)
    sys.path.append(str(Path.cwd()))
    try:
        yield
    finally:
        sys.path[:] = before


def imported(what: str, text: str) -> Callable[..., Any]:
    """The function; InputError, which begins with `what`, if it cannot be imported."""
    module, _, name = text.partition(":")
    with working_folder():
        try:
            found = getattr(importlib.import_module(module), name)
        except (ImportError, AttributeError, ValueError) as error:
            raise InputError(f"{what}: cannot be imported ({error})") from error
    if not callable(found):
        raise InputError(f"{what}: is {type(found).__name__}, must be a function")
    return found  # type: ignore[no-any-return]
