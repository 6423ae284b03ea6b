"""Compiled: numbers that several threads draw from one counter, each of which only one of them gets.

What a thread has written before it draws, those who draw after it see. LLVM knows of such a step, numba has
no word for it.
"""

from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

__all__ = ["draw"]


def _draw_of(typing: Any, counters: Any, which: Any) -> Any:
    """counters (K,) int64: the number that counter `which` is at; it goes on by one."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        first = context.make_array(signature.args[0])(context, builder, args[0]).data
        at = builder.gep(first, [args[1]])
        return builder.atomic_rmw("add", at, ir.Constant(ir.IntType(64), 1), "seq_cst")

    return types.int64(counters, types.intp), generate


draw: Any = intrinsic(_draw_of)
