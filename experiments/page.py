"""One self-contained HTML page from the templates in report/: style, script and pictures are inside."""

import importlib.metadata
import json
import math
import platform
import shlex
import sys
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from optolever import __version__
from optolever.files import atomic_file, report_folder
from optolever.quantities import length_unit

from .timing import peak_bytes

FOLDER = Path(__file__).parent / "report"
SCRIPTS = ("uplot.min.js", "viewer.js", "charts.js")
LIBRARIES = ("numpy", "scipy", "numba", "moderngl", "opencv-contrib-python-headless", "matplotlib")


def write_page(path: str | Path, template: str, seconds: dict[str, float], context: dict[str, Any]) -> None:
    """Write the page of a template in report/, atomically, into a folder that is created if absent. Its
    context gets the common entries of all pages: seconds of the stages, the program's command."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(FOLDER),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
    )
    filters: dict[str, Callable[[float], str]] = {
        "scientific": scientific,
        "mm": length_text,
        "percent": percent,
        "fixed": lambda value: f"{value:.3f}" if math.isfinite(value) else "–",
        "duration": seconds_text,
        "share": share_text,
    }
    environment.filters.update(filters)
    common = {
        "notices": (),
        "version": __version__,
        "versions": versions(),
        "style": Markup("".join((FOLDER / name).read_text() for name in ("uplot.min.css", "style.css"))),
        "scripts": Markup("".join((FOLDER / name).read_text() for name in SCRIPTS)),
        "stages": stage_bars(seconds),
        "memory_gib": peak_bytes() / 2**30,
        "command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
    }
    html = environment.get_template(template).render(common | context)
    with report_folder(Path(path).parent), atomic_file(path) as temporary:
        temporary.write_text(html, encoding="utf-8")


def embedded_json(value: Any) -> Markup:
    """JSON that can stand inside a script element."""
    return Markup(json.dumps(value, allow_nan=False).replace("<", "\\u003c"))


def budget_table(readings: Mapping[str, Mapping[str, float]]) -> dict[str, Any]:
    """An uncertainty budget (mm, see `reconstruct.budget`) as a table in micrometres, a row per source."""
    names = dict.fromkeys(name for sources in readings.values() for name in sources)
    known = readings.values()
    rows = [
        ("", [name, *(scientific(1e3 * each[name]) if name in each else "" for each in known)])
        for name in names
    ]
    return table("budget-table", ("standard deviation, um", *readings), rows)


def versions() -> list[tuple[str, str]]:
    """Versions for the page: this package, Python, the machine, and the main libraries."""
    rows = [
        ("optolever", __version__),
        ("Python", platform.python_version()),
        ("machine", f"{platform.machine()}, {platform.system()} {platform.release()}"),
    ]
    for library in LIBRARIES:
        try:
            rows.append((library, importlib.metadata.version(library)))
        except importlib.metadata.PackageNotFoundError:
            rows.append((library, "not installed"))
    return rows


def scientific(value: float) -> str:
    """A small number for reading: 3.2 × 10⁻⁵."""
    if not math.isfinite(value):
        return "–"
    if value == 0 or 1e-2 <= abs(value) < 999.5:
        return f"{value:.3g}"
    digits, _, power = f"{value:.1e}".partition("e")
    digits = digits.replace("-", "−")
    return f"{digits} × 10" + str(int(power)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def length_text(millimetres: float) -> str:
    """A length in the unit in which it reads well."""
    if not math.isfinite(millimetres):
        return "–"
    factor, unit = length_unit(millimetres)
    return f"{millimetres * factor:.3g} {unit}"


def percent(share: float) -> str:
    """A share in per cent."""
    if not math.isfinite(share):
        return "–"
    return f"{100 * share:.2f} %" if share >= 0.01 or share == 0 else f"{100 * share:.2g} %"


def share_text(share: float | None) -> str:
    """An error over the peak in per cent, three digits; nothing for None."""
    if share is None:
        return ""
    if share != 0 and abs(share) < 1e-5:
        return f"{scientific(100 * share)} %"
    return f"{100 * share:.3g} %".replace("-", "−") if math.isfinite(share) else "–"


def seconds_text(seconds: float) -> str:
    """A duration with as many digits as it deserves."""
    if seconds < 0.01:
        return f"{1e3 * seconds:.1f} ms"
    return f"{seconds:.2f} s" if seconds < 10 else f"{seconds:.1f} s"


def table(
    name: str, heads: Iterable[str], rows: Iterable[tuple[str, list[str]]], texts: int = 1
) -> dict[str, Any]:
    """Context of parts.html for a table of rows (kind, cells); texts: number of leading text columns."""
    columns = [{"name": head, "numeric": k >= texts} for k, head in enumerate(heads)]
    return {"id": name, "columns": columns, "rows": [{"kind": kind, "cells": cells} for kind, cells in rows]}


def stage_bars(seconds: dict[str, float]) -> list[dict[str, Any]]:
    """Rows of the timing chart, bars scaled to the longest stage; the total has none."""
    longest = max((value for name, value in seconds.items() if name != "total"), default=0.0) or 1.0
    return [
        {
            "name": name,
            "percent": 0 if name == "total" else round(100 * value / longest, 1),
            "text": seconds_text(value),
        }
        for name, value in seconds.items()
    ]
