"""The report of a bench: a section per mirror with charts and table; prose in ../report/bench.html."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..page import table, write_page
from .pareto import frontier, pareto_figure
from .row import Row
from .summary import SUMMARY, ahead_of_peers, cells, markdown, summary

__all__ = ["bench_markdown", "bench_table", "write_bench_report"]

HEADER = (
    *("sequence", "solver", "frames", "display", "render", "decode", "x copy", "solve", "memory"),
    *("rms", "95 %", "max", "err/sigma", "flagged", "silent", "x exact"),
)
NAMED = 6  # names that a line lists
REPORT_ONLY = ("render", "x copy", "memory", "95 %", "x exact")


@dataclass(frozen=True, slots=True)
class Group:
    """Rows of one mirror under one noise."""

    name: str
    rows: list[Row]

    def floors(self) -> dict[str, float]:
        """Error of every solver on the exact correspondence: what is left when decoding is perfect."""
        return {row.cell.solver: row.error for row in self.rows if row.kind == "floor" and row.done}

    def absent(self) -> list[str]:
        """Why there is no number: a line for every reason, with what it concerns."""
        reasons: dict[str, list[Row]] = {}
        for row in self.rows:
            if not row.done:
                reasons.setdefault(f"{row.status}: {row.why}", []).append(row)
        lines = []
        for why, rows in reasons.items():
            sequences, solvers = (
                [getattr(row.cell, name) for row in rows] for name in ("sequence", "solver")
            )
            lines.append(f"{_listed(sequences)} with {_listed(solvers)}: {why}")
        return lines

    def ranked(self) -> list[Row]:
        """Those with numbers, the least error first."""
        return sorted(
            (row for row in self.rows if row.done),
            key=lambda row: row.error if math.isfinite(row.error) else math.inf,
        )

    def best(self, refresh: float) -> list[Row]:
        """The rows that nothing beats in computing time or in all time, and error."""
        real = [row for row in self.ranked() if row.cell.decoder != "exact"]
        found = []
        for display in (0.0, 1.0):
            times = [display * row.display_seconds(refresh) + row.compute_seconds for row in real]
            found += [real[i] for i in frontier([(t, row.error) for t, row in zip(times, real, strict=True)])]
        return found


def groups(rows: Iterable[Row]) -> list[Group]:
    """Rows by mirror; the exact correspondence, which has no noise, goes with every noise of its mirror."""
    listed = list(rows)
    exact = [row for row in listed if row.cell.decoder == "exact"]
    others = [row for row in listed if row.cell.decoder != "exact"]
    kept: dict[tuple[Any, ...], list[Row]] = {}
    for row in others or exact:
        kept.setdefault((*row.cell.place, row.cell.noise), []).append(row)
    for key, members in kept.items() if others else ():
        members += [row for row in exact if row.cell.place == key[:3]]
    return [Group(_name(key), members) for key, members in kept.items()]


def bench_table(rows: Iterable[Row], refresh: float) -> Iterator[tuple[str, list[list[str]], list[str]]]:
    """For the terminal: of every mirror its name, HEADER and under it the rows, best first, and what is
    absent.
    """
    shown = [name for name in HEADER if name not in REPORT_ONLY]
    for group in groups(rows):
        lines = [cells(row, shown, refresh) for row in group.ranked()]
        yield group.name, [shown, *lines], group.absent()


def bench_markdown(rows: Iterable[Row]) -> str:
    """The table of the benchmarks page: a few rows per mirror."""
    return markdown([(group.name, group.rows) for group in groups(rows)])


def write_bench_report(
    path: str | Path, rows: Sequence[Row], settings: dict[str, Any], seconds: dict[str, float]
) -> None:
    """Write the page, whole or not at all."""
    refresh = float(settings["refresh"])
    context = {
        "asked": settings,
        "sections": [_section(place, group, refresh) for place, group in enumerate(groups(rows))],
        "count": sum(row.done for row in rows),
        "missing": sum(not row.done for row in rows),
    }
    write_page(path, "bench.html", seconds, context)


def _section(place: int, group: Group, refresh: float) -> dict[str, Any]:
    floors, best = group.floors(), group.best(refresh)
    lines = (
        ("best" if row in best else "", cells(row, HEADER, refresh, floors.get(row.cell.solver, math.nan)))
        for row in group.ranked()
    )
    short = (("", [what, *cells(row, SUMMARY)]) for what, row in summary(group.rows).items())
    return {
        "id": f"mirror-{place}",
        "name": group.name,
        "chart": pareto_figure(group.rows, refresh),
        "table": table(f"rows-{place}", HEADER, lines, texts=2),
        "headline": _headline(group),
        "summary": table(f"summary-{place}", ("", *SUMMARY), short, texts=3),
        "absent": group.absent(),
    }


def _headline(group: Group) -> str:
    """One sentence: how far ahead of others at equal frames."""
    ratio = ahead_of_peers(group.rows)
    if not math.isfinite(ratio):
        return "No peer ran."
    return f"At no more frames, the best chain here has {ratio:.3g} times less error than the nearest peer."


def _listed(names: Iterable[str]) -> str:
    """Different names, a few of them by name."""
    different = list(dict.fromkeys(names))
    return ", ".join(different) if len(different) <= NAMED else f"{len(different)} sequences"


def _name(key: tuple[Any, ...]) -> str:
    scene, size, dent, noise = key
    pixels = "" if size is None else f", {size[0]} × {size[1]}"
    return f"{Path(scene).stem}, {dent or 'own dent'}{pixels}, noise {noise:g}"
