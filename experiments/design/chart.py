"""The chart of error against CPU time and acquisition time: a mark per code, panels per condition."""

from __future__ import annotations

import math
from collections.abc import Sequence as Many
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from optolever.files import atomic_file
from optolever.quantities import length_unit
from optolever.records import default_style

from ..arrays import Floats
from ..images import new_figure
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
_FREE = 8  # names that a panel of that height has room for
_GAP, _GRID = 6, 3  # pixels between a mark and its name, between places that are tried
_NEAR = 12.0  # pixels beyond which a line leads from a mark to its name


@default_style()
def write_tradeoff_chart(path: Path, rows: Many[Tradeoff], title: str = "") -> None:
    """Write a PNG: height error over both times, its standard deviation over the seeds as a bar, error over
    sigma as the colour, the codes that no other beats in both as a grey line."""
    shown = [row for row in rows if row.simulated > 0 and row.cpu_seconds > 0]
    conditions = list(dict.fromkeys(row.condition for row in shown)) or [""]
    names = max([sum(row.condition == each for row in shown) for each in conditions])
    height = _HEIGHT * max(1.0, names / _FREE) ** 0.5
    figure = new_figure(2 * _WIDTH, height * len(conditions))
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
    figure.draw_without_rendering()  # the layout that names are placed in
    figure.set_layout_engine("none")
    for panel, named in places:
        _name(panel, named)
    with atomic_file(path) as temporary:
        figure.savefig(temporary, format="png")


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


def _name(panel: Axes, named: Many[tuple[str, float, float]]) -> None:
    """Names of marks at (x, y), each at the nearest place that overlaps no mark, no other name and no
    border of the panel."""
    area = panel.get_window_extent()
    at = panel.transData.transform([(x, y) for _, x, y in named]) if named else np.zeros((0, 2))
    taken = [np.array([x - _GAP, y - _GAP, x + _GAP, y + _GAP]) for x, y in at]
    for (text, *mark), (x, y) in zip(named, at, strict=True):
        label = panel.annotate(text, (mark[0], mark[1]), xytext=(0, 0), textcoords="offset pixels",
                               fontsize=8, color="0.15", va="bottom")  # fmt: skip
        size = label.get_window_extent()
        left, low = np.meshgrid(
            np.arange(area.x0, max(area.x1 - size.width, area.x0 + 1), _GRID),
            np.arange(area.y0, max(area.y1 - size.height, area.y0 + 1), _GRID),
        )
        boxes = np.stack([left, low, left + size.width, low + size.height], axis=-1)
        away = np.hypot(*(np.maximum(np.maximum(boxes[..., k] - p, p - boxes[..., k + 2]), 0.0)
                          for k, p in enumerate((x, y))))  # fmt: skip
        # of equally near places: right of the mark, above the grey line through it
        cost = np.maximum(away, _GAP + _GRID) + 0.02 * (np.abs(low - y - 2) + np.maximum(x - left, 0.0))
        best = np.unravel_index(
            np.argmin(cost + 1e3 * sum(_shared(boxes, each) for each in taken)), low.shape
        )
        label.set_position((left[best] - x, low[best] - y))
        taken.append(boxes[best] + (-3, -1, 3, 1))
        if away[best] > _NEAR:
            ends = np.clip((x, y), boxes[best][:2], boxes[best][2:])
            panel.annotate("", (mark[0], mark[1]), xytext=ends - (x, y), textcoords="offset pixels",
                           arrowprops={"arrowstyle": "-", "color": "0.6", "lw": 0.7})  # fmt: skip


def _shared(boxes: Floats, other: Floats) -> Floats:
    """Area (...) that boxes (..., 4) of left, low, right, high share with another."""
    wide, tall = (
        np.minimum(boxes[..., k + 2], other[k + 2]) - np.maximum(boxes[..., k], other[k]) for k in (0, 1)
    )
    return np.asarray(np.maximum(wide, 0.0) * np.maximum(tall, 0.0))
