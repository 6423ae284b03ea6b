"""Large arrays on whole huge pages, and used again: memory that is new to a process costs more than writing
to it.
"""

import math
import os
import re
import weakref
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from optolever.errors import InputError

__all__ = ["free_memory", "require_room", "roomy_empty"]

#: A huge page of the usual systems, and what is too little to be kept, bytes.
_PAGE, _LITTLE = 1 << 21, 1 << 16
#: A line of the cache, bytes.
_LINE = 64
#: Bytes that are kept for later at most: the maps of two captures of 2 Mpx, with room.
_MOST = 1 << 28
#: Arrays that are kept at most.
_ROOMS = 64
#: Memory of arrays that nobody holds any more, by their size.
_kept: dict[int, list[NDArray[np.uint8]]] = {}


def require_room(what: str, size: float) -> None:
    """InputError if so many bytes are more than the machine has left: what for, how many, what there is."""
    there = free_memory()
    if size > there:
        raise InputError(f"{what}: takes {size / 2**30:.3g} GiB of memory, {there / 2**30:.3g} GiB are free")


def free_memory() -> int:
    """Bytes that can be had without swapping; of a system that does not tell, all that it has."""
    with suppress(OSError):
        found = re.search(r"MemAvailable:\s*(\d+) kB", Path("/proc/meminfo").read_text(encoding="ascii"))
        if found:
            return int(found[1]) * 1024
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def roomy_empty(shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """np.empty; but for little ones, the memory of an array of that size that nobody holds any more, if there
    is one. Of one huge page or more: its pages are its own from the first to the last byte.

    The system clears what it gives to a process, which takes longer than writing to it.
    NumPy asks for huge pages, but the ends of an array share theirs with others, and what does not fill a
    huge page is fetched by 4 KiB. The room beside the array is never touched, so that it takes no memory.
    """
    kind = np.dtype(dtype)
    size = math.prod(shape) * kind.itemsize
    if size < _LITTLE:
        return np.empty(shape, kind)
    room = _taken(size)
    # views of this array are held by it alone, as its own memory is not an array's
    held = np.frombuffer(room.data, np.uint8)
    weakref.finalize(held, _keep, size, room).atexit = False
    start = -room.ctypes.data % (_PAGE if size >= _PAGE else _LINE)
    return held[start : start + size].view(kind).reshape(shape)


def _taken(size: int) -> NDArray[np.uint8]:
    """Room for an array of this size and for its place among huge pages."""
    try:
        return _pop(size)
    except (KeyError, IndexError):
        return np.empty(size + (2 * _PAGE if size >= _PAGE else _LINE), np.uint8)


def _pop(size: int) -> NDArray[np.uint8]:
    rooms = _kept[size]
    room = rooms.pop()  # one step: another thread takes another one, or none
    if not rooms:
        _kept.pop(size, None)
    return room


def _keep(size: int, room: NDArray[np.uint8]) -> None:
    """Room that is not held any more, for the next array of its size; sizes that were kept first make way."""
    if size > _MOST:
        return
    while _is_full(size):
        with suppress(KeyError, IndexError, StopIteration):
            _pop(next(iter(list(_kept))))
    _kept.setdefault(size, []).append(room)


def _is_full(size: int) -> bool:
    """Whether room of that size would be too much."""
    counts = [(each, len(rooms)) for each, rooms in list(_kept.items())]
    return sum(count for _, count in counts) >= _ROOMS or sum(a * b for a, b in counts) + size > _MOST
