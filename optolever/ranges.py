"""`for x in range(...)` without detours, in functions without numba's run time: see elements.

Importing this tells numba.
"""

from collections.abc import Callable
from typing import Any

from numba.core import cgutils, types
from numba.core.imputils import builtin_registry, lower_builtin
from numba.cpython import rangeobj  # whose ways it is asked for  # noqa: F401

__all__: list[str] = []

_STATE, _ITERATOR = types.range_state64_type, types.range_iter64_type
_integer: Any = cgutils.intp_t
_alloca: Any = cgutils.alloca_once_value
_unlikely: Any = cgutils.if_unlikely
_packed: Any = cgutils.pack_struct
_lowers: Callable[..., Callable[[Any], Any]] = lower_builtin


def _instead(name: Any, *kinds: Any) -> Callable[[Any], Any]:
    """Decorator: of numba's own way, which remains that of functions with its run time."""
    usual = next(one for one, known, args in builtin_registry.functions if known == name and args == kinds)

    def told(function: Any) -> Any:
        @_lowers(name, *kinds)
        def chosen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            own = usual if context.enable_nrt else function
            return own(context, builder, sig, args)

        return chosen

    return told


@_instead(range, types.int64)
def _to(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
    return _packed(builder, [_integer(0), args[0], _integer(1)])


@_instead(range, types.int64, types.int64)
def _from_to(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
    return _packed(builder, [*args, _integer(1)])


@_instead(range, types.int64, types.int64, types.int64)
def _by_steps(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
    return _packed(builder, args)


@_instead("getiter", _STATE)
def _begun(context: Any, builder: Any, _sig: Any, args: Any) -> Any:
    """Addresses of the next number and of how many are left; end and step."""
    start, stop, step = (builder.extract_value(args[0], at) for at in range(3))
    zero, way = _integer(0), builder.sub(stop, start)
    with _unlikely(builder, builder.icmp_signed("==", step, zero)):
        context.call_conv.return_user_exc(builder, ValueError, ("range() arg 3 must not be zero",))
    up, upwards = (builder.icmp_signed(">", value, zero) for value in (way, step))
    rest = builder.srem(way, step)
    rest = builder.select(up, rest, builder.neg(rest))
    one_more = builder.zext(builder.icmp_signed(">", rest, zero), way.type)
    count = builder.add(builder.sdiv(way, step), one_more)
    count = builder.select(builder.icmp_unsigned("==", up, upwards), count, zero)
    here, left = (_alloca(builder, value) for value in (start, count))
    return _packed(builder, [here, stop, step, left])


@_instead("iternext", _ITERATOR)
def _next(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
    """A number, and whether it is one."""
    here, step, left = (builder.extract_value(args[0], at) for at in (0, 2, 3))
    value, count = builder.load(here), builder.load(left)
    builder.store(builder.add(value, step), here)
    builder.store(builder.sub(count, _integer(1)), left)
    return _packed(builder, [value, builder.icmp_signed(">", count, _integer(0))])
