"""The report of `optolever paper`: tables and figures; the prose is in report/paper.html."""

import time
from pathlib import Path
from typing import Any

from .page import share_text, table, write_page
from .paper import PaperStudy
from .paper_figures import comparison_figure, series_figure, shape_figure
from .paper_rows import PaperRow, curve_name

__all__ = ["write_paper_report"]

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


def write_paper_report(study: PaperStudy, path: str | Path) -> PaperStudy:
    """Write the page and return the study with the time that this took."""
    start = time.perf_counter()
    cases = [_case(study, name) for name in study.curves]
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
    """What the template needs of one case: its rows by their role, its table, its figures."""

    def row(data: str, law: str, method: str, sign: int | None, gamma: bool | None) -> PaperRow:
        return study.find(case=name, data=data, law=law, method=method, sign=sign, gamma=gamma)

    curves, taken = study.curves[name], study.settings["cases"][name]
    rendered = any(r.case == name and r.data == "frames" for r in study.rows)
    fine = curves[curve_name("exact", "reflection", "pixels", 1, True)]
    figures = {
        "shape": shape_figure(fine),
        "seed": series_figure(curves[curve_name("exact", "print", "lattice", -1, True)], fine),
        "true": series_figure(curves[curve_name("exact", "reflection", "lattice", 1, True)], fine),
        "comparison": comparison_figure(curves, taken["peak_mm"]),
    }
    if rendered:
        crossings = curves[curve_name("frames", "reflection", "lattice", 1, True)]
        figures["frames"] = series_figure(crossings, fine)
    return {
        "id": name,
        "title": TITLES[name],
        "taken": taken,
        "seed": row("exact", "print", "lattice", -1, True),
        "printed": row("exact", "reflection", "lattice", 1, False),
        "true": row("exact", "reflection", "lattice", 1, True),
        "wrong": row("exact", "reflection", "lattice", -1, True),
        "pixels": row("exact", "reflection", "pixels", 1, True),
        "rendered": rendered,
        "dense": row("exact", "reflection", "dense", None, None) if rendered else None,
        "lattice_frames": row("frames", "reflection", "lattice", 1, True) if rendered else None,
        "pixel_frames": row("frames", "reflection", "pixels", 1, True) if rendered else None,
        "dense_frames": row("frames", "reflection", "dense", None, None) if rendered else None,
        "table": _table(study, name),
        "figures": figures,
    }


def _table(study: PaperStudy, name: str) -> dict[str, Any]:
    """All rows of a case, grouped by how they were seen."""
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
