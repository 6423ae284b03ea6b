"""Compiled: sine and cosine of a place, and an exponential, in vectors."""

import math
from typing import Any

import numpy as np

from .jit import pasted_kernel

__all__ = ["cosine_sine", "falling"]

#: Taylor's coefficients of sin and cos, good to 1e-7 up to a quarter of a turn.
_SINE = tuple(np.float32((-1) ** k / math.factorial(2 * k + 1)) for k in range(6))
_COSINE = tuple(np.float32((-1) ** k / math.factorial(2 * k)) for k in range(7))
#: Exponent from which on nothing is left; exp(-x) = exp(-x / 64)^64, the latter to this order.
_FAR, _PART = np.float32(40), np.float32(1 / 64)
_C2, _C3, _C4, _C5, _C6 = (np.float32((-1) ** k / math.factorial(k)) for k in range(2, 7))
_PI, _ONE, _TWO = np.float32(np.pi), np.float32(1), np.float32(2)


@pasted_kernel
def cosine_sine(turns: Any) -> Any:
    """Cosine and sine of turns (float32), from those of half of them."""
    half = _PI * (turns - np.rint(turns))
    q = half * half
    high = ((_SINE[5] * q + _SINE[4]) * q + _SINE[3]) * q + _SINE[2]
    sine = ((high * q + _SINE[1]) * q + _SINE[0]) * half
    high = ((_COSINE[6] * q + _COSINE[5]) * q + _COSINE[4]) * q + _COSINE[3]
    cosine = ((high * q + _COSINE[2]) * q + _COSINE[1]) * q + _COSINE[0]
    return _ONE - _TWO * sine * sine, _TWO * sine * cosine


@pasted_kernel
def falling(x: Any) -> Any:
    """exp(-x) of x >= 0, float32, to 2e-5 of itself up to 20 and 1e-3 up to 40; beyond, that of 40."""
    t = (x if x < _FAR else _FAR) * _PART
    root = _ONE - t + t * t * (_C2 + t * (_C3 + t * (_C4 + t * (_C5 + t * _C6))))
    root *= root
    root *= root
    root *= root
    root *= root
    root *= root
    return root * root
