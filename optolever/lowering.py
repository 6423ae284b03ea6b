"""How numba's statements become LLVM's in functions without its run time: without what only that needs.

Numba reads what a variable held before it is written, as something may have to be given back, and clears it
after its last use; it asks the size of each for a debugger. That was a fourteenth of all text that went to
LLVM (see handing, elements).
"""

from typing import Any, cast

from numba.core import cgutils
from numba.core.lowering import Lower

__all__ = ["PlainLower"]

_alloca: Any = cgutils.alloca_once
_OF_PAIR = {"pair_first": 0, "pair_second": 1}


class PlainLower(Lower):
    """Numba's, which it stays for functions with its run time or for a debugger."""

    @property
    def _plain(self) -> bool:
        context: Any = self.context
        return not (context.enable_nrt or context.enable_debuginfo)

    def storevar(self, value: Any, name: str, argidx: Any = None) -> None:
        usual: Any = super()
        if not self._plain:
            usual.storevar(value, name, argidx)
            return
        own = cast(Any, self)
        own._alloca_var(name, own.typeof(name))
        if name in own._singly_assigned_vars:
            own._blk_local_varmap[name] = value
        else:
            own.builder.store(value, own.getvar(name))

    def delvar(self, name: str) -> None:
        usual: Any = super()
        if not self._plain:
            usual.delvar(name)
            return
        own = cast(Any, self)
        if name not in own._blk_local_varmap:  # not set yet, as blocks are gone through: another one may
            own._singly_assigned_vars.discard(name)

    def alloca_lltype(self, name: str, lltype: Any, datamodel: Any = None) -> Any:
        usual: Any = super()
        if not self._plain:
            return usual.alloca_lltype(name, lltype, datamodel)
        return _alloca(self.builder, lltype, name=name)

    def lower_expr(self, resty: Any, expr: Any) -> Any:
        usual: Any = super()
        if self._plain and expr.op in _OF_PAIR:
            pair = cast(Any, self).loadvar(expr.value.name)
            return cast(Any, self).builder.extract_value(pair, _OF_PAIR[expr.op])
        return usual.lower_expr(resty, expr)
