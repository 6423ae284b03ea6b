"""Numbers of Python and of NumPy, as they come in, as Python's own."""

import operator
from typing import Any

from optolever.errors import InputError

__all__ = ["real", "whole"]


def whole(name: str, value: Any) -> int:
    """A whole number, 96.0 too. InputError, which names what it is, for anything else.

    >>> import numpy as np
    >>> whole("rows", np.int64(96)), whole("rows", 96.0)
    (96, 96)
    """
    try:
        if isinstance(value, bool):
            raise TypeError
        return operator.index(value)
    except TypeError:
        pass
    number = real(name, value)
    if not number.is_integer():
        raise InputError(f"{name} is {value!r}, must be a whole number")
    return int(number)


def real(name: str, value: Any) -> float:
    """A number. InputError, which names what it is, for anything else."""
    try:
        if isinstance(value, str | bool):
            raise TypeError
        return float(value)
    except (TypeError, ValueError):
        raise InputError(f"{name} is {value!r}, must be a number") from None
