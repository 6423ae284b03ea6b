"""The page of `optolever camera sync`: how the light follows the swaps; the prose is in report/sync.html."""

import math
from pathlib import Path

import numpy as np

from optolever.projector import FlipFit, FlipRecord, Timing, flip_fit, sync_notices
from optolever.quantities import quantity
from optolever.records import default_style

from .images import figure_uri, label_axes, new_figure
from .page import Table, write_page

__all__ = ["write_sync_report"]

_MOST, _AFTER_S = 4000, 0.1  # points of a picture; time after a swap


@default_style()
def write_sync_report(timing: Timing, taken: FlipRecord, seconds: float, path: str | Path) -> None:
    """Write the page of a synchronisation and the record that it was fitted to."""
    found, refresh, sigma = flip_fit(taken, timing), timing.refresh_s, timing.sigma_s or {}
    numbers = {
        "latency": timing.latency_s,
        "rise": timing.rise_s,
        "fall": timing.fall_s,
        "shutter": timing.shutter_s,
        "read-out": timing.read_out_s,
        "camera period": timing.period_s,
    }
    rows = [
        [name, quantity(1e3 * value, "ms", 1e3 * sigma.get(name, math.nan))]
        for name, value in numbers.items()
    ]
    recommended = timing.whole_refreshes(timing.exposure_s)
    context = {
        "timing": timing,
        "notices": sync_notices(timing),
        "wait_ms": 1e3 * timing.ready_s(),
        "exposure_ms": 1e3 * (timing.exposure_s if recommended is None else recommended),
        "refreshes": None if refresh is None else timing.exposure_s / refresh,
        "beat": None if refresh is None else _beat(timing.period_s, refresh),
        "numbers": Table("numbers", ("number", "value ± sigma"), rows),
        "latencies": _latency_figure(found, timing),
        "step": _step_figure(found),
        "rows": _row_figure(found, taken, timing),
        "images": len(taken.stamps_s),
        "swaps": len(taken.swaps_s) - 1,
    }
    write_page(path, "sync.html", {"synchronise": seconds}, context)


def _beat(period_s: float, refresh_s: float) -> float:
    """Hz, at which the camera's period drifts through the display's."""
    ratio = period_s / refresh_s
    return abs(ratio - round(ratio)) / period_s


def _latency_figure(found: FlipFit, timing: Timing) -> str:
    figure = new_figure(5.0, 2.6)
    axes = figure.subplots()
    axes.hist(1e3 * (timing.latency_s + found.lateness_s), bins=24, color="#4878a8")
    label_axes(axes, "latency of a swap [ms]", "swaps")
    return figure_uri(figure)


def _step_figure(found: FlipFit) -> str:
    figure = new_figure(8.0, 2.8)
    for axes, rising, name in zip(
        figure.subplots(1, 2), (True, False), ("to white", "to black"), strict=True
    ):
        some = np.flatnonzero((found.rising == rising).ravel() & (found.since_s.ravel() < _AFTER_S))
        some = some[:: max(1, len(some) // _MOST)]
        since = 1e3 * found.since_s.ravel()[some]
        axes.plot(since, found.light.ravel()[some], ".", color="#4878a8", markersize=3, label="measured")
        axes.plot(since, found.model.ravel()[some], ".", color="#c44e52", markersize=1.5, label="model")
        axes.legend(fontsize=8)
        label_axes(axes, "start of the exposure after the swap's light [ms]", "light", name)
    return figure_uri(figure)


def _row_figure(found: FlipFit, taken: FlipRecord, timing: Timing) -> str:
    figure = new_figure(5.0, 2.6)
    axes = figure.subplots()
    axes.plot(taken.bands, 1e3 * found.begins_s, "o", color="#4878a8", markersize=4, label="each band alone")
    axes.plot([0, 1], [0, 1e3 * timing.shutter_s], color="#c44e52", linewidth=1, label="model")
    axes.legend(fontsize=8)
    label_axes(axes, "row, 0 top to 1 bottom", "start of the exposure [ms]")
    return figure_uri(figure)
