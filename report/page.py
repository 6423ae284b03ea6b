"""One self-contained HTML page from the templates in page/, its tables, and its numbers as text and in a
file.
"""

import importlib.metadata
import json
import math
import platform
import shlex
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from markupsafe import Markup

from optolever import __version__
from optolever.charts import chart_file
from optolever.files import atomic_file, write_rows
from optolever.quantities import by_parts, quantity, two_digits

__all__ = ["Figures", "Table", "budget_table", "embedded_json", "write_page"]

FOLDER = Path(__file__).parent / "page"
SCRIPTS = ("viewer.js", "charts.js")
LIBRARIES = ("numpy", "scipy", "numba", "moderngl", "opencv-contrib-python-headless", "matplotlib")


@dataclass(frozen=True, slots=True)
class Table:
    """A table of a page: its id, heads, rows of cells, number of leading columns of text, CSS class of each
    row."""

    id: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    texts: int = 1
    kinds: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class Figures:
    """Numbers by name: value, standard deviation (NaN: none) and unit, in the order in which a page shows
    them."""

    rows: dict[str, tuple[float, float, str]] = field(default_factory=dict)

    def show(self, name: str, value: float, unit: str = "", *sigma: float) -> Markup:
        """The number as an element of the page; the file gets it by this name. sigma: standard deviation, or
        those by noise and by the rig, which add in square."""
        self.rows[name] = float(value), math.hypot(*sigma) if sigma else math.nan, unit
        text = by_parts((value, *sigma), unit) if len(sigma) == 2 else quantity(value, unit, *sigma)
        return Markup('<span class="figure" data-figure="{}">{}</span>').format(name, text)

    def save(self, path: str | Path) -> None:
        """Write a CSV: name, value, sigma, unit; sigma empty where there is none; shares from 0 to 1."""
        rows = (
            (name, repr(value), "" if math.isnan(sigma) else repr(sigma), unit.strip("%"))
            for name, (value, sigma, unit) in self.rows.items()
        )
        write_rows(path, ("name", "value", "sigma", "unit"), rows)


def budget_table(readings: Mapping[str, Mapping[str, float]], figures: Figures) -> Table:
    """An uncertainty budget (mm, see `reconstruct.budget`), a row per source."""
    rows = [
        [name, *(figures.show(f"{reading}: {name}", each[name], "mm") if name in each else ""
                 for reading, each in readings.items())]
        for name in dict.fromkeys(name for sources in readings.values() for name in sources)
    ]  # fmt: skip
    return Table("budget-table", ("standard deviation", *readings), rows)


def write_page(path: str | Path, template: str, context: dict[str, Any]) -> None:
    """Write the page of a template in page/, atomically, into a folder that is created if absent. Its
    context gets the common entries of all pages, such as the program's command."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(FOLDER),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
    )
    environment.filters["quantity"] = quantity
    environment.filters["figures"] = two_digits
    common = {
        "notices": (),
        "version": __version__,
        "versions": _versions(),
        "style": _text(chart_file("uplot.min.css"), FOLDER / "style.css"),
        "scripts": _text(chart_file("uplot.min.js"), *(FOLDER / name for name in SCRIPTS)),
        "command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
    }
    html = environment.get_template(template).render(common | context)
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(path) as temporary:
        temporary.write_text(html, encoding="utf-8")


def embedded_json(value: Any) -> Markup:
    """JSON that can stand inside a script element."""
    return Markup(json.dumps(value, allow_nan=False).replace("<", "\\u003c"))


def _text(*paths: Path) -> Markup:
    return Markup("".join(path.read_text() for path in paths))


def _versions() -> Iterable[tuple[str, str]]:
    """Versions of this package, Python, the machine, and the main libraries."""
    yield "optolever", __version__
    yield "Python", platform.python_version()
    yield "machine", f"{platform.machine()}, {platform.system()} {platform.release()}"
    for library in LIBRARIES:
        try:
            yield library, importlib.metadata.version(library)
        except importlib.metadata.PackageNotFoundError:
            yield library, "not installed"
