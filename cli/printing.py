"""Output: tables on stdout, progress on stderr, JSON for programs."""

import math
import shutil
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

import optolever as ol
from optolever.errors import InputError
from optolever.quantities import length as length
from optolever.quantities import noise_and_rig as noise_and_rig
from optolever.quantities import number as number
from optolever.quantities import quantity as quantity
from optolever.quantities import two_digits

if TYPE_CHECKING:
    from enum import IntFlag

    import numpy as np
    from numpy.typing import NDArray

    from optolever.notices import Notice


def flag_shares(flags: "NDArray[np.unsignedinteger]", *kinds: "type[IntFlag]") -> dict[str, float]:
    """Share of all pixels with each flag, by its name; flags without pixels are omitted."""
    shares = {
        flag.name: float((flags & flag.value != 0).mean()) for kind in kinds for flag in kind if flag.name
    }
    return {name.lower(): share for name, share in shares.items() if share > 0}


def flag_rows(shares: Mapping[str, float]) -> dict[str, str]:
    """`flag_shares` for `table`."""
    return {name: number(100 * share, "%") for name, share in shares.items()}


def medians(good: "NDArray[np.bool_]", *maps: "NDArray[np.floating]") -> list[float]:
    """Median of every map (H, W) over the good pixels, NaN without any."""
    import numpy as np

    return [float(np.median(each[good])) if good.any() else math.nan for each in maps]


def height_range(height: "ol.reconstruct.HeightMap") -> tuple[float, float]:
    """Least and largest good height, mm; NaN without any."""
    z = height.z[height.good]
    return (float(z.min()), float(z.max())) if z.size else (math.nan, math.nan)


def coverage_text(mirror: float, good: float) -> str:
    """`coverage` in words.

    >>> coverage_text(0.576, 0.996)
    'the mirror fills 57.6 % of the image; 99.6 % of it decoded'
    """
    if mirror == 0:
        return "no pixel sees the patterns change"
    return f"the mirror fills {100 * mirror:.1f} % of the image; {100 * good:.1f} % of it decoded"


def contact_rows(
    contacts: "Sequence[Mapping[str, Any]]", layer: "ol.scene.Layer | None" = None, full: bool = False
) -> dict[str, str]:
    """Contacts (Contact.to_dict) for `table`: the first one's depth, place and force, or full: a row each;
    layer: of the scene."""
    found = [ol.reconstruct.Contact.from_dict(dict(one)) for one in contacts]
    if not found:
        return {}
    first, force = found[0], "unknown: the scene has no [layer] with youngs_modulus_mpa"
    if first.force is not None:
        force = "at least " * first.force_at_least + quantity(first.force, "N", first.force_sigma or math.nan)
        if layer is not None and layer.thickness_mm is None:
            force += " of a half-space: the scene's [layer] has no thickness_mm"
    if full:
        return {f"contact {count}": str(one) for count, one in enumerate(found, 1)} | {"force": force}
    depth = "at least " * first.depth_at_least + quantity(first.depth, "mm", first.depth_sigma)
    more = f"; {len(found) - 1} more: --verbose" if len(found) > 1 else ""
    return {"contact": f"depth {depth} at ({first.x:.4g}, {first.y:.4g}) mm{more}", "force": force}


def budget_rows(readings: "Mapping[str, Mapping[str, float]]") -> tuple[list[str], list[list[str]]]:
    """Header and rows for `grid` of an uncertainty budget (mm), in micrometres: a row per source."""
    names = list(dict.fromkeys(name for sources in readings.values() for name in sources))
    rows = [
        [name, *(two_digits(1e3 * sources[name]) if name in sources else "" for sources in readings.values())]
        for name in names
    ]
    return ["µm", *readings], rows


def print_notices(notices: "Iterable[Notice | str]") -> None:
    """Print each on stderr, one line, once."""
    import click

    for notice in dict.fromkeys(map(str, notices)):
        click.echo(f"Notice: {notice}", err=True)


def possible(files: Sequence[Path], work: Callable[[Path], None]) -> tuple[Path, ...]:
    """The files for which the work could be done; a notice names each other one. InputError if none
    could."""
    reasons = dict[Path, str]()
    for path in files:
        try:
            work(path)
        except InputError as error:
            reasons[path] = str(error) if str(path) in str(error) else f"{path}: {error}"
    if files and len(reasons) == len(files):
        raise InputError("; ".join(reasons.values()))
    print_notices(reasons.values())
    return tuple(path for path in files if path not in reasons)


def table(title: str, rows: Mapping[str, str]) -> None:
    """Print a title and name-value rows, values folded at the terminal's width."""
    indent = max(map(len, rows), default=0) + 4
    width = max(shutil.get_terminal_size().columns - indent, 20)
    lines = []
    for name, value in rows.items():
        parts = textwrap.wrap(value, width, break_on_hyphens=False) or [""]
        lines += [f"  {key:<{indent - 2}}{part}" for key, part in zip_longest([name], parts, fillvalue="")]
    _print(title, lines)


def grid(title: str, header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a title and rows under a header; nothing is folded."""
    cells = [header, *rows]
    widths = [max(map(len, column)) for column in zip_longest(*cells, fillvalue="")]
    padded = (map(str.ljust, row, widths) for row in cells)
    _print(title, ["  ".join(row) for row in padded])


def _print(title: str, lines: Iterable[str]) -> None:
    import click

    click.secho(title, bold=True)
    click.echo("\n".join(line.rstrip() for line in lines))


def write_json(path: Path | None, values: Mapping[str, Any]) -> None:
    """`optolever.files.write_json`, or as CSV where the suffix says so; no path, no file."""
    if path is not None:
        write = ol.files.write_csv if path.suffix.lower() == ".csv" else ol.files.write_json
        write(path, values)


class Step:
    """A progress bar of several stages: call it with the stage's name, its count and its total."""

    def __init__(self, bar: Any) -> None:
        self._bar = bar
        self._task = bar.add_task("", total=None)

    def __call__(self, text: str, done: int | None = None, total: int | None = None) -> None:
        self._bar.update(self._task, description=text, completed=done or 0, total=total)

    @contextmanager
    def aside(self) -> Iterator[None]:
        """Hide the bar while something is printed."""
        if self._bar.disable:
            yield
            return
        self._bar.stop()
        try:
            yield
        finally:
            self._bar.start()


@contextmanager
def progress() -> Iterator[Step]:
    """A progress bar on stderr, gone when the work is done; on a pipe nothing."""
    from rich import progress as rich
    from rich.console import Console

    console = Console(stderr=True)
    columns = rich.TextColumn("{task.description}"), rich.BarColumn(), rich.MofNCompleteColumn()
    times, hidden = (rich.TimeElapsedColumn(), rich.TimeRemainingColumn()), not console.is_terminal
    with rich.Progress(*columns, *times, console=console, transient=True, disable=hidden) as bar:
        yield Step(bar)
