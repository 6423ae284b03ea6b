"""Kernels that call each other by address, so that each of them is compiled by itself: at the same time, in
processes of their own (see elsewhere), and once for all that call it."""

import hashlib
from collections.abc import Callable, Iterable
from threading import RLock
from typing import Any

import llvmlite.binding as llvm
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from .elsewhere import ALONE, compile_all, is_kept

__all__ = ["Linked", "Part", "linking"]

_one_at_a_time = RLock()
Types = tuple[types.Type, ...]
#: A linked kernel and the types of its arguments; those that another one calls, for given types of its own.
Part = tuple["Linked", Types]
Parts = Callable[[Types], Iterable[Part]]


class Linked:
    """A kernel (a dispatcher) that returns nothing; `call((its, arguments))` calls it from within others."""

    def __init__(self, dispatcher: Any) -> None:
        self.dispatcher = dispatcher
        self.call = _call_of(self)
        self._linked: set[Types] = set()

    def symbol(self, arguments: Types) -> str:
        """What a linker knows it as."""
        function = self.dispatcher.py_func
        told = hashlib.sha256(str(arguments).encode()).hexdigest()[:24]
        return f"{function.__module__}.{function.__qualname__}.{told}"

    def link(self, arguments: Types) -> None:
        """Compile it, if it is not, and tell the linker where it is."""
        if arguments not in self._linked:
            self.dispatcher.compile(arguments)
            found = self.dispatcher.overloads[arguments]
            self._told(arguments, found.library.get_pointer_to_function(found.fndesc.llvm_func_name))

    def promise(self, arguments: Types) -> None:
        """Tell the linker of a process that never calls it something."""
        if arguments not in self._linked:
            self._told(arguments, 1)

    def _told(self, arguments: Types, address: int) -> None:
        llvm.add_symbol(self.symbol(arguments), address)
        self._linked.add(arguments)

    def knows(self, arguments: Types) -> bool:
        """Whether a call of such arguments finds it."""
        return arguments in self._linked


#: Of a constant's type, that of any such number.
_plain: Callable[[Any], types.Type] = types.unliteral


def _call_of(part: Linked) -> Any:
    @intrinsic
    def call(typing_context: Any, arguments: Any) -> Any:
        wanted = tuple(_plain(one) for one in arguments.types)
        if not part.knows(wanted):  # the linker would end the process
            raise TypeError(f"{part.dispatcher.py_func.__name__} is not linked for such arguments: {wanted}")

        def code(context: Any, builder: Any, _signature: Any, values: Any) -> Any:
            (packed,) = values
            own = [
                context.cast(builder, builder.extract_value(packed, i), had, want)
                for i, (had, want) in enumerate(zip(arguments.types, wanted, strict=True))
            ]
            convention = context.call_conv
            module, name = builder.module, part.symbol(wanted)
            kind = convention.get_function_type(types.none, wanted)
            function = module.globals.get(name)
            if function is None:
                function = ir.Function(module, kind, name)
            convention.call_function(builder, function, types.none, wanted, own)
            return context.get_dummy_value()

        return types.none(arguments), code

    return call


def linking(dispatcher: Any, parts: Parts) -> Any:
    """A dispatcher that calls linked kernels, which are compiled at the same time."""
    usual = dispatcher.compile

    def compile_linked(signature: Any) -> Any:
        arguments = tuple(signature)
        wanted = list(parts(arguments))
        tasks = [(part.dispatcher, own) for part, own in wanted]
        with _one_at_a_time:  # of threads that all find nothing compiled
            if not all(is_kept(*task) for task in tasks):
                compile_all(list(dict.fromkeys(tasks)), (dispatcher, arguments))
            for part, own in wanted:
                part.link(own)
            return usual(signature)

    def compile_alone(signature: Any) -> Any:
        for part, own in parts(tuple(signature)):
            part.promise(own)
        return usual(signature)

    dispatcher.compile = compile_linked
    setattr(dispatcher, ALONE, compile_alone)
    return dispatcher
