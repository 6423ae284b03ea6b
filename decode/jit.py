"""How this part compiles: cached on disk, without the interpreter's lock."""

import hashlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

from numba import njit
from numba.core.sigutils import normalize_signature

from optolever import compiling
from optolever.compiling import Usual, Within, WithinApart, WithinOnce, WithinPasted, WithinWide, only_within
from optolever.elsewhere import claim, compiling_ahead
from optolever.linking import Linked, Parts, linking

__all__ = [
    "apart_kernel",
    "asked_by",
    "asked_types",
    "called_kernel",
    "calling",
    "compiled_for",
    "fast_kernel",
    "inline_kernel",
    "kernel",
    "leaf_kernel",
    "linked_kernel",
    "outer_kernel",
    "pasted_kernel",
]

Kernel = Callable[..., Any]
#: Reorderings that let loops become vector instructions; NaN and infinity keep their meaning.
_REORDER = {"contract", "reassoc", "nsz", "arcp"}
#: Kernels that decodes of codes (alone), of fringes or of all ask for beside their own, and the types these
#: take.
_ASKED: dict[str, dict[Any, str]] = {}
_types_of: Callable[[str], Any] = normalize_signature
#: Uses that this process has compiled for.
_compiled: set[str] = set()
_USUAL: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
#: Without numba's run time, which counts references.
_LEAF: dict[str, Any] = _USUAL | {"_nrt": False}
#: To be called from Python, not from C.
_OUTER: dict[str, Any] = {"cache": True, "no_cfunc_wrapper": True, "pipeline_class": Usual}
#: Not even that.
_UNWRAPPED: dict[str, Any] = {"no_cpython_wrapper": True}


@lru_cache(maxsize=1)
def _sources() -> str:
    """What they are now, and those of how they are compiled."""
    parts = Path(__file__).parent, Path(compiling.__file__).parent
    files = [file for part in parts for file in sorted(part.glob("*.py"))]
    state = "".join(f"{file.name} {file.stat().st_mtime_ns} {file.stat().st_size};" for file in files)
    return hashlib.sha256(state.encode()).hexdigest()


@lru_cache(maxsize=16)
def _forget_stale(folder: str) -> None:
    """Drop a folder's cached code if a source changed: numba watches a kernel's own file only."""
    stamp = Path(folder) / "kernels.stamp"
    with suppress(OSError):  # a read-only installation has files that do not change
        if stamp.exists() and stamp.read_text() == _sources():
            return
        for cached in stamp.parent.glob("*.nb[ic]"):
            cached.unlink(missing_ok=True)
        stamp.write_text(_sources())


def _kept(dispatcher: Any) -> Kernel:
    """A dispatcher whose cached code is that of these sources."""
    _forget_stale(dispatcher._cache.cache_path)
    return cast(Kernel, dispatcher)


def kernel(function: Kernel) -> Kernel:
    """Compiled exactly as written, to be called from Python."""
    return _kept(njit(**_USUAL, **_OUTER)(function))


def outer_kernel(function: Kernel) -> Kernel:
    """kernel that makes no arrays, so that none of them has its references counted.

    Counting is an atomic addition per array and call: a third of the time of a decode, if it is done for
    every tile. Views of arrays that the caller holds are fine.
    """
    return _kept(njit(**_LEAF, **_OUTER)(function))


def leaf_kernel(function: Kernel) -> Kernel:
    """outer_kernel, but a part of other kernels, which alone can call it and with which it is optimised."""
    return cast(Kernel, only_within(njit(**_LEAF, pipeline_class=Within)(function)))


def linked_kernel(function: Kernel) -> Linked:
    """outer_kernel that kernels call by address (see linking), and Python does not."""
    return Linked(_kept(only_within(njit(**_LEAF, **_OUTER, **_UNWRAPPED)(function))))


def calling(parts: Parts) -> Callable[[Kernel], Kernel]:
    """For an outer kernel that calls linked ones."""
    return lambda dispatcher: cast(Kernel, linking(dispatcher, parts))


def asked_by(use: str, types: str) -> Callable[[Kernel], Kernel]:
    """For a kernel that decodes of such a use ("all", "code", "code alone", "fringes") call, ever with
    arguments of these types: see compiled_for."""

    def noted(dispatcher: Any) -> Kernel:
        _ASKED.setdefault(use, {})[dispatcher] = types
        usual = dispatcher.compile

        def compile_once(signature: Any) -> Any:
            claim(dispatcher, tuple(signature))
            return usual(signature)

        dispatcher.compile = compile_once
        return cast(Kernel, dispatcher)

    return noted


@contextmanager
def compiled_for(*uses: str) -> Iterator[None]:
    """Within, another process compiles what these ask for, if it is not there yet."""
    tasks = [(one, asked_types(one)) for use in uses if use not in _compiled for one in _ASKED.get(use, {})]
    with compiling_ahead(tasks):
        yield
    _compiled.update(uses)


def asked_types(dispatcher: Kernel) -> tuple[Any, ...]:
    """What asked_by says of it."""
    told = next(known[dispatcher] for known in _ASKED.values() if dispatcher in known)
    return cast(tuple[Any, ...], _types_of(f"({told})")[0])


def called_kernel(function: Kernel) -> Kernel:
    """leaf_kernel that is called and not pasted: for those that many ask for, and that are not small."""
    return cast(Kernel, only_within(njit(**_LEAF, pipeline_class=WithinOnce)(function)))


def fast_kernel(function: Kernel) -> Kernel:
    """leaf_kernel, with reordering of sums, fused multiply-add and the widest vectors."""
    return cast(Kernel, only_within(njit(**_LEAF, fastmath=_REORDER, pipeline_class=WithinWide)(function)))


def apart_kernel(function: Kernel) -> Kernel:
    """fast_kernel for callers who see to it that what it writes is reached through one argument only.

    Then a loop with many inputs and outputs becomes vector instructions; without that word the compiler has
    to check every pair of them for overlap, and gives up on more than a few.
    """
    return cast(Kernel, only_within(njit(**_LEAF, fastmath=_REORDER, pipeline_class=WithinApart)(function)))


def inline_kernel(function: Kernel) -> Kernel:
    """Pasted into its caller, so that the caller's loop can become vector instructions: where numba has to
    see what is None, and where a pasted_kernel was measured to be slower."""
    return cast(Kernel, njit(**_USUAL, cache=True, inline="always")(function))


def pasted_kernel(function: Kernel) -> Kernel:
    """fast_kernel, pasted by LLVM and not by numba, which would type it again in every caller."""
    return cast(Kernel, only_within(njit(**_LEAF, fastmath=_REORDER, pipeline_class=WithinPasted)(function)))
