"""The chart of error against a cost: a grid of panels, a mark per code, its number named below."""

from __future__ import annotations

import math
from collections.abc import Mapping
from collections.abc import Sequence as Many
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.arrays import Floats
from optolever.files import atomic_file
from optolever.quantities import length_unit
from optolever.records import default_style

from .tradeoff import LEAST_SHARE, Tradeoff

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["Panel", "condition_panels", "write_tradeoff_chart"]

_COSTS = {
    "cpu_seconds": ("CPU time by a profile, decode and solve [s]", (1, 2, 5)),
    "acquisition_seconds": ("time to show and take the frames [s]", (1, 2, 5)),
    "frames": ("pictures taken", (1, 1.2, 1.8, 2.4, 3.5, 5, 7)),
}
_WIDTH, _HEIGHT = 4.4, 3.6  # of a panel, inches
_RATIOS = (0.25, 0.5, 1.0, 2.0, 4.0)  # of error over sigma, on the colour scale
_DEFAULT, _COLUMNS = "gray+phase", 3  # of the names
_CORNERS = [(x, y) for x in (12.0, -12.0) for y in (9.0, -9.0)]  # of a mark, dots


class Panel(NamedTuple):
    """Codes and their cost, the name of a field of Tradeoff."""

    title: str
    rows: Many[Tradeoff]
    cost: str


def condition_panels(rows: Many[Tradeoff]) -> list[list[Panel]]:
    """Both times, a line of panels per condition."""
    of = {
        one: [row for row in rows if row.condition == one] for one in dict.fromkeys(r.condition for r in rows)
    }
    return [[Panel(name, of[name], cost) for cost in ("cpu_seconds", "acquisition_seconds")] for name in of]


@default_style()
def write_tradeoff_chart(
    path: Path, panels: Many[Many[Panel]], title: str = "", names: Mapping[str, str] | None = None
) -> None:
    """Write a PNG: height error over cost, standard deviations over the seeds as bars, error over sigma as
    the colour, a ring around the default, the codes that no other beats in both as a grey line. names: marks
    other than numbers, drawn as diamonds."""
    from matplotlib.figure import Figure

    marks, places, letters = None, [], names or {}
    size = len(panels), max(map(len, panels), default=1)
    inches = _WIDTH * size[1], _HEIGHT * size[0]
    figure = Figure(figsize=inches, dpi=110, layout="constrained", facecolor="white")
    every = [row for line in panels for panel in line for row in panel.rows if _drawn(row)]
    found = dict.fromkeys(row.code for line in panels for panel in line for row in panel.rows)
    codes = [code for code in found if code not in letters]
    called = {code: str(k) for k, code in enumerate(codes, 1)} | dict(letters)
    factor, unit = length_unit(float(np.median([row.simulated for row in every])) if every else 1.0)
    for line, axes in zip(panels, figure.subplots(*size, sharey="row", squeeze=False), strict=True):
        errors = [factor * row.simulated for panel in line for row in panel.rows if _drawn(row)]
        if errors:
            axes[0].set(yscale="log", ylim=(min(errors) / 1.7, max(errors) * 1.7))
        axes[0].set_ylabel(f"height error, rms [{unit}]", fontsize=9)
        for panel, axis in zip(line, axes, strict=True):
            rows = [row for row in panel.rows if _drawn(row)]
            marks = _draw(axis, rows, panel.cost, factor, letters) or marks
            places += [(axis, row.code, getattr(row, panel.cost), factor * row.simulated) for row in rows]
            lost = ", ".join(called[row.code] for row in panel.rows if not _drawn(row))
            axis.set_title(panel.title + (f"; no height: {lost}" if lost else ""), fontsize=9, loc="left")
    if marks is not None:
        bar = figure.colorbar(marks, ax=figure.axes, ticks=np.log2(_RATIOS), aspect=20 * size[0])
        bar.ax.set_yticklabels([f"{ratio:g}" for ratio in _RATIOS])
        bar.set_label("error / sigma: 1 where error bars are true", fontsize=9)
    figure.suptitle(f"{title}; grey: nothing is both faster and better".lstrip("; "), fontsize=9)
    figure.draw_without_rendering()  # the panels' places
    for axis in figure.axes:
        _label(axis, [(called[code], x, y) for panel, code, x, y in places if panel is axis])
    words = [f"{called[code]}  {code}" for code in (*codes, *letters)]
    lines = -(-len(words) // _COLUMNS)
    for k in range(_COLUMNS):
        column = "\n".join(words[k * lines : (k + 1) * lines])
        figure.text(0.01 + k / _COLUMNS, -0.01, column, fontsize=8, va="top")
    with atomic_file(path) as temporary:
        figure.savefig(temporary, format="png", bbox_inches="tight")


def _drawn(row: Tradeoff) -> bool:
    """Whether most of the pixels have a height."""
    return row.simulated > 0 and row.cpu_seconds > 0 and not row.share < LEAST_SHARE


def _label(panel: Axes, marks: Many[tuple[str, float, float]]) -> None:
    """Each mark's number at that of its corners which is farthest from other marks and numbers."""
    at = [np.asarray(panel.transData.transform((x, y))) for _, x, y in marks]
    taken = list(at)
    for k, (text, x, y) in enumerate(marks):
        others = [one for i, one in enumerate(taken) if i != k]
        away = [
            min((float(np.hypot(*(at[k] + corner - one))) for one in others), default=0.0)
            for corner in _CORNERS
        ]
        corner = _CORNERS[int(np.argmax(away))]
        taken.append(at[k] + corner)
        panel.annotate(text, (x, y), corner, textcoords="offset pixels", fontsize=8, ha="center", va="center")


def front(cost: Floats, error: Floats) -> NDArray[np.intp]:
    """Indices (n,) of codes that are not beaten in both, in order of their cost."""
    order = np.lexsort((error, cost))
    least = np.minimum.accumulate(np.concatenate([[np.inf], error[order]]))[:-1]
    return np.asarray(order[error[order] < least])


def _draw(panel: Axes, rows: Many[Tradeoff], name: str, factor: float, letters: Mapping[str, str]) -> Any:
    """One panel; its marks."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    label, ticks = _COSTS[name]
    panel.set(xscale="log", yscale="log")
    for axis, subs in ((panel.xaxis, ticks), (panel.yaxis, (1, 2, 5))):
        axis.set_major_locator(LogLocator(10, subs, numticks=9))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())
    panel.set_xlabel(label, fontsize=9)
    panel.tick_params(labelsize=8)
    panel.grid(color="0.93")
    panel.spines[["top", "right"]].set_visible(False)
    if not rows:
        return None
    cost = np.array([getattr(row, name) for row in rows])
    error, spread = (factor * np.array([getattr(row, of) for row in rows]) for of in ("simulated", "spread"))
    panel.set_xlim(cost.min() / 1.3, cost.max() * 1.3)
    best = front(cost, error)
    ends = [*cost[best], cost.max()], [*error[best], error[best][-1]]
    panel.step(*ends, where="post", color="0.75", lw=1.2, zorder=1)
    aside = [row.cpu_spread if name == "cpu_seconds" else 0.0 for row in rows]
    y, x = (
        np.nan_to_num(np.stack([np.minimum(one, 0.9 * at), one]))
        for one, at in ((spread, error), (aside, cost))
    )
    panel.errorbar(cost, error, y, x, fmt="none", ecolor="0.3", elinewidth=1, capsize=2, zorder=2)
    ratio = np.log2([row.ratio if row.ratio > 0 else math.nan for row in rows])
    ring = np.array([row.code == _DEFAULT for row in rows])
    panel.scatter(cost[ring], error[ring], s=170, facecolor="none", edgecolor="0.2", lw=1.2, zorder=3)
    own, marks = np.array([row.code in letters for row in rows]), None
    for where, shape in ((own, "D"), (~own, "o")):
        marks = panel.scatter(
            cost[where], error[where], c=ratio[where], marker=shape, cmap="coolwarm", vmin=-2, vmax=2, s=45,
            edgecolor="0.2", lw=0.8, zorder=3,
        )  # fmt: skip
    return marks
