"""The chart of error against CPU time and acquisition time: a mark per code, panels per condition."""

from __future__ import annotations

import math
from collections.abc import Sequence as Many
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from optolever.arrays import Floats
from optolever.files import atomic_file
from optolever.images import new_figure
from optolever.quantities import length_unit
from optolever.records import default_style

from .tradeoff import Tradeoff

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["write_tradeoff_chart"]

_COSTS = {
    "cpu_seconds": "CPU time to decode and solve [s]",
    "acquisition_seconds": "time to show and take the frames [s]",
}
_WIDTH, _HEIGHT = 5.0, 3.9  # of a panel, inches
_RATIOS = (0.25, 0.5, 1.0, 2.0, 4.0)  # of error over sigma, on the colour scale


@default_style()
def write_tradeoff_chart(path: Path, rows: Many[Tradeoff], title: str = "") -> None:
    """Write a PNG: height error over both times, its standard deviation over the seeds as a bar, error over
    sigma as the colour, the codes that no other beats in both as a grey line."""
    shown = [row for row in rows if row.simulated > 0 and row.cpu_seconds > 0]
    conditions = list(dict.fromkeys(row.condition for row in shown)) or [""]
    figure = new_figure(2 * _WIDTH, _HEIGHT * len(conditions))
    panels = figure.subplots(len(conditions), 2, sharey=True, squeeze=False)
    factor, unit = length_unit(float(np.median([row.simulated for row in shown])) if shown else 1.0)
    marks, errors, places = None, [factor * row.simulated for row in shown], []
    if shown:  # the panels' common scale
        panels[0, 0].set(yscale="log", ylim=(min(errors) / 1.7, max(errors) * 1.7))
    for pair, condition in zip(panels, conditions, strict=True):
        mine = [row for row in shown if row.condition == condition]
        for panel, cost in zip(pair, _COSTS, strict=True):
            marks = _draw(panel, mine, cost, factor) or marks
            places.append((panel, [(row.code, getattr(row, cost), factor * row.simulated) for row in mine]))
            panel.set_xlabel(_COSTS[cost], fontsize=9)
        pair[0].set_ylabel(f"height error, rms [{unit}]", fontsize=9)
        lost = [row.code for row in rows if row.condition == condition and row not in mine]
        without = f"; no height: {', '.join(lost)}" if lost else ""
        pair[0].set_title(f"{condition}{without}", fontsize=9, loc="left")
    if marks is not None:
        bar = figure.colorbar(marks, ax=panels, ticks=np.log2(_RATIOS), aspect=20 * len(conditions))
        bar.ax.set_yticklabels([f"{ratio:g}" for ratio in _RATIOS])
        bar.set_label("error / sigma: 1 where error bars are true", fontsize=9)
    figure.suptitle(f"{title}; grey: nothing is both faster and better".lstrip("; "), fontsize=9)
    order = list(dict.fromkeys(row.code for row in shown))
    for panel, named in places:  # numbers, named once below
        for code, x, y in named:
            panel.annotate(str(order.index(code) + 1), (x, y), (5, 5), textcoords="offset points", fontsize=8)
    names = "\n".join(f"{k}  {code}" for k, code in enumerate(order, 1))
    figure.text(0.01, -0.01, names, fontsize=8, va="top")
    with atomic_file(path) as temporary:
        figure.savefig(temporary, format="png", bbox_inches="tight")


def front(cost: Floats, error: Floats) -> NDArray[np.intp]:
    """Indices (n,) of codes that are not beaten in both, in order of their cost."""
    order = np.lexsort((error, cost))
    least = np.minimum.accumulate(np.concatenate([[np.inf], error[order]]))[:-1]
    return np.asarray(order[error[order] < least])


def _draw(panel: Axes, rows: Many[Tradeoff], name: str, factor: float) -> Any:
    """One panel; its marks."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    panel.set(xscale="log", yscale="log")
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_major_locator(LogLocator(10, (1, 2, 5), numticks=9))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())
    panel.tick_params(labelsize=8)
    panel.grid(color="0.93")
    panel.spines[["top", "right"]].set_visible(False)
    if not rows:
        return None
    cost = np.array([getattr(row, name) for row in rows])
    error, spread = (factor * np.array([getattr(row, of) for row in rows]) for of in ("simulated", "spread"))
    best = front(cost, error)
    ends = [*cost[best], 1.4 * cost.max()], [*error[best], error[best][-1]]
    panel.step(*ends, where="post", color="0.75", lw=1.2, zorder=1)
    bars = np.stack([np.minimum(spread, 0.9 * error), spread])
    panel.errorbar(
        cost, error, np.nan_to_num(bars), fmt="none", ecolor="0.3", elinewidth=1, capsize=2, zorder=2
    )
    panel.set_xlim(cost.min() / 3, cost.max() * 4)
    ratio = np.log2([row.ratio if row.ratio > 0 else math.nan for row in rows])
    return panel.scatter(
        cost, error, c=ratio, cmap="coolwarm", vmin=-2, vmax=2, s=45, edgecolor="0.2", lw=0.8, zorder=3
    )
