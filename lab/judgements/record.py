"""A test of the program on captures of one kind, and its tables: of every test its limit and false alarms, of
every kind of fault the misses; the section of docs/benchmarks.md."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..figures.page import sections_of, table_of, with_sections

__all__ = ["FALSE_HEADS", "MISSED_HEADS", "Row", "false_alarms", "misses", "with_section"]

FALSE_HEADS = ("part", "test", "limit", "right captures", "false alarms", "of kind")
MISSED_HEADS = ("part", "fault", "named by", "wrong captures", "missed")
_TITLE = "Judgements"


@dataclass(frozen=True, slots=True)
class Row:
    """part: decode or heights; test: its name; kind: of captures; limit: of its figure (NaN: it has
    none that is one number). right: captures whose results are right, false_alarms: of these the ones that
    the test names; wrong: captures with a fault whose results are wrong, missed: of these the ones that it
    does not name."""

    part: str
    test: str
    kind: str
    limit: float
    right: int
    false_alarms: int
    wrong: int
    missed: int


def false_alarms(rows: Iterable[Row]) -> list[tuple[str, ...]]:
    """Cells of every test: its limit, right captures, false alarms and their kinds."""
    tests: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        tests.setdefault((row.part, row.test), []).append(row)
    lines = []
    for (part, test), some in tests.items():
        if not any(row.right for row in some):
            continue
        kinds = ", ".join(row.kind for row in some if row.false_alarms)
        counts = (str(sum(getattr(row, name) for row in some)) for name in ("right", "false_alarms"))
        lines.append((part, test, _limit(some), *counts, kinds))
    return lines


def misses(rows: Iterable[Row]) -> list[tuple[str, ...]]:
    """Cells of every kind of fault: the tests that name it, wrong captures and the missed ones; of right
    kinds where some results are wrong, too."""
    shown = (row for row in rows if row.wrong or (row.test != "any" and not row.right))
    return [(row.part, row.kind, row.test, str(row.wrong), str(row.missed)) for row in shown]


def _limit(some: Sequence[Row]) -> str:
    known = sorted({row.limit for row in some if math.isfinite(row.limit)})
    return "" if not known else f"{known[0]:.3g}" if len(known) == 1 else f"{known[0]:.3g} to {known[-1]:.3g}"


def with_section(page: Path, rows: Sequence[Row], command: str) -> None:
    """Write the tables into a page in place of its section; lines of other parts stay."""
    old = sections_of(page)[1].get(_TITLE, "").splitlines()
    parts = {"part", *(row.part for row in rows)}
    stay = [line for line in old if line[:2] == "| " and line[2:].split(" |")[0] not in parts]
    lines = [_TITLE, "", f"`{command}`: tests of captures and results, on right and on wrong ones.", ""]
    for heads, cells in ((FALSE_HEADS, false_alarms(rows)), (MISSED_HEADS, misses(rows))):
        named, ruled, *new = table_of(heads, cells)
        lines += [named, ruled, *(line for line in stay if line.count("|") == len(heads) + 1), *new, ""]
    with_sections(page, {_TITLE: "\n".join(lines)})
