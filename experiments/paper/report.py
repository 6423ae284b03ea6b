"""The report of `optolever paper`: tables, the seed's figures 5 to 14 and 20 redrawn, all methods compared;
the prose is in report/paper.html.
"""

import time
from pathlib import Path
from typing import Any

import numpy as np

from optolever.quantities import length_unit

from ..images import figure_uri, label_axes, new_figure
from ..page import share_text, table, write_page
from .line import Curve, PaperRow
from .study import PaperStudy

Key = tuple[str, str, str, int | None, bool | None]

TITLES = {
    "smooth": "Smooth dent",
    "needle": "Needle-shaped dent",
    "tent": "Needle read as a wedge",
    "pencil": "Pencil tip, the paper's experiment",
}
METHODS = {"lattice": "lattice points", "pixels": "every pixel", "dense": "dense solver"}
GROUPS = (
    ("exact", "print", "Exact, light obeys the printed sign (the paper's own simulation)"),
    ("exact", "reflection", "Exact, light obeys the reflection law"),
    ("frames", "reflection", "Rendered 8-bit frames with noise, light obeys the reflection law"),
)

#: Rows cited in the prose: data, law, method, sign, gamma.
ROLES: dict[str, Key] = {
    "seed": ("exact", "print", "lattice", -1, True),
    "printed": ("exact", "reflection", "lattice", 1, False),
    "true": ("exact", "reflection", "lattice", 1, True),
    "wrong": ("exact", "reflection", "lattice", -1, True),
    "pixels": ("exact", "reflection", "pixels", 1, True),
    "dense": ("exact", "reflection", "dense", None, None),
    "lattice_frames": ("frames", "reflection", "lattice", 1, True),
    "pixel_frames": ("frames", "reflection", "pixels", 1, True),
    "dense_frames": ("frames", "reflection", "dense", None, None),
}
STYLES = {"rises": ("#2563a8", "_"), "drops": ("#b3402e", "^"), "mean": ("#1f7a4d", "o")}  # the seed's signs
DRAWN = (
    ("paper, lattice, mean", ("lattice", 1, True), "mean", "#b3402e"),
    ("paper, lattice, drops", ("lattice", 1, True), "drops", "#e0a030"),
    ("paper, every pixel, mean", ("pixels", 1, True), "mean", "#8a5fb0"),
    ("paper, every pixel, drops", ("pixels", 1, True), "drops", "#3b7dc4"),
    ("dense solver", ("dense", None, None), "mean", "#1f7a4d"),
)
FLOOR = 1e-13  # of the peak: smaller errors are drawn at this value


def write_paper_report(study: PaperStudy, path: str | Path) -> PaperStudy:
    """Write the page and return the study with the time of the report."""
    start = time.perf_counter()
    cases = [_case(study, name) for name in study.settings["cases"]]
    seconds = study.with_report(time.perf_counter() - start).seconds
    context = {
        "asked": study.settings,
        "cases": cases,
        "notices": study.notices,
        "by_name": {case["id"]: case for case in cases},
    }
    write_page(path, "paper.html", seconds, context)
    return study.with_report(time.perf_counter() - start)


def _case(study: PaperStudy, name: str) -> dict[str, Any]:
    """Context of the template for one case: its rows by role, its table, its figures."""
    own = {(r.data, r.law, r.method, r.sign, r.gamma): r for r in study.rows if r.case == name}
    roles = {role: own[key] for role, key in ROLES.items() if key in own}
    taken, fine = study.settings["cases"][name], roles["pixels"].curve
    figures = {"shape": _shape_figure(fine), "comparison": _comparison_figure(own, taken["peak_mm"])}
    for figure, role in (("seed", "seed"), ("true", "true"), ("frames", "lattice_frames")):
        if role in roles:
            figures[figure] = _series_figure(roles[role].curve, fine)
    return {
        "id": name,
        "title": TITLES[name],
        "taken": taken,
        "rendered": "dense" in roles,
        "table": _table(study, name),
        "figures": figures,
        **dict.fromkeys(ROLES),
        **roles,
    }


def _table(study: PaperStudy, name: str) -> dict[str, Any]:
    """All rows of a case, grouped by data and law."""
    heads = ("method", "sign", "gamma", "points", "drops", "rises", "mean", "largest", "at the peak")
    lines: list[tuple[str, list[str]]] = []
    for data, law, title in GROUPS:
        found = [row for row in study.rows if (row.case, row.data, row.law) == (name, data, law)]
        if found:
            lines.append(("group", [title]))
        lines += [("best" if row.method == "dense" else "", _cells(row)) for row in found]
    return table(f"table-{name}", (*heads, "θ [mrad]", "whole field"), lines, texts=3)


def _cells(row: PaperRow) -> list[str]:
    sign = "" if row.sign is None else "reflection" if row.sign == 1 else "printed"
    gamma = "" if row.gamma is None else "kept" if row.gamma else "set to 0"
    shares = (row.drops, row.rises, row.mean, row.largest, row.peak)
    return [
        METHODS[row.method],
        sign,
        gamma,
        str(row.points),
        *(share_text(share) for share in shares),
        f"{1e3 * row.theta:.3g}",
        share_text(row.field),
    ]


def _shape_figure(curve: Curve) -> str:
    """The mirror's cut, true depth over place (the seed's figures 5 and 10)."""
    figure = new_figure(10.0, 2.0)
    axes = figure.subplots()
    axes.plot(curve["l"], curve["d"], color="#1b2430", lw=1.6)
    axes.invert_yaxis()
    label_axes(axes, "l [mm]", "d [mm]", "the dent, into the prism downwards")
    return figure_uri(figure)


def _series_figure(curve: Curve, fine: Curve) -> str:
    """Theta, depth and their errors by rises, drops and mean, as the seed draws them (6 to 9, 11 to 14).

    `fine` holds the true curve.
    """
    figure = new_figure(10.0, 6.0)
    grid = figure.subplots(2, 2)
    error = curve["mean d"] - curve["d"]
    factor, unit = length_unit(float(np.nanmax(np.abs(error), initial=0.0)) / 2)
    panels = (
        (grid[0, 0], "theta", 1e3, "theta [mrad]", False),
        (grid[0, 1], "d", 1.0, "d [mm]", False),
        (grid[1, 0], "theta", 1e3, "error of theta [mrad]", True),
        (grid[1, 1], "d", factor, f"error of d [{unit}]", True),
    )
    for axes, name, scale, label, against in panels:
        truth = curve[name]
        if not against:
            axes.plot(fine["l"], fine[name] * scale, color="#1b2430", lw=1.2, label="true")
        for series, (colour, marker) in STYLES.items():
            values = (curve[f"{series} {name}"] - (truth if against else 0)) * scale
            axes.plot(
                curve["l"], values, marker, color=colour, ms=4.5, mfc="none", mew=1, ls="none", label=series
            )
        if against:
            axes.axhline(0, color="#5a6675", lw=0.6)
        label_axes(axes, "l [mm]", label, "")
    grid[0, 1].legend(fontsize=8, frameon=False)
    return figure_uri(figure)


def _comparison_figure(rows: dict[Key, PaperRow], peak: float) -> str:
    """Absolute depth error over the peak, of every method, from exact data and from rendered frames."""
    figure = new_figure(10.0, 3.8)
    titles = {"exact": "from exact correspondences", "frames": "from rendered, noisy 8-bit frames"}
    seen = [data for data in titles if any(key[0] == data for key in rows)]
    for axes, data in zip(figure.subplots(1, len(seen), sharey=True, squeeze=False)[0], seen, strict=True):
        for label, (method, sign, gamma), series, colour in DRAWN:
            key = data, "reflection", method, sign, gamma
            if key not in rows:
                continue
            curve = rows[key].curve
            error = np.maximum(np.abs(curve[f"{series} d"] - curve["d"]) / peak, FLOOR)
            marker = "o" if method == "lattice" else ""
            axes.semilogy(curve["l"], error, color=colour, lw=1, marker=marker, ms=2.5, label=label)
        axes.axhline(0.01, color="#5a6675", lw=0.8, ls=":")
        label_axes(axes, "l [mm]", "|error of d| / peak" if data == "exact" else "", titles[data])
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=8, frameon=False, loc="outside upper center", ncols=5)
    return figure_uri(figure)
