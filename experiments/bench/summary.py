"""What a bench says in a few rows per mirror: the best, the single shot, the paper's method, the peers."""

import math
from collections.abc import Iterable, Sequence

from ..page import percent, scientific, seconds_text
from .row import Row

__all__ = ["SUMMARY", "ahead_of_peers", "cells", "markdown", "summary"]

LOSS = 0.05  # share of the pixels that a chain may lose against the one that loses least
FEW = 20  # frames of the row "few frames"
PAPER = 0.01  # of the depth: the error that the paper states
TIME = "compute"
SUMMARY = ("sequence", "solver", "frames", TIME, "rms", "1 % over it", "err/sigma", "flagged", "silent")


def summary(rows: Iterable[Row]) -> dict[str, Row]:
    """Of one mirror: the row of least error of every kind, among those that measure what the others do; what
    does not exist is left out."""
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


def cells(row: Row, names: Iterable[str], refresh: float = 60.0, floor: float = math.nan) -> list[str]:
    """A finished row as text under the names of columns; floor: error where decoding is perfect."""
    number, seconds = row.metrics.get, row.timings.get
    render, decode, solve, copy = (
        seconds(f"{stage}_seconds", 0.0) for stage in ("render", "decode", "reconstruct", "floor")
    )
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


def markdown(groups: Sequence[tuple[str, Sequence[Row]]]) -> str:
    """Summaries of named mirrors as one Markdown table, without times: those belong to a machine."""
    header = ("mirror", *(name for name in SUMMARY if name != TIME))
    lines = [f"| {' | '.join(header)} |", f"|{'---|' * len(header)}"]
    short = [name.partition(",")[0] for name, _ in groups]
    for scene, (whole, rows) in zip(short, groups, strict=True):
        name = scene if short.count(scene) == 1 else whole
        before: Row | None = None
        for what, row in summary(rows).items():
            if row is not before:
                sequence, *rest = cells(row, header[1:])
                lines.append(f"| {' | '.join([f'{name}: {what}', f'`{sequence}`', *rest])} |")
            before = row
    return "\n".join(lines)
