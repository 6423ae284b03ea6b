"""Numbers of Python, of NumPy and of texts, as they come in, as Python's own."""

import re
from collections.abc import Container
from typing import Any

from optolever.errors import InputError

__all__ = ["listed", "parsed", "real", "whole", "written"]


def whole(name: str, value: Any) -> int:
    """A whole number, 96.0 too. InputError, which names what it is, for anything else.

    >>> import numpy as np
    >>> whole("rows", np.int64(96)), whole("rows", 96.0)
    (96, 96)
    """
    if not real(name, value).is_integer():
        raise InputError(f"{name} is {value!r}, must be a whole number")
    return int(value)


def real(name: str, value: Any) -> float:
    """A number. InputError, which names what it is, for anything else."""
    try:
        if isinstance(value, str | bool):
            raise TypeError
        return float(value)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{name} is {value!r}, must be a number") from None


def parsed(name: str, text: str) -> float:
    """A number from its text. InputError with the name for anything else."""
    try:
        return float(text)
    except ValueError:
        raise InputError(f"{name} is {text!r}, must be a number") from None


def listed(name: str, text: str, form: str, count: int = 0) -> list[float]:
    """Numbers with commas between them, so many (0: any). InputError, which says the form.

    >>> listed("--probe", "30,22.5", "X,Y", 2)
    [30.0, 22.5]
    """
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if not numbers or (count and len(numbers) != count):
        raise InputError(f"{name} {text!r}: must be {form}")
    return numbers


def written(what: str, text: str, form: str, known: Container[str] | None = None) -> dict[str, str]:
    """Values by name of 'name=value,name=value'. InputError, which begins with `what` and says the form, for
    another form, for a name that is not among the known ones, and for one that is given twice. A comma
    belongs to a value, as of a path, unless NAME= or a number follows it.

    >>> written("dent", "peak=0.3, sigma=8", "name=value")
    {'peak': '0.3', 'sigma': '8'}
    """
    found: dict[str, str] = {}
    for item in filter(None, re.split(r",(?=\s*\w+\s*=|[-+.\d\s]*(?:,|$))", text)):
        name, _, value = (part.strip() for part in item.partition("="))
        if not (name and value) or (known is not None and name not in known):
            raise InputError(f"{what}: {item!r}, must be {form}")
        if name in found:
            raise InputError(f"{what}: {name} is given twice, must be given once")
        found[name] = value
    return found
