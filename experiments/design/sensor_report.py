"""The page of `optolever sensor`: maps, numbers, sweeps; the prose is in report/sensor.html."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from optolever.quantities import length_unit

from ..arrays import Floats
from ..images import MirrorGrid, Panel, figure_uri, label_axes, mirror_figure, new_figure
from ..page import scientific, table, write_page
from .sensor_maps import SensorMaps

#: Numbers of a sweep's table: key, heading.
COLUMNS = (
    ("value", ""),
    ("visible_share", "sees"),
    ("slope_low_deg", "slope from"),
    ("slope_high_deg", "to, °"),
    ("reflection_margin_deg", "total up to, °"),
    ("lever_cells_per_mrad", "cells / mrad"),
    ("fold_radius_mm", "folds below, mm"),
    ("sigma_mm", "sigma, mm"),
    ("sigma_rms_mm", "rms, mm"),
)


@dataclass(frozen=True)
class SensorStudy:
    """Maps of a scene, rows of its sweeps (see sweep_sensor), settings, seconds."""

    maps: SensorMaps
    sweeps: list[dict[str, float | str]]
    settings: dict[str, Any]
    seconds: dict[str, float]

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "numbers": self.maps.numbers(),
            "sweeps": self.sweeps,
            "settings": self.settings,
            "seconds": self.seconds,
        }


def write_sensor_report(study: SensorStudy, path: str | Path) -> None:
    """Write the page."""
    maps = study.maps
    names = list(dict.fromkeys(str(row["sweep"]) for row in study.sweeps))
    context = {
        "asked": study.settings,
        "n": maps.numbers(),
        "medium": maps.scene.medium is not None,
        "pictures": _pictures(maps),
        "sweeps": [
            {"name": name, "table": _table(name, study.sweeps), "figure": _curve(name, study.sweeps)}
            for name in names
        ],
    }
    write_page(path, "sensor.html", study.seconds, context)


def sensor_rows(rows: list[dict[str, float | str]]) -> list[list[str]]:
    """The cells of a sweep's table, in the order of COLUMNS; a row without numbers says why."""
    cells = []
    for row in rows:
        known = [row[key] for key, _ in COLUMNS if key in row]
        texts = [scientific(value) if isinstance(value, float) else str(value) for value in known]
        if "why" in row:
            texts = [f"{row['value']:g}", str(row["why"])]
        cells.append(texts + [""] * (len(COLUMNS) - len(texts)))
    return cells


def _table(name: str, rows: list[dict[str, float | str]]) -> dict[str, Any]:
    mine = [row for row in rows if row["sweep"] == name]
    lines = (("", cells) for cells in sensor_rows(mine))
    return table(f"table-{name}", (heading or name for _, heading in COLUMNS), lines, texts=0)


def _pictures(maps: SensorMaps) -> dict[str, str]:
    grid = MirrorGrid.around(maps.x, maps.y)

    def panel(values: Floats, title: str, label: str, colours: str = "viridis") -> Panel:
        # rounded, so that constant values are drawn as constant
        size = float(np.nanmax(np.abs(values))) or 1.0
        return Panel(grid.place(np.round(values / size, 9) * size), title, label, colours)

    factor, unit = length_unit(float(np.nanmedian(maps.sigma)))
    degrees = np.degrees
    groups = {
        "slopes": [
            panel(degrees(maps.low), "Least slope along x", "degrees"),
            panel(degrees(maps.high), "Greatest slope along x", "degrees"),
            panel(degrees(maps.low_y), "Least slope along y", "degrees"),
            panel(degrees(maps.high_y), "Greatest slope along y", "degrees"),
        ],
        "lever": [
            panel(maps.path, "Path from mirror to pattern", "mm", "cividis"),
            panel(maps.lever, "Movement of the image", "cells per mrad", "cividis"),
            panel(maps.free_mode, "Free mode", "share of its largest", "cividis"),
            panel(1 / maps.fold, "Radius below which the image folds", "mm", "cividis"),
        ],
        "sigma": [panel(maps.sigma * factor, "Sigma of the height", unit, "magma")],
    }
    if maps.scene.medium is not None:
        groups["reflection"] = [
            panel(degrees(maps.reflection_margin), "Total reflection up to", "degrees", "RdBu"),
            panel(maps.reflectance, "Reflectance at rest", "share"),
        ]
    return {name: mirror_figure(panels, grid) for name, panels in groups.items()}


def _curve(name: str, rows: list[dict[str, float | str]]) -> str:
    """Sigma and slope range over the value of a sweep."""
    mine = [row for row in rows if row["sweep"] == name and "why" not in row]
    figure = new_figure(8.0, 2.8)
    left, right = figure.subplots(1, 2)
    values = [float(row["value"]) for row in mine]
    left.plot(values, [float(row["sigma_mm"]) for row in mine], "o-", label="median")
    left.plot(values, [float(row["sigma_rms_mm"]) for row in mine], "s--", label="rms")
    if any(float(row["sigma_mm"]) > 0 for row in mine):
        left.set_yscale("log")
    label_axes(left, name, "sigma of the height [mm]")
    for key, label in (("slope_low_deg", "least"), ("slope_high_deg", "greatest"),
                       ("reflection_margin_deg", "total reflection")):  # fmt: skip
        shown = [float(row[key]) for row in mine]
        if any(math.isfinite(value) for value in shown):
            right.plot(values, shown, "o-", label=label)
    label_axes(right, name, "slope along x [degrees]")
    for axes in (left, right):
        if axes.has_data():
            axes.legend(fontsize=8)
    return figure_uri(figure)
