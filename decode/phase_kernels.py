"""Compiled: the phase of cosine and sine sums, without a branch and with one division."""

from typing import Any

import numpy as np
from llvmlite import ir
from numba.extending import intrinsic

from .jit import pasted_kernel

__all__ = ["phase_of"]

_ONE, _EIGHTH, _QUARTER = np.float32(1), np.float32(1 / 8), np.float32(1 / 4)
_TINY = np.float32(1e-20)
#: arctan(x) / (2 pi) = x (A1 + A3 x^2 + ...) on [0, 1] with the least largest error, by Remez' exchange.
_A1, _A3, _A5, _A7 = (np.float32(a) for a in (0.15915483736, -0.05304612135, 0.03174594929, -0.02213628934))
_A9, _A11, _A13 = (np.float32(a) for a in (0.01534607289, -0.00889876878, 0.00347962469))
_A15 = np.float32(-0.00064531073)


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

    The angle from the bisector of its quadrant, pi/4 at most, is the arctangent of (|s| - |c|) / (|s| + |c|):
    nothing is to be exchanged, and both signs are copied in the end. One division serves both answers: it is
    what costs. Error below 6e-9 turns, before rounding. Sums are in pairs (Estrin): one after the other is
    what a processor would wait for.
    """
    power, abs_c, abs_s = c * c + s * s, abs(c), abs(s)
    both = abs_c + abs_s
    inverse = _ONE / (power * both + _TINY)
    x = (abs_c - abs_s) * (power * inverse)
    q = x * x
    square = q * q
    low = (_A1 + _A3 * q) + square * (_A5 + _A7 * q)
    high = (_A9 + _A11 * q) + square * (_A13 + _A15 * q)
    from_s = _EIGHTH + x * (low + square * square * high)
    return _copysign(_QUARTER - _copysign(from_s, c), s), power, both * inverse
