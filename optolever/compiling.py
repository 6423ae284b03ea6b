"""How kernels are compiled where the usual way leaves speed behind."""

from typing import Any

from llvmlite import ir
from numba.core import cgutils as untyped
from numba.core import types
from numba.core.compiler import Compiler
from numba.extending import intrinsic

__all__ = ["LINE", "Apart", "fetch"]

cgutils: Any = untyped

#: Bytes that come from memory at once.
LINE = 64


class Apart(Compiler):
    """Numba's compiler, told that no two array arguments overlap (as it tells itself for parallel loops)."""

    def define_pipelines(self) -> Any:
        """The usual ones."""
        self.state.flags.noalias = True
        usual: Any = super()
        return usual.define_pipelines()


@intrinsic
def fetch(typing_context: Any, array: Any, row: Any, col: Any) -> Any:
    """fetch(array, row, col): ask for array[row, 0, col] before it is needed; it may lie beyond the array.

    What reads many lines of memory side by side, each a little, is no pattern that the processor foresees.
    """
    signature = types.void(array, types.intp, types.intp)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind = signature.args[0]
        view = context.make_array(kind)(context, builder, arguments[0])
        at = [arguments[1], ir.Constant(arguments[1].type, 0), arguments[2]]
        place = cgutils.get_item_pointer(
            context, builder, kind, view, at, wraparound=False, boundscheck=False
        )
        byte, number = ir.IntType(8).as_pointer(), ir.IntType(32)
        shape = ir.FunctionType(ir.VoidType(), [byte, number, number, number])
        ask = cgutils.get_or_insert_function(builder.module, shape, "llvm.prefetch.p0")
        to_read, second_level, data = (ir.Constant(number, k) for k in (0, 2, 1))
        builder.call(ask, [builder.bitcast(place, byte), to_read, second_level, data])
        return context.get_dummy_value()

    return signature, generate
