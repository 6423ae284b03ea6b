"""The report of a bench: a section per mirror with charts and table; prose in ../report/bench.html."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..metrics import peak_bytes
from ..page import percent, render_page, scientific, seconds_text, stage_bars, table, write_page
from .pareto import frontier, pareto_figure
from .row import Row
from .summary import SUMMARY, ahead_of_peers, markdown, summary, summary_cells

__all__ = ["bench_html", "bench_markdown", "bench_table", "write_bench_report"]

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

    def best(self, refresh: float) -> set[int]:
        """Places of the rows that nothing beats in computing time or in all time, and error."""
        real = [place for place, row in enumerate(self.rows) if row.done and row.cell.decoder != "exact"]
        found: set[int] = set()
        for display in (0.0, 1.0):
            points = [
                (
                    display * self.rows[place].display_seconds(refresh) + self.rows[place].compute_seconds,
                    self.rows[place].error,
                )
                for place in real
            ]
            found |= {real[i] for i in frontier(points)}
        return found


def groups(rows: Iterable[Row]) -> list[Group]:
    """Rows by mirror; the exact correspondence, which has no noise, goes with every noise of its mirror."""
    listed = list(rows)
    kept: dict[tuple[Any, ...], list[Row]] = {}
    for row in listed:
        if row.cell.decoder != "exact":
            kept.setdefault((*row.cell.place, row.cell.noise), []).append(row)
    if not kept:
        for row in listed:
            kept.setdefault((*row.cell.place, row.cell.noise), []).append(row)
    else:
        for row in listed:
            for key, members in kept.items():
                if row.cell.decoder == "exact" and key[:3] == row.cell.place:
                    members.append(row)
    return [Group(_name(key), members) for key, members in kept.items()]


def table_cells(row: Row, refresh: float, floor: float | None) -> list[str]:
    """A finished row as text under HEADER."""
    number = row.metrics.get
    render, decode, solve, copy = (
        row.timings.get(f"{stage}_seconds", 0.0) for stage in ("render", "decode", "reconstruct", "floor")
    )
    memory = max(row.timings.get("decode_bytes", 0.0), row.timings.get("reconstruct_bytes", 0.0))
    ratio = row.error / floor if floor else math.nan
    return [
        row.cell.sequence,
        row.cell.solver,
        str(row.frames) if row.frames else "",
        seconds_text(row.display_seconds(refresh)) if row.frames else "",
        seconds_text(render) if render else "",
        seconds_text(decode) if decode else "",
        f"{decode / copy:.3g}" if copy else "",
        seconds_text(solve) if solve else "",
        f"{memory / 2**20:.3g} MiB" if memory else "",
        *(scientific(number(f"height_{name}_rel", math.nan)) for name in ("rms", "p95", "max")),
        _fixed(number("sigma_ratio_height", math.nan)),
        percent(number("flagged_share", math.nan)),
        _share(row),
        "" if not math.isfinite(ratio) else f"{ratio:.3g}" if ratio < 1000 else f"{ratio:.0f}",
    ]


def bench_table(rows: Iterable[Row], refresh: float) -> Iterator[tuple[str, list[list[str]], list[str]]]:
    """For the terminal: of every mirror its name, HEADER and under it the rows, best first, and what is
    absent.
    """
    for group in groups(rows):
        floors = group.floors()
        ranked = sorted((row for row in group.rows if row.done), key=_rank)
        yield (
            group.name,
            [
                _terminal(HEADER),
                *(_terminal(table_cells(row, refresh, floors.get(row.cell.solver))) for row in ranked),
            ],
            group.absent(),
        )


def bench_markdown(rows: Iterable[Row]) -> str:
    """The table of the benchmarks page: a few rows per mirror."""
    return markdown([(group.name, group.rows) for group in groups(rows)])


def write_bench_report(
    path: str | Path, rows: Sequence[Row], settings: dict[str, Any], seconds: dict[str, float], command: str
) -> None:
    """Write the page, whole or not at all."""
    write_page(path, bench_html(rows, settings, seconds, command))


def bench_html(rows: Sequence[Row], settings: dict[str, Any], seconds: dict[str, float], command: str) -> str:
    """The whole page."""
    refresh = float(settings["refresh"])
    sections = [_section(place, group, refresh) for place, group in enumerate(groups(rows))]
    context = {
        "asked": settings,
        "sections": sections,
        "count": sum(row.done for row in rows),
        "missing": sum(not row.done for row in rows),
        "stages": stage_bars(seconds),
        "memory_gib": peak_bytes() / 2**30,
        "command": command,
    }
    return render_page("bench.html", context)


def _section(place: int, group: Group, refresh: float) -> dict[str, Any]:
    floors, best = group.floors(), group.best(refresh)
    done = [i for i, row in enumerate(group.rows) if row.done]
    order = sorted(done, key=lambda i: _rank(group.rows[i]))
    lines = (
        (
            "best" if i in best else "",
            table_cells(group.rows[i], refresh, floors.get(group.rows[i].cell.solver)),
        )
        for i in order
    )
    return {
        "id": f"mirror-{place}",
        "name": group.name,
        "chart": pareto_figure(group.rows, refresh),
        "table": table(f"rows-{place}", HEADER, lines, texts=2),
        "headline": _headline(group),
        "summary": _summary(place, group),
        "absent": group.absent(),
    }


def _summary(place: int, group: Group) -> dict[str, Any]:
    """The table of `summary`."""
    lines = (("", summary_cells(line)) for line in summary(group.rows))
    return table(f"summary-{place}", SUMMARY, lines, texts=3)


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


def _terminal(cells: Sequence[str]) -> list[str]:
    """What of a row fits into a terminal."""
    return [cell for name, cell in zip(HEADER, cells, strict=True) if name not in REPORT_ONLY]


def _rank(row: Row) -> float:
    return row.error if math.isfinite(row.error) else math.inf


def _name(key: tuple[Any, ...]) -> str:
    scene, size, dent, noise = key
    pixels = "" if size is None else f", {size[0]} × {size[1]}"
    return f"{Path(scene).stem}, {dent or 'own dent'}{pixels}, noise {noise:g}"


def _fixed(value: float) -> str:
    return f"{value:.3f}" if math.isfinite(value) else "–"


def _share(row: Row) -> str:
    """Silent share, unknown where the method states no sigma."""
    if not math.isfinite(row.metrics.get("sigma_ratio_height", math.nan)):
        return "–"
    return percent(row.metrics.get("silent_share", math.nan))
