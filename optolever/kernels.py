"""How loops are compiled: public Numba, without the interpreter's lock, cached on disk.

A kernel assigns numbers, place by place: `a[:] = b` of two lines makes Numba compile the message that tells
of shapes that differ, some 2 s. Its caller allocates the outputs: each kind of np.zeros is a function to
compile.
"""

import atexit
import gc
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from .processes import SAFE_PATH

__all__ = [
    "F32", "F64", "HALF", "I32", "I64", "ONE", "ZERO", "Real", "are_compiled", "cache_folder",
    "compiled_beside", "exact", "inlined", "inner", "kernel", "plain",
]  # fmt: skip

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
#: Single precision: with Python's own numbers an expression becomes double.
ZERO, HALF, ONE = np.float32(0), np.float32(0.5), np.float32(1)

#: A number of a kernel that single and double precision pass alike: it is compiled for either.
Real = float | np.floating
T = TypeVar("T")
#: Reorderings that let loops become vector instructions; NaN and infinity keep their meaning.
_REORDER = {"contract", "reassoc", "nsz", "arcp"}
#: Caches of older sources that stay, the latest ones: two branches of a checkout take turns.
_KEPT = 3
#: File of a cache of this program; its time is that of the last use.
_MARK = ".optolever"


def kernel(function: Callable[..., T]) -> Callable[..., T]:
    """A loop whose sums may be reordered, so that it becomes vector instructions."""
    return _compiled(function, fastmath=_REORDER)


def exact(function: Callable[..., T]) -> Callable[..., T]:
    """A loop that is computed as it is written."""
    return _compiled(function)


def inner(function: Callable[..., T]) -> Callable[..., T]:
    """A `kernel` that other kernels call, and nobody from Python: each of its arguments would cost."""
    return _compiled(function, fastmath=_REORDER, no_cpython_wrapper=True)


def inlined(function: Callable[..., T]) -> Callable[..., T]:
    """A small function that becomes part of its callers' loops. For numbers: of arrays that it takes
    references are counted on every call where it branches; those that a `kernel` takes are not."""
    return _compiled(function, fastmath=_REORDER, inline="always")


def plain(array: NDArray[Any]) -> NDArray[Any]:
    """The array in C order and native bytes, as writable memory: for all else a kernel is compiled anew."""
    array = np.ascontiguousarray(array, array.dtype.newbyteorder("="))
    if not array.flags.writeable:  # nobody writes to it, but Numba's type differs
        interface = dict(array.__array_interface__)
        interface["data"] = interface["data"][0], False
        array = np.asarray(type("_View", (), {"__array_interface__": interface, "base": array})())
    return array


def _compiled(function: Callable[..., T], **options: Any) -> Callable[..., T]:
    """numba.njit, cached under a key of all sources: Numba itself watches a kernel's own file only, and not
    the files of those that it calls. Where nothing can be kept, every process compiles for itself."""
    import numba  # .3 s, and who asks whether kernels are compiled has none

    _uncollected()
    config: Any = numba.config  # its settings are made when numba is imported: no checker knows them
    folder = cache_folder(Path(function.__code__.co_filename).parent)
    before, config.CACHE_DIR = config.CACHE_DIR, str(folder or "")
    try:
        options |= {"cache": folder is not None, "no_cfunc_wrapper": True}  # nobody calls them from C
        made = numba.njit(nogil=True, error_model="numpy", **options)(function)
    finally:
        config.CACHE_DIR = before
    return cast(Callable[..., T], made)


@lru_cache(maxsize=1)
def _uncollected() -> None:
    """No garbage collection while a kernel is compiled or loaded: it takes a seventh of that time, and finds
    nothing. By the Event API of Numba's manual."""
    from numba.core import event

    before = list[bool]()  # of a lock in a lock, and of other threads

    class Paused(event.Listener):
        def on_start(self, event: object) -> None:
            before.append(gc.isenabled())
            gc.disable()

        def on_end(self, event: object) -> None:
            if before and before.pop():
                gc.enable()

    register: Callable[..., None] = event.register
    register("numba:compiler_lock", Paused())


def are_compiled(part: str) -> bool:
    """Whether kernels of a part (`optolever.decode`) are kept from an earlier run."""
    spec = find_spec(part)
    kept = None if spec is None or spec.origin is None else cache_folder(Path(spec.origin).parent)
    return kept is not None and any(kept.rglob("*.nbi"))


@contextmanager
def compiled_beside(calls: Mapping[str, str]) -> Iterator[Callable[[], Any] | None]:
    """Inside, a second process calls the function (`module:name`) of every part without compiled kernels,
    one after the other; it compiles some into the cache that both share. The function given waits for its
    end. None: all parts have theirs, or there is one core."""
    left = [call for part, call in calls.items() if not are_compiled(part)]
    if not left or (os.cpu_count() or 1) < 2:
        yield None
        return
    text = "import sys\nfrom pkgutil import resolve_name\nfor name in sys.argv[1:]: resolve_name(name)()"
    no = subprocess.DEVNULL
    program = [sys.executable, "-c", text, *left]
    process = subprocess.Popen(program, stdin=no, stdout=no, stderr=no, env=os.environ | SAFE_PATH)
    try:
        yield process.wait
    finally:
        process.kill()
        process.wait()


@lru_cache(maxsize=16)
def cache_folder(folder: Path) -> Path | None:
    """Where the compiled kernels of the part around `folder` are kept, for what its sources are now; None if
    nowhere. The first that can be written: NUMBA_CACHE_DIR, the part's __pycache__, the user's cache folder.
    What lies in those before it that can only be read, as in an installation that its owner has warmed, is
    linked to from there; from a folder of this process alone where none can be written.

    A place that others may write to, as the system's folder for temporary files, is none of them: what is
    kept is loaded as code. Nor is NUMBA_CACHE_DIR taken from Numba, which reads a file in the working folder.
    """
    part = folder
    while (part.parent / "__init__.py").exists():
        part = part.parent
    state = hashlib.sha256()
    for file in sorted(part.rglob("*.py")):
        state.update(file.read_bytes())
    places = [Path(os.environ.get("NUMBA_CACHE_DIR") or part / "__pycache__"), part / "__pycache__"]
    user = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    if user.is_absolute():  # a user without a name, as in containers, has no home folder: "~" stays
        places.append(user / "optolever")
    warmed: list[Path] = []
    for place in places:
        found = place / f"kernels-{part.name}-{state.hexdigest()[:16]}"
        with suppress(OSError):
            found.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=found).close()
            (found / _MARK).touch()
            with suppress(OSError):  # another process may take them away meanwhile
                marks = place.glob(f"kernels-{part.name}-*/{_MARK}")
                for old in sorted(marks, key=lambda one: one.stat().st_mtime)[: -_KEPT - 1]:
                    shutil.rmtree(old.parent, ignore_errors=True)  # each takes up to 25 MB
            return _linked(warmed, found)
        with suppress(OSError):
            warmed += [found] if found not in warmed and any(found.rglob("*.nbi")) else []
    if warmed:
        with suppress(OSError):
            own = Path(tempfile.mkdtemp(prefix="optolever-kernels-"))  # which nobody else may enter
            atexit.register(shutil.rmtree, own, ignore_errors=True)
            return _linked(warmed, own)
    return None


def _linked(warmed: Sequence[Path], folder: Path) -> Path:
    """The folder, with links to what lies in the others: Numba replaces a link, it does not follow it."""
    for other in warmed:
        for file in other.rglob("*.nb?"):
            link = folder / file.relative_to(other)
            with suppress(OSError):  # another process was faster
                link.parent.mkdir(parents=True, exist_ok=True)
                link.symlink_to(file)
    return folder
