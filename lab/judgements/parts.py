"""The parts of the program whose judgements are measured, and their rows."""

from collections.abc import Callable

from optolever.errors import InputError

from . import decode, heights, live
from .record import Row

__all__ = ["PARTS", "judged"]

#: Part -> rows of so many seeds.
PARTS: dict[str, Callable[[int], list[Row]]] = {
    "decode": decode.rows,
    "heights": heights.rows,
    "live": live.rows,
}


def judged(part: str | None, seeds: int) -> list[Row]:
    """Rows of a part, of all parts for None. InputError names the parts."""
    if part is not None and part not in PARTS:
        raise InputError(f"--part {part}: unknown, must be one of {', '.join(PARTS)}")
    return [row for name, rows in PARTS.items() if part in (None, name) for row in rows(seeds)]
