"""Compiled: coordinates on their way past the caches, for maps that nothing reads again soon, and frames on
their way into them.

What is written the usual way is read first, as a cache holds whole lines only: half the way to memory and
back, and what was there makes room. LLVM knows of such stores, and of what is to be read ahead; numba has no
word for them.
"""

from typing import Any

from llvmlite import ir
from numba.core import types
from numba.core.cgutils import for_range
from numba.extending import intrinsic
from numpy.typing import NDArray

from .jit import leaf_kernel

__all__ = ["ahead", "stream_widened"]

Array = NDArray[Any]

#: Numbers that are stored at once, and their bytes.
_LANES, _LINE = 8, 64
#: To llvm.prefetch: to be read, from the second-level cache on, data.
_TO_READ = 0, 2, 1


def _address_of(typing: Any, array: Any) -> Any:
    """Of an array's first number."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.ptrtoint(_data(context, builder, signature.args[0], args[0]), ir.IntType(64))

    return types.int64(array), generate


def _stream_of(typing: Any, line: Any, coord: Any, start: Any, count: Any) -> Any:
    """`count` times _LANES numbers from `start` on, where coord begins a line of the cache."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        source, target = (_data(context, builder, signature.args[i], args[i]) for i in (0, 1))
        narrow, wide = (ir.VectorType(kind, _LANES) for kind in (ir.FloatType(), ir.DoubleType()))
        once = builder.module.add_metadata([ir.Constant(ir.IntType(32), 1)])
        first, many = args[2:]
        with for_range(builder, many) as loop:
            at = builder.add(first, builder.mul(loop.index, ir.Constant(many.type, _LANES)))
            read = builder.bitcast(builder.gep(source, [at]), narrow.as_pointer())
            write = builder.bitcast(builder.gep(target, [at]), wide.as_pointer())
            stored = builder.store(builder.fpext(builder.load(read, align=4), wide), write, align=_LINE)
            stored.set_metadata("nontemporal", once)
        return context.get_dummy_value()

    return types.void(line, coord, types.intp, types.intp), generate


def _data(context: Any, builder: Any, kind: Any, array: Any) -> Any:
    """Pointer to an array's first number."""
    return context.make_array(kind)(context, builder, array).data


def _ahead_of(typing: Any, line: Any, at: Any) -> Any:
    """Ask for what is `at` numbers on, even beyond the end; nothing waits for it."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        data, word, byte = _data(context, builder, line, args[0]), ir.IntType(32), ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [byte, word, word, word])
        fetch = builder.module.declare_intrinsic("llvm.prefetch", [byte], kind)
        there = builder.bitcast(builder.gep(data, [args[1]]), byte)
        builder.call(fetch, [there, *(ir.Constant(word, i) for i in _TO_READ)])
        return context.get_dummy_value()

    return types.void(line, types.intp), generate


ahead: Any = intrinsic(_ahead_of)
_address: Any = intrinsic(_address_of)
_stream: Any = intrinsic(_stream_of)


@leaf_kernel
def stream_widened(line: Array, coord: Array) -> None:
    """coord (n,) float64 = line (n,) float32."""
    n = len(line)
    head = min((-_address(coord) % _LINE) // 8, n)
    whole = (n - head) // _LANES
    for x in range(head):
        coord[x] = line[x]
    _stream(line, coord, head, whole)
    for x in range(head + whole * _LANES, n):
        coord[x] = line[x]
