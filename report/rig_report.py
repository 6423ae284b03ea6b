"""The page of `optolever calibrate`: residuals of the captures, parameters, height errors by the rig's
errors; the prose is in report/rig.html.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from optolever.arrays import Floats
from optolever.calibration import (
    PREDICTED_DEPTH,
    PREDICTED_NOISE,
    Calibration,
    predicted_budget,
    sigma_at_rest,
)
from optolever.images import figure_uri, label_axes, new_figure, robust_limits
from optolever.quantities import length_unit, quantity
from optolever.reconstruct import HeightMap
from optolever.records import default_style
from optolever.samples import rms
from optolever.scene import Scene

from .page import Figures, Table, budget_table, write_page
from .rig_drawing import rig_drawing

#: Red on the page: chi above the first; a parameter farther from its prior, in prior sigma, than the second.
#: Grey: a parameter whose sigma is not LEAST_GAIN times below its prior's.
MOST_CHI, MOST_OFF, LEAST_GAIN = 1.2, 5.0, 2.0
#: Fields of `calibration.Judgement`: heading, and the factor to its unit.
_JUDGED = {
    "chi": ("chi", 1.0),
    "left_out": ("chi left out", 1.0),
    "seen": ("seen, %", 1e2),
    "decoded": ("decoded, %", 1e2),
    "tilt_deg": ("tilt, degrees", 1.0),
    "height_so_far_mm": ("height so far, µm", 1e3),
    "height_without_mm": ("without it", 1e3),
    "depth_so_far_mm": ("depth so far, µm", 1e3),
    "depth_without_mm": ("without it", 1e3),
}


@default_style()
def write_rig_report(
    given: Scene,
    found: Calibration,
    judged: Mapping[str, Mapping[str, float | None]],
    seconds: dict[str, float],
    path: str | Path,
) -> None:
    """Write the page of a calibration of a given rig. judged: capture -> its `calibration.Judgement`; seconds
    per stage."""
    scene, rest = found.scene, sigma_at_rest(found.scene)
    heads, rows = judged_table(judged)
    drawing, bar = rig_drawing({"before": given, "after": scene})
    remarks = [(bool(each.cure or each.limit == each.limit), str(each)) for each in found.notices]
    context = {
        "name": scene.name,
        "day": "" if scene.covariance is None else scene.covariance.date,
        "chi": found.adjustment.chi,
        "sigma": float(np.nanmedian(rest.calibration_sigma)),
        "remarks": sorted(remarks, key=lambda each: not each[0]),
        "captures": [(name, rms(np.concatenate(parts[2:])), _residual_figure(parts))
                     for name, parts in found.residuals.items()],
        "judged": Table("judged-table", heads, rows, kinds=[
            "beyond" if (each.get("chi") or 0.0) > MOST_CHI else "" for each in judged.values()]),
        "limits": {"chi": MOST_CHI, "off": MOST_OFF, "gain": LEAST_GAIN},
        "numbers": _parameter_table(found.parameters),
        "correlations": _correlation_figure(scene),
        "drawing": drawing,
        "bar": bar,
        "heights": _sigma_figure(rest),
        "budget": budget_table(predicted_budget(scene), Figures()),
        "depth": scene.mirror.length * PREDICTED_DEPTH,
        "noise": PREDICTED_NOISE,
    }  # fmt: skip
    write_page(path, "rig.html", seconds, context)


def judged_table(judged: Mapping[str, Mapping[str, float | None]]) -> tuple[list[str], list[list[str]]]:
    """Header and a row per capture, with the available fields of its judgement."""
    some = [key for key in _JUDGED if any(key in each for each in judged.values())]
    rows = []
    for name, each in judged.items():
        known = [(each.get(key), _JUDGED[key][1]) for key in some]
        rows.append([name, *("" if value is None else f"{factor * value:.4g}" for value, factor in known)])
    return ["capture", *(_JUDGED[key][0] for key in some)], rows


def _parameter_table(parameters: Sequence[Mapping[str, Any]]) -> Table:
    heads = ("parameter", "value ± sigma", "prior ± sigma", "off by", "prior sigma over sigma")
    rows, kinds = [], []
    for each in parameters:
        gain = each["prior_sigma"] / each["sigma"]
        off = abs(each["value"] - each["prior"]) / each["prior_sigma"]
        pairs = ("value", "sigma"), ("prior", "prior_sigma")
        cells = [quantity(each[value], "", each[sigma]) for value, sigma in pairs]
        rows.append([each["name"], *cells, f"{off:.2f}", f"{gain:.2g}"])
        kinds.append("beyond" if off > MOST_OFF else "soft" if gain < LEAST_GAIN else "")
    return Table("numbers-table", heads, rows, kinds=kinds)


def _residual_figure(found: tuple[Floats, Floats, Floats, Floats]) -> str:
    row, col, *parts = found
    figure = new_figure(8.0, 2.6)
    for axes, values, name in zip(figure.subplots(1, 2), parts, ("u", "v"), strict=True):
        _draw_points(axes, (col, row), values, f"{name}: predicted less measured", "sigma")
        axes.invert_yaxis()
    return figure_uri(figure)


def _draw_points(
    axes: Any, at: tuple[Floats, Floats], values: Floats, title: str, unit: str, x: str = ""
) -> None:
    """Values at their positions; a diverging colour map for signed values."""
    signed = bool(np.nanmin(values, initial=0.0) < 0)
    low, high = robust_limits(values, symmetric=signed)
    colours = "RdBu_r" if signed else "viridis"
    drawn = axes.scatter(*at, c=values, s=6, cmap=colours, vmin=low, vmax=high, marker="s")
    axes.set_aspect("equal")
    label_axes(axes, x, title=title, frame=True)
    axes.figure.colorbar(drawn, ax=axes, label=unit)


def _correlation_figure(scene: Scene) -> str:
    assert scene.covariance is not None
    matrix = scene.covariance.matrix
    scale = np.sqrt(np.diag(matrix))
    size = 2.0 + 0.24 * len(scale)
    figure = new_figure(size + 1.0, size)
    axes = figure.subplots()
    drawn = axes.imshow(matrix / np.outer(scale, scale), cmap="RdBu_r", vmin=-1, vmax=1)
    ticks = range(len(scale))
    axes.set_xticks(ticks, scene.covariance.names, rotation=90, fontsize=7)
    axes.set_yticks(ticks, scene.covariance.names, fontsize=7)
    figure.colorbar(drawn, ax=axes, label="correlation")
    return figure_uri(figure)


def _sigma_figure(rest: HeightMap) -> str:
    assert rest.calibration is not None
    _, sizes, right = np.linalg.svd(np.nan_to_num(rest.calibration.reshape(len(rest.calibration), -1)), False)
    known = np.isfinite(rest.z)
    factor, unit = length_unit(float(np.nanmax(rest.calibration_sigma)))
    maps = {"sigma of the height": rest.calibration_sigma}
    for k, (size, mode) in enumerate(zip(sizes[:2], right[:2], strict=True)):
        if size > 1e-6 * sizes[0]:
            maps[f"mode {k + 1}"] = (size * mode).reshape(known.shape)
    figure = new_figure(10.0, 2.8)
    for axes, (name, values) in zip(
        figure.subplots(1, len(maps), squeeze=False)[0], maps.items(), strict=True
    ):
        _draw_points(axes, (rest.x, rest.y), np.where(known, factor * values, np.nan), name, unit, "x [mm]")
    return figure_uri(figure)
