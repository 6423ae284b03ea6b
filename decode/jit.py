"""How this part compiles: cached on disk, without the interpreter's lock."""

from collections.abc import Callable
from typing import Any, cast

from numba import njit

__all__ = ["fast_kernel", "inline_kernel", "kernel"]

Kernel = Callable[..., Any]
#: Reorderings that let loops become vector instructions; NaN and infinity keep their meaning.
_REORDER = {"contract", "reassoc", "nsz", "arcp"}


def kernel(function: Kernel) -> Kernel:
    """Compiled exactly as written."""
    return cast(Kernel, njit(cache=True, nogil=True)(function))


def fast_kernel(function: Kernel) -> Kernel:
    """Compiled with reordering of sums and fused multiply-add."""
    return cast(Kernel, njit(cache=True, nogil=True, fastmath=_REORDER)(function))


def inline_kernel(function: Kernel) -> Kernel:
    """Pasted into its caller, so that the caller's loop can become vector instructions."""
    return cast(Kernel, njit(cache=True, nogil=True, inline="always")(function))
