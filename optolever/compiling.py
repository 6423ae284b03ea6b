"""How kernels are compiled where the usual way leaves speed behind."""

from typing import Any

from numba.core.compiler import Compiler
from numba.core.compiler_machinery import register_pass
from numba.core.lowering import Lower
from numba.core.typed_passes import NativeLowering

__all__ = ["Apart", "Wide"]

#: An attribute of LLVM's, which takes half of what a processor has unless it is told. Where vectors are
#: narrower than that it changes nothing.
_WIDTH = '"prefer-vector-width"="512"'


class _WideLower(Lower):
    def setup_function(self, fndesc: Any) -> None:
        usual: Any = super()
        usual.setup_function(fndesc)
        set.add(self.function.attributes, _WIDTH)  # their own `add` knows attributes of one word only


@register_pass(mutates_CFG=True, analysis_only=False)  # type: ignore[no-untyped-call]
class _WideLowering(NativeLowering):
    _name = "optolever_wide_lowering"

    @property
    def lowering_class(self) -> Any:
        return _WideLower


class Wide(Compiler):
    """Numba's compiler, with vectors as wide as the processor has them."""

    def define_pipelines(self) -> Any:
        """The usual ones but for the last step."""
        usual: Any = super()
        (steps,) = usual.define_pipelines()
        steps.passes = [
            (_WideLowering if step is NativeLowering else step, why) for step, why in steps.passes
        ]
        steps.finalize()
        return [steps]


class Apart(Wide):
    """Wide, and told that no two array arguments overlap (as numba tells itself for parallel loops)."""

    def define_pipelines(self) -> Any:
        """Those of Wide."""
        self.state.flags.noalias = True
        return super().define_pipelines()
