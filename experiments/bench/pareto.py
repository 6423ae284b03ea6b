"""Speed against error: which rows nothing beats, and the chart that shows them."""

import math
from collections.abc import Callable, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..images import figure_uri, label_axes, new_figure
from ..page import scientific
from .row import Row

__all__ = ["frontier", "pareto_figure"]

#: marker, colour, filled, legend
MARKS = {
    "own": ("o", "#2563a8", True, "this package"),
    "paper": ("^", "#b3402e", True, "the paper's method"),
    "peer": ("s", "#6b7280", False, "peers"),
    "floor": ("D", "#1f7a4d", False, "exact correspondence"),
}
ROOM = 2.0  # times the slowest point

Time = Callable[[Row], float]


def frontier(points: Sequence[tuple[float, float]]) -> list[int]:
    """Indices of the points (time, error) that no other point beats in both, by rising time."""
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


def pareto_figure(rows: Sequence[Row], refresh: float) -> str:
    """Two charts side by side as a PNG data URI: error against computing time, and against all time."""
    figure: Figure = new_figure(11.0, 6.2)
    left, right = figure.subplots(1, 2, sharey=True)
    error = "rms height error / peak depth"
    _chart(left, rows, lambda row: row.compute_seconds, "decode + reconstruct [s]", error)
    _chart(
        right,
        rows,
        lambda row: row.display_seconds(refresh) + row.compute_seconds,
        f"display at {refresh:g} Hz + decode + reconstruct [s]",
    )
    if left.get_legend_handles_labels()[0]:
        left.legend(fontsize=8, loc="best")
    return figure_uri(figure)


def _chart(axes: Axes, rows: Sequence[Row], time: Time, label: str, y: str = "") -> None:
    shown = [row for row in rows if row.done and row.error > 0 and time(row) > 0]
    for kind, (marker, colour, filled, legend) in MARKS.items():
        of_kind = [row for row in shown if row.kind == kind]
        if of_kind:
            face = colour if filled else "none"
            axes.plot(
                [time(row) for row in of_kind],
                [row.error for row in of_kind],
                marker,
                color=colour,
                markerfacecolor=face,
                markersize=5.5,
                linestyle="none",
                label=legend,
            )
    real = [row for row in shown if row.kind != "floor"]
    best = [real[i] for i in frontier([(time(row), row.error) for row in real])]
    axes.plot(
        [time(row) for row in best],
        [row.error for row in best],
        drawstyle="steps-post",
        color="#111827",
        linewidth=1.1,
        label="frontier",
        zorder=1,
    )
    for place, row in enumerate(best, start=1):
        at = time(row), row.error
        axes.annotate(
            str(place), at, xytext=(4, 4), textcoords="offset points", fontsize=8, fontweight="bold"
        )
    key = [f"{place}  {_name(row)}" for place, row in enumerate(best, start=1)]
    axes.text(0.0, -0.2, "\n".join(key), transform=axes.transAxes, fontsize=7.5, va="top", linespacing=1.4)
    if shown:
        axes.set_xscale("log")
        axes.set_yscale("log")
        times = [time(row) for row in shown]
        axes.set_xlim(0.6 * min(times), ROOM * max(times))
    axes.grid(True, which="both", color="#e5e7eb", linewidth=0.6)
    axes.set_axisbelow(True)
    label_axes(axes, label, y, frame=True)


def _name(row: Row) -> str:
    frames = f", {row.frames} frame{'s' if row.frames > 1 else ''}" if row.frames else ""
    return f"{row.cell.sequence}, {row.cell.solver}{frames}: {scientific(row.error)}"
