"""The page of `optolever calibrate`: residuals of the captures, parameters, height errors by the rig's
errors; the prose is in report/rig.html.
"""

from __future__ import annotations

import math
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
from optolever.quantities import quantity, two_digits
from optolever.reconstruct import HeightMap
from optolever.samples import rms
from optolever.scene import Scene

from .maps import Data, Layer, length_layer, mirror_map
from .page import Figures, Table, budget_table, embedded_json, write_page
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


def write_rig_report(
    given: Scene,
    found: Calibration,
    judged: Mapping[str, Mapping[str, float | None]],
    path: str | Path,
) -> None:
    """Write the page of a calibration of a given rig. judged: capture -> its `calibration.Judgement`."""
    scene, rest = found.scene, sigma_at_rest(found.scene)
    heads, rows = judged_table(judged)
    drawing, bar = rig_drawing({"before": given, "after": scene})
    heights = _modes(rest)
    remarks = [(bool(each.cure or each.limit == each.limit), str(each)) for each in found.notices]
    context = {
        "name": scene.name,
        "day": "" if scene.covariance is None else scene.covariance.date,
        "chi": found.adjustment.chi,
        "sigma": float(np.nanmedian(rest.calibration_sigma)),
        "remarks": sorted(remarks, key=lambda each: not each[0]),
        "captures": [(name, rms(np.concatenate(parts[2:]))) for name, parts in found.residuals.items()],
        "judged": Table("judged-table", heads, rows, kinds=[
            "beyond" if (each.get("chi") or 0.0) > MOST_CHI else "" for each in judged.values()]),
        "limits": {"chi": MOST_CHI, "off": MOST_OFF, "gain": LEAST_GAIN},
        "numbers": _parameter_table(found.parameters),
        "correlations": _correlations(scene),
        "drawing": drawing,
        "bar": bar,
        "maps": embedded_json({"heights": heights} | {
            f"capture-{k}": _residuals(*parts) for k, parts in enumerate(found.residuals.values(), 1)}),
        "layers": [each["name"] for each in heights["layers"]],
        "budget": budget_table(predicted_budget(scene), Figures()),
        "depth": scene.mirror.length * PREDICTED_DEPTH,
        "noise": PREDICTED_NOISE,
    }  # fmt: skip
    write_page(path, "rig.html", context)


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
        rows.append([each["name"], *cells, f"{off:.2f}", two_digits(gain)])
        kinds.append("beyond" if off > MOST_OFF else "soft" if gain < LEAST_GAIN else "")
    return Table("numbers-table", heads, rows, kinds=kinds)


def _residuals(row: Floats, col: Floats, u: Floats, v: Floats) -> Data:
    """Map of a capture's residuals (n,) at its pixels (n,)."""
    side = math.ceil(math.sqrt(row.size))
    square = np.full((4, side * side), np.nan)
    square[:, : row.size] = row, col, u, v
    rows, cols, *parts = square.reshape(4, side, side)
    layers = [
        Layer(name, part, "sigma", "RdBu_r", True, digits=3) for name, part in zip("uv", parts, strict=True)
    ]
    axes = {"x": "camera column [px]", "y": "camera row [px]", "down": True, "cols": 0}
    return mirror_map(cols, rows, layers) | axes


def _correlations(scene: Scene) -> Table:
    assert scene.covariance is not None
    names, matrix = scene.covariance.names, scene.covariance.matrix
    scale = np.sqrt(np.diag(matrix))
    shares = np.rint(100 * matrix / np.outer(scale, scale)).astype(int).tolist()
    rows = [[name, *map(str, row)] for name, row in zip(names, shares, strict=True)]
    return Table("correlations", ("per cent", *names), rows)


def _modes(rest: HeightMap) -> Data:
    """Map of the height's sigma by the rig and of its two largest independent modes."""
    assert rest.calibration is not None
    _, sizes, right = np.linalg.svd(np.nan_to_num(rest.calibration.reshape(len(rest.calibration), -1)), False)
    known, layers = np.isfinite(rest.z), [length_layer("sigma", rest.calibration_sigma, "cividis", digits=3)]
    for k, (size, mode) in enumerate(zip(sizes[:2], right[:2], strict=True)):
        if size > 1e-6 * sizes[0]:
            values = np.where(known, (size * mode).reshape(known.shape), np.nan)
            layers.append(length_layer(f"mode {k + 1}", values, "RdBu_r", True, digits=3))
    return mirror_map(np.where(known, rest.x, np.nan), rest.y, layers)
