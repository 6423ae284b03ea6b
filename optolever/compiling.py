"""How kernels are compiled where the usual way leaves speed behind."""

from typing import Any

from numba.core.compiler import Compiler

__all__ = ["Apart"]


class Apart(Compiler):
    """Numba's compiler, told that no two array arguments overlap (as it tells itself for parallel loops)."""

    def define_pipelines(self) -> Any:
        """The usual ones."""
        self.state.flags.noalias = True
        usual: Any = super()
        return usual.define_pipelines()
