"""What numba's own functions return for arguments of given types, asked once and not in every kernel.

For each sum in each kernel numba tries every kind of sum, of lists, of texts, of arrays, until that of
numbers fits: a sixth of the time that a cold start takes.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from numba.core.types.functions import BaseFunction

__all__ = ["remembering_types"]

#: (function, context, types) -> signature.
_memory: dict[tuple[Any, ...], Any] = {}
_owner: Any = BaseFunction
_usual = _owner.get_call_type


def _remembered(function: Any, context: Any, args: Any, kws: Any) -> Any:
    """BaseFunction.get_call_type."""
    asked = (function, context, tuple(args))
    if kws or asked not in _memory:
        signature = _usual(function, context, args, kws)
        # what is written in Python, and so compiled in as many ways as there are, has a key of its own
        if not kws and function._impl_keys[signature.args] is function.typing_key:
            _memory[asked] = signature
        return signature
    signature = _memory[asked]
    function._impl_keys[signature.args] = function.typing_key
    return signature


@contextmanager
def remembering_types() -> Iterator[None]:
    """Within, which is to be under numba's lock: one thread compiles at a time."""
    before = _owner.get_call_type
    _owner.get_call_type = _remembered
    try:
        yield
    finally:
        _owner.get_call_type = before
