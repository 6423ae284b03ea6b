"""What a bench says in a few rows per mirror: the best, the single shot, the paper's method, the peers."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from ..page import percent, scientific, seconds_text
from .row import Row

__all__ = ["SUMMARY", "Line", "ahead_of_peers", "markdown", "summary", "summary_cells"]

LOSS = 0.05  # share of the pixels that a chain may lose against the one that loses least
FEW = 20  # frames of the row "few frames"
PAPER = 0.01  # of the depth: the error that the paper states
TIME = "compute"
SUMMARY = (
    "",
    "sequence",
    "solver",
    "frames",
    "compute",
    "rms",
    "1 % over it",
    "err/sigma",
    "flagged",
    "silent",
)


@dataclass(frozen=True, slots=True)
class Line:
    """A row and what it stands for."""

    what: str
    row: Row


def summary(rows: Iterable[Row]) -> list[Line]:
    """Of one mirror: the least error of every kind, among those that measure what the others do; what does
    not exist is left out."""
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
    return [Line(what, min(some, key=lambda row: row.error)) for what, some in wanted if some]


def ahead_of_peers(rows: Iterable[Row]) -> float:
    """Least ratio, over all peer chains, of their error to the least of this package's own with no more
    frames: above 1 it is ahead of every one. NaN where there is no peer."""
    done = _whole(rows)
    own = [row for row in done if row.kind == "own"]
    ratios = []
    for peer in (row for row in done if row.kind == "peer" and row.cell.decoder != "exact"):
        equal = [row.error for row in own if row.frames <= peer.frames]
        ratios.append(peer.error / min(equal) if equal else 0.0)
    return min(ratios, default=math.nan)


def _whole(rows: Iterable[Row]) -> list[Row]:
    """Rows with an error that flag not many more pixels than the least; lattice lines flag nothing."""
    done = [row for row in rows if row.done and math.isfinite(row.error) and row.error > 0]
    flagged = [row.metrics.get("flagged_share", 0.0) for row in done]
    least = min((f for f, row in zip(flagged, done, strict=True) if row.kind != "floor"), default=0.0)
    return [row for f, row in zip(flagged, done, strict=True) if f <= least + LOSS]


def summary_cells(line: Line) -> list[str]:
    """A line as text under SUMMARY."""
    row, number = line.row, line.row.metrics.get
    ratio = number("sigma_ratio_height", math.nan)
    stated = math.isfinite(ratio)
    return [
        line.what,
        row.cell.sequence,
        row.cell.solver,
        str(row.frames),
        seconds_text(row.compute_seconds),
        scientific(row.error),
        f"{PAPER / row.error:.3g}",
        f"{ratio:.2f}" if stated else "–",
        percent(number("flagged_share", math.nan)),
        percent(number("silent_share", math.nan)) if stated else "–",
    ]


def markdown(groups: Sequence[tuple[str, Sequence[Row]]]) -> str:
    """Summaries of named mirrors as one Markdown table, without times: those belong to a machine."""
    header = ("mirror", *(name for name in SUMMARY[1:] if name != TIME))
    lines = [f"| {' | '.join(header)} |", f"|{'---|' * len(header)}"]
    short = [name.partition(",")[0] for name, _ in groups]
    for scene, (whole, rows) in zip(short, groups, strict=True):
        name = scene if short.count(scene) == 1 else whole
        before: Row | None = None
        for line in summary(rows):
            if line.row is not before:
                cells = dict(zip(SUMMARY, summary_cells(line), strict=True))
                what, sequence, *rest = (text for column, text in cells.items() if column != TIME)
                lines.append(f"| {' | '.join([f'{name}: {what}', f'`{sequence}`', *rest])} |")
            before = line.row
    return "\n".join(lines)
