"""Numbers of Python and of NumPy, as they come in, as Python's own."""

from typing import Any

from optolever.errors import InputError

__all__ = ["real", "whole"]


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
