"""How loops are compiled: public Numba, without the interpreter's lock, cached on disk."""

import hashlib
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

import numba

__all__ = ["exact", "inlined", "kernel"]

Kernel = Callable[..., Any]
#: Its settings are made when numba is imported: no checker knows them.
_config: Any = numba.config
#: Reorderings that let loops become vector instructions; NaN and infinity keep their meaning.
_REORDER = {"contract", "reassoc", "nsz", "arcp"}


def kernel(function: Kernel) -> Kernel:
    """A loop whose sums may be reordered, so that it becomes vector instructions."""
    return _compiled(function, fastmath=_REORDER)


def exact(function: Kernel) -> Kernel:
    """A loop that is computed as it is written."""
    return _compiled(function)


def inlined(function: Kernel) -> Kernel:
    """A small function that becomes part of its callers' loops."""
    return _compiled(function, fastmath=_REORDER, inline="always")


def _compiled(function: Kernel, **options: Any) -> Kernel:
    """numba.njit, cached under a key of all sources: Numba itself watches a kernel's own file only, and not
    the files of those that it calls."""
    before = _config.CACHE_DIR
    _config.CACHE_DIR = _cache_folder(Path(function.__code__.co_filename).parent, before)
    try:
        made = numba.njit(cache=True, nogil=True, error_model="numpy", **options)(function)
    finally:
        _config.CACHE_DIR = before
    return cast(Kernel, made)


@lru_cache(maxsize=16)
def _cache_folder(folder: Path, chosen: str) -> str:
    """For kernels of a part: below its __pycache__ or the NUMBA_CACHE_DIR that the user chose, a folder for
    what the part's sources are now."""
    part = folder
    while (part.parent / "__init__.py").exists():
        part = part.parent
    state = hashlib.sha256()
    for file in sorted(part.rglob("*.py")):
        state.update(file.read_bytes())
    return str((Path(chosen) if chosen else part / "__pycache__") / f"kernels-{state.hexdigest()[:16]}")
