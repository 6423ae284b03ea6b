"""The report of a bench: a section per mirror with charts, table and summary (the best, the single shot, the
paper's method, the peers); prose in ../report/bench.html.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..arrays import Floats
from ..images import figure_uri, label_axes, new_figure
from ..page import percent, scientific, seconds_text, table, write_page
from .cell import Row

HEADER = (
    *("sequence", "solver", "frames", "display", "render", "decode", "x copy", "solve", "memory"),
    *("rms", "95 %", "max", "err/sigma", "flagged", "silent", "x exact"),
)
NAMED = 6  # names in a line at most
REPORT_ONLY = ("render", "x copy", "memory", "95 %", "x exact")
LOSS = 0.05  # share of flagged pixels in excess of the minimum, above which a chain is not compared
FEW = 20  # frames at most of the row "at most 20 frames"
PAPER = 0.01  # of the depth: the error stated in the paper
TIME = "compute"
SUMMARY = ("sequence", "solver", "frames", TIME, "rms", "1 % over it", "err/sigma", "flagged", "silent")
#: marker, colour, filled, legend
MARKS = {
    "own": ("o", "#2563a8", True, "this package"),
    "paper": ("^", "#b3402e", True, "the paper's method"),
    "peer": ("s", "#6b7280", False, "peers"),
    "floor": ("D", "#1f7a4d", False, "exact correspondence"),
}

Time = Callable[[Row], float]


def frontier(points: Sequence[tuple[float, float]]) -> list[int]:
    """Indices of the Pareto-optimal points (time, error), by rising time."""
    order = sorted(
        (i for i, (time, error) in enumerate(points) if math.isfinite(time) and math.isfinite(error)),
        key=lambda i: points[i],
    )
    best, kept = math.inf, []
    for i in order:
        if points[i][1] < best:
            best = points[i][1]
            kept.append(i)
    return kept


def pareto_figure(rows: Sequence[Row], times: dict[str, Time]) -> str:
    """Charts side by side as a PNG data URI: error over each of the named times."""
    figure: Figure = new_figure(11.0, 6.2)
    left, right = figure.subplots(1, 2, sharey=True)
    for axes, (label, time) in zip((left, right), times.items(), strict=True):
        _chart(axes, rows, time, label, "rms height error / peak depth" if axes is left else "")
    if left.get_legend_handles_labels()[0]:
        left.legend(fontsize=8, loc="best")
    return figure_uri(figure)


def _best(rows: Iterable[Row], time: Time) -> list[Row]:
    """Pareto-optimal rows in time and error."""
    real = [row for row in rows if row.done and row.kind != "floor"]
    return [real[i] for i in frontier([(time(row), row.error) for row in real])]


def _chart(axes: Axes, rows: Sequence[Row], time: Time, label: str, y: str) -> None:
    shown = [row for row in rows if row.done and row.error > 0 and time(row) > 0]
    for kind, (marker, colour, filled, legend) in MARKS.items():
        points = _points((row for row in shown if row.kind == kind), time)
        if points.size:
            face = colour if filled else "none"
            axes.plot(*points.T, marker, color=colour, markerfacecolor=face, markersize=5.5, label=legend)
    best = _best(shown, time)
    points = _points(best, time)
    axes.step(*points.T, where="post", color="#111827", linewidth=1.1, label="frontier", zorder=1)
    style: dict[str, Any] = {"textcoords": "offset points", "fontsize": 8, "fontweight": "bold"}
    for place, at in enumerate(points, start=1):
        axes.annotate(str(place), at, xytext=(4, 4), **style)
    key = [f"{place}  {_key(row)}" for place, row in enumerate(best, start=1)]
    axes.text(0.0, -0.2, "\n".join(key), transform=axes.transAxes, fontsize=7.5, va="top", linespacing=1.4)
    if shown:
        axes.set(xscale="log", yscale="log")
    axes.grid(True, which="both", color="#e5e7eb", linewidth=0.6)
    axes.set_axisbelow(True)
    label_axes(axes, label, y, frame=True)


def _points(rows: Iterable[Row], time: Time) -> Floats:
    """Time and error of each, (n, 2)."""
    return np.array([(time(row), row.error) for row in rows]).reshape(-1, 2)


def _key(row: Row) -> str:
    frames = f", {row.frames} frame{'s' if row.frames > 1 else ''}" if row.frames else ""
    return f"{row.cell.sequence}, {row.cell.solver}{frames}: {scientific(row.error)}"


@dataclass(frozen=True, slots=True)
class Group:
    """Rows of one mirror under one noise."""

    name: str
    rows: list[Row]

    def absent(self) -> list[str]:
        """Reasons of missing results: a line per reason, with its sequences and solvers."""
        reasons: dict[str, list[Row]] = {}
        for row in self.rows:
            if not row.done:
                reasons.setdefault(f"{row.status}: {row.why}", []).append(row)
        lines = []
        for why, rows in reasons.items():
            sequences, solvers = (
                _listed(getattr(row.cell, name) for row in rows) for name in ("sequence", "solver")
            )
            lines.append(f"{sequences} with {solvers}: {why}")
        return lines

    def ranked(self) -> list[Row]:
        """Rows with results, the smallest error first."""
        done = [row for row in self.rows if row.done]
        return sorted(done, key=lambda row: row.error if math.isfinite(row.error) else math.inf)


def groups(rows: Iterable[Row]) -> list[Group]:
    """Rows by mirror and noise; the exact correspondence, without noise, joins every group of its mirror."""
    listed = list(rows)
    exact = [row for row in listed if row.cell.decoder == "exact"]
    others = [row for row in listed if row.cell.decoder != "exact"]
    kept: dict[tuple[Any, ...], list[Row]] = {}
    for row in others or exact:
        kept.setdefault((*row.cell.place, row.cell.noise), []).append(row)
    for key, members in kept.items() if others else ():
        members += [row for row in exact if row.cell.place == key[:-1]]
    return [Group(_name(key), members) for key, members in kept.items()]


def bench_table(rows: Iterable[Row], refresh: float) -> Iterator[tuple[str, list[list[str]], list[str]]]:
    """For the terminal: per mirror its name, a header with the rows, best first, and the missing results."""
    shown = [name for name in HEADER if name not in REPORT_ONLY]
    for group in groups(rows):
        lines = [_cells(row, shown, refresh) for row in group.ranked()]
        yield group.name, [shown, *lines], group.absent()


def write_bench_report(
    path: str | Path, rows: Sequence[Row], settings: dict[str, Any], seconds: dict[str, float]
) -> None:
    """Write the page, atomically."""
    refresh = float(settings.get("rate", settings["refresh"]))
    context = {
        "asked": settings,
        "sections": [_section(place, group, refresh) for place, group in enumerate(groups(rows))],
        "count": sum(row.done for row in rows),
        "missing": sum(not row.done for row in rows),
    }
    write_page(path, "bench.html", seconds, context)


def _section(place: int, group: Group, refresh: float) -> dict[str, Any]:
    times: dict[str, Time] = {
        "decode + reconstruct [s]": lambda row: row.compute_seconds,
        f"display of {refresh:.4g} frames/s + decode + reconstruct [s]": lambda row: (
            row.display_seconds(refresh) + row.compute_seconds
        ),
    }
    # error of each solver with perfect decoding
    floors = {row.cell.solver: row.error for row in group.rows if row.kind == "floor" and row.done}
    best = [row for time in times.values() for row in _best(group.rows, time)]
    lines = (
        ("best" if row in best else "", _cells(row, HEADER, refresh, floors.get(row.cell.solver, math.nan)))
        for row in group.ranked()
    )
    short = (("", [what, *_cells(row, SUMMARY)]) for what, row in summary(group.rows).items())
    ratio = ahead_of_peers(group.rows)
    ahead = f"At no more frames, the best chain here has {ratio:.3g} times less error than the nearest peer."
    return {
        "id": f"mirror-{place}",
        "name": group.name,
        "chart": pareto_figure(group.rows, times),
        "table": table(f"rows-{place}", HEADER, lines, texts=2),
        "headline": ahead if math.isfinite(ratio) else "No peer ran.",
        "summary": table(f"summary-{place}", ("", *SUMMARY), short, texts=3),
        "absent": group.absent(),
    }


def _listed(names: Iterable[str]) -> str:
    """The different names, or their number if there are many."""
    different = list(dict.fromkeys(names))
    return ", ".join(different) if len(different) <= NAMED else f"{len(different)} sequences"


def _name(key: tuple[Any, ...]) -> str:
    scene, size, dent, faults, noise = key
    told = f", {faults}" if str(faults) else ""
    pixels = "" if size is None else f", {size[0]} × {size[1]}"
    return f"{Path(scene).stem}, {dent or 'own dent'}{pixels}, noise {noise:g}{told}"


def summary(rows: Iterable[Row]) -> dict[str, Row]:
    """For one mirror: the row of smallest error of each category, among the rows that flag few more pixels
    than the minimum; empty categories are omitted."""
    done = [row for row in _whole(rows) if row.kind != "floor"]
    own = [row for row in done if row.kind == "own"]
    wanted = (
        ("best", own),
        (f"at most {FEW} frames", [row for row in own if row.frames <= FEW]),
        ("single shot", [row for row in own if row.frames == 1]),
        ("the paper's method", [row for row in done if row.kind == "paper"]),
        ("the paper's own frame", [row for row in done if row.cell.shown.startswith("lattice")]),
        ("best peer", [row for row in done if row.kind == "peer"]),
    )
    return {what: min(some, key=lambda row: row.error) for what, some in wanted if some}


def ahead_of_peers(rows: Iterable[Row]) -> float:
    """Smallest ratio, over all peer chains, of the peer's error to this package's smallest error with no more
    frames; above 1: every peer's error is larger. NaN without a peer."""
    done = _whole(rows)
    own = [row for row in done if row.kind == "own"]
    ratios = []
    for peer in (row for row in done if row.kind == "peer" and row.cell.decoder != "exact"):
        equal = [row.error for row in own if row.frames <= peer.frames]
        ratios.append(peer.error / min(equal) if equal else 0.0)
    return min(ratios, default=math.nan)


def _whole(rows: Iterable[Row]) -> list[Row]:
    """Rows with an error whose flagged share exceeds the minimum by at most LOSS."""
    done = [row for row in rows if row.done and math.isfinite(row.error) and row.error > 0]
    flagged = [row.metrics.get("flagged_share", 0.0) for row in done]
    least = min((f for f, row in zip(flagged, done, strict=True) if row.kind != "floor"), default=0.0)
    return [row for f, row in zip(flagged, done, strict=True) if f <= least + LOSS]


def _cells(row: Row, names: Iterable[str], refresh: float = 60.0, floor: float = math.nan) -> list[str]:
    """A finished row as text under the names of columns; floor: error with perfect decoding."""
    number, seconds = row.metrics.get, row.timings.get
    stages = (seconds(f"{stage}_seconds", 0.0) for stage in ("render", "decode", "reconstruct", "floor"))
    render, decode, solve, copy = stages
    memory = max(seconds("decode_bytes", 0.0), seconds("reconstruct_bytes", 0.0))
    sigma = number("sigma_ratio_height", math.nan)  # NaN where the method states none
    ratio = row.error / (floor or math.nan)
    known = {
        "sequence": row.cell.sequence,
        "solver": row.cell.solver,
        "frames": str(row.frames or ""),
        "display": seconds_text(row.display_seconds(refresh)) if row.frames else "",
        "render": seconds_text(render) if render else "",
        "decode": seconds_text(decode) if decode else "",
        "x copy": f"{decode / copy:.3g}" if copy else "",
        "solve": seconds_text(solve) if solve else "",
        TIME: seconds_text(row.compute_seconds),
        "memory": f"{memory / 2**20:.3g} MiB" if memory else "",
        "rms": scientific(row.error),
        "95 %": scientific(number("height_p95_rel", math.nan)),
        "max": scientific(number("height_max_rel", math.nan)),
        "1 % over it": f"{PAPER / row.error:.3g}" if row.error else "",
        "err/sigma": f"{sigma:.3f}" if math.isfinite(sigma) else "–",
        "flagged": percent(number("flagged_share", math.nan)),
        "silent": percent(number("silent_share", math.nan)) if math.isfinite(sigma) else "–",
        "x exact": "" if not math.isfinite(ratio) else f"{ratio:.3g}" if ratio < 1000 else f"{ratio:.0f}",
    }
    return [known[name] for name in names]


def bench_markdown(rows: Iterable[Row]) -> str:
    """The table of the benchmarks page: the summary of each mirror, without times (machine-dependent)."""
    header = ("mirror", *(name for name in SUMMARY if name != TIME))
    lines = [f"| {' | '.join(header)} |", f"|{'---|' * len(header)}"]
    listed = groups(rows)
    short = [group.name.partition(",")[0] for group in listed]
    for scene, group in zip(short, listed, strict=True):
        name = scene if short.count(scene) == 1 else group.name
        before: Row | None = None
        for what, row in summary(group.rows).items():
            if row is not before:
                sequence, *rest = _cells(row, header[1:])
                lines.append(f"| {' | '.join([f'{name}: {what}', f'`{sequence}`', *rest])} |")
            before = row
    return "\n".join(lines)
