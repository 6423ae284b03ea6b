"""Memory that a process can have: asked for before large arrays are made."""

import os
import re
from contextlib import suppress
from pathlib import Path

from optolever.errors import InputError

__all__ = ["free_memory", "require_room"]


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
