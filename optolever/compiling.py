"""How kernels are compiled where the usual way leaves speed behind."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, cast

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.compiler_machinery import register_pass
from numba.core.typed_passes import NativeLowering

from . import elements, ranges  # as an import tells numba  # noqa: F401
from .lowering import PlainLower
from .typing_memory import remembering_types

__all__ = [
    "Apart",
    "Usual",
    "Within",
    "WithinApart",
    "WithinOnce",
    "WithinPasted",
    "WithinWide",
    "only_within",
    "uncollected",
]

#: An attribute of LLVM's, which takes half of what a processor has unless it is told. Where vectors are
#: narrower than that it changes nothing.
_WIDTH = '"prefer-vector-width"="512"'
#: Steps of numba's for what functions without its run time cannot have (closures, array expressions, `with`)
#: and ours do not ask for (`literally`, its own inlined overloads): a twelfth of a cold start.
_IDLE = {
    "inline_closure_likes",
    "make_function_op_code_to_jit_function",
    "nopython_rewrites",
    "with_lifting",
    "find_literally",
    "literal_unroll",
    "LiteralPropagation",
    "inline_overloads",
    "dump_parfor_diagnostics",
}
#: More young objects than that are not searched at once.
_MANY = 100_000


class _Part:
    """What stands for a function that is there for its callers only."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __call__(self, *_: Any, **__: Any) -> Any:
        raise TypeError(f"{self.name} is compiled into its callers and cannot be called from Python")


class _Library(JITCodeLibrary):
    """The code of a part, for callers to take copies of, of which no machine code is made.

    Numba makes machine code of every function, and again of its copy in every caller.
    """

    def _finalize_final_module(self) -> None:
        library: Any = self
        library._finalize_dynamic_globals()
        library._finalized = True


class _Unfinished(_Library):
    """The code as it was written: it is optimised where it is used."""

    def _optimize_final_module(self) -> None:
        pass


class _MarkedLower(PlainLower):
    """Functions with one more attribute of LLVM's."""

    _mark: str

    def setup_function(self, fndesc: Any) -> None:
        usual: Any = super()
        usual.setup_function(fndesc)
        set.add(self.function.attributes, self._mark)  # their own `add` knows attributes of one word only


class _WideLower(_MarkedLower):
    _mark = _WIDTH


class _OnceLower(_MarkedLower):
    _mark = "noinline"


class _PastedLower(_MarkedLower):
    _mark = "alwaysinline"


@register_pass(mutates_CFG=True, analysis_only=False)  # type: ignore[no-untyped-call]
class _Plain(NativeLowering):
    _name = "optolever_plain"
    _lower: type[PlainLower] = PlainLower

    @property
    def lowering_class(self) -> Any:
        return self._lower


@register_pass(mutates_CFG=True, analysis_only=False)  # type: ignore[no-untyped-call]
class _Wide(_Plain):
    _name = "optolever_wide"
    _lower = _WideLower


@register_pass(mutates_CFG=True, analysis_only=False)  # type: ignore[no-untyped-call]
class _Within(_Plain):
    _name = "optolever_within"
    _library: type[_Library] = _Unfinished

    def run_pass(self, state: Any) -> bool:
        """Of the usual pass all but machine code."""
        flags, usual, library = state.flags, cast(Any, super()), cast(Any, self._library)
        state.library = library(state.targetctx.codegen(), state.func_id.func_qualname)
        flags.no_compile = flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
        usual.run_pass(state)
        part = _Part(state.func_id.func_name)
        state.targetctx.insert_user_function(part, state.cr.fndesc, [state.library])
        state.cr = state.cr._replace(cfunc=part)
        return True


@register_pass(mutates_CFG=True, analysis_only=False)  # type: ignore[no-untyped-call]
class _WithinOnce(_Within):
    _name = "optolever_within_once"
    _lower = _OnceLower


@register_pass(mutates_CFG=True, analysis_only=False)  # type: ignore[no-untyped-call]
class _WithinPasted(_Within):
    _name = "optolever_within_pasted"
    _lower = _PastedLower


@register_pass(mutates_CFG=True, analysis_only=False)  # type: ignore[no-untyped-call]
class _WithinWide(_Within):
    _name = "optolever_within_wide"
    _lower = _WideLower
    _library = _Library


def only_within(dispatcher: Any) -> Any:
    """A dispatcher of one of the pipelines Within*, whose functions numba's C code must not be given, as it
    would call them: Python, calling one, finds a _Part, which says what is wrong.
    """

    def add_overload(found: Any) -> None:
        dispatcher.overloads[tuple(found.signature.args)] = found

    dispatcher.add_overload = add_overload
    return dispatcher


@contextmanager
def uncollected() -> Iterator[None]:
    """Without the search for garbage in cycles, on all threads: a compiler makes so many objects, nearly all
    of which live on, that it would take a seventh of the time. Around all kernels that a call may compile; if
    it made many, they count as old after it, and are searched when Python finds a whole search worth while.
    """
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            if gc.get_count()[0] > _MANY and not gc.get_freeze_count():  # which may be a program's own
                gc.freeze()
                gc.unfreeze()
            gc.enable()


class _Compiler(Compiler):
    """Numba's but for steps in vain, and how statements become LLVM's."""

    _lowering: type[NativeLowering] = _Plain
    _noalias = False

    def compile_extra(self, func: Any) -> Any:
        with uncollected(), remembering_types():
            return cast(Any, super()).compile_extra(func)

    def define_pipelines(self) -> Any:
        usual: Any = super()
        (steps,) = usual.define_pipelines()
        steps.passes = [
            (self._lowering if step is NativeLowering else step, why)
            for step, why in steps.passes
            if self.state.flags.nrt or step.name() not in _IDLE
        ]
        steps.finalize()
        self.state.flags.noalias = self._noalias
        return [steps]


class Usual(_Compiler):
    """Numba's."""


class Apart(_Compiler):
    """With vectors as wide as the processor has them, and told that no two array arguments overlap (as numba
    tells itself for parallel loops).
    """

    _lowering = _Wide
    _noalias = True


class Within(_Compiler):
    """For functions that only other compiled functions call: half of the time that a cold start takes is
    spent on code of parts that nothing runs.
    """

    _lowering = _Within


class WithinOnce(_Compiler):
    """Within, called and not pasted, wherever it is used."""

    _lowering = _WithinOnce


class WithinPasted(_Compiler):
    """Within, pasted wherever it is used: loops that call it become vectors."""

    _lowering = _WithinPasted


class WithinWide(_Compiler):
    """Within, with vectors as wide as the processor has them: loops become vectors before they are used."""

    _lowering = _WithinWide


class WithinApart(_Compiler):
    """Within and Apart."""

    _lowering = _WithinWide
    _noalias = True
