"""Compiled: the phase of cosine and sine sums, without a branch and without a division."""

from typing import Any

import numpy as np
from llvmlite import ir
from numba.extending import intrinsic

from .jit import pasted_kernel

__all__ = ["phase_of"]

_ONE = np.float32(1)
_EIGHTH, _QUARTER = np.float32(1 / 8), np.float32(1 / 4)
#: What (c, s) = 0 has, squared: 1e-14 of a level.
_LEAST = np.float32(1e-14)
#: arcsin(x / sqrt(2)) / (2 pi) = x (A1 + A3 x^2 + ...) on [0, 1] with the least largest error, by Remez'
#: exchange.
_A1, _A3, _A5 = (np.float32(a) for a in (0.11253964103, 0.0093747533951, 0.0021456406353))
_A7, _A9 = (np.float32(a) for a in (0.00047311335718, 0.0005508156075))
_A11, _A13 = (np.float32(a) for a in (-0.00029180524835, 0.0002078342214))


def _copysign_of(typing: Any, size: Any, sign: Any) -> Any:
    """llvm.copysign, one instruction where numba's own calls C's."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind = ir.FloatType()
        both = ir.FunctionType(kind, [kind, kind])
        return builder.call(builder.module.declare_intrinsic("llvm.copysign", [kind], both), args)

    return size(size, sign), generate


_copysign: Any = intrinsic(_copysign_of)


@pasted_kernel
def phase_of(c: Any, s: Any) -> Any:
    """Of c and s, float32: phase in turns, c^2 + s^2, and 1 / (c^2 + s^2).

    The angle from the bisector of its quadrant, pi/4 at most, is the arcsine of (|s| - |c|) / sqrt(2 (c^2 +
    s^2)); error below 7e-9 turns, before rounding. Sums are in pairs (Estrin): one after the other is what a
    processor would wait for.
    """
    power = c * c + s * s + _LEAST
    root = _ONE / np.sqrt(power)
    x = (abs(c) - abs(s)) * root
    q = x * x
    square = q * q
    low = (_A1 + _A3 * q) + square * (_A5 + _A7 * q)
    high = (_A9 + _A11 * q) + square * _A13
    from_s = _EIGHTH + x * (low + square * square * high)
    return _copysign(_QUARTER - _copysign(from_s, c), s), power, root
