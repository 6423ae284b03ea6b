"""docs/benchmarks.md: the page of figures and its chart, measured here and now."""

import os
import platform
import subprocess
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping
from datetime import datetime
from pathlib import Path

from optolever.blocks import ONE_THREAD
from optolever.cli.printing import number
from optolever.design import LEAST_SHARE, Tradeoff
from optolever.processes import environment
from optolever.quantities import quantity
from optolever.records import Progress, silent

from ..live.figures import LiveRow, live_rows
from .batch import batch_figures
from .chart import CHARTS, CODES, DRAWS, SCENES, chart_rows, write_charts
from .decode_speed import decode_figures
from .figures import Figure
from .solver_figures import run_solver_times

__all__ = ["PARTS", "sections_of", "table_of", "with_sections", "write_page"]

SIZE, LIMITS = (480, 640), {"smooth": 17.0, "contact": 27.0}  # of live, two transforms at cells of 2 px
_FIGURES = ("figure", "measured", "limit", "")
_LIVE = (
    "case", "cell", "time", "transforms", "limit", "error/depth", "error/sigma", "beyond 5 sigma", "trusted",
)  # fmt: skip


def write_page(folder: Path, parts: Iterable[str], progress: Progress = silent) -> Path:
    """Measure, and write sections of benchmarks.md and its charts into a folder; the page's path. All: half
    an hour."""
    chosen = [(name, *PARTS[name]) for name in PARTS if name in parts]
    made = dict[str, str]()
    for done, (name, title, part) in enumerate(chosen):
        progress(name, done, len(chosen))
        with environment({} if part is _batch else ONE_THREAD):
            made[title] = "\n".join([title, "", *part(folder)])
    path = folder / "benchmarks.md"
    with_sections(path, made)
    progress("", len(chosen), len(chosen))
    return path


def sections_of(page: Path) -> tuple[str, dict[str, str]]:
    """What stands before the sections of a page, and these by title, which each begins with."""
    head, *old = page.read_text("utf-8").rstrip().split("\n## ")
    return head, {text.partition("\n")[0]: text for text in old}


def with_sections(page: Path, made: Mapping[str, str]) -> None:
    """Write sections into a page in place of those of the same title, at its end where it has none."""
    head, sections = sections_of(page)
    parts = [text.rstrip() for text in (head, *(sections | {**made}).values())]
    page.write_text("\n\n## ".join(parts) + "\n", "utf-8")


def _codes(folder: Path) -> Iterator[str]:
    text = f"""a camera of 8 bits, photon noise of 30 electrons a grey level and one grey level beside it; the
    rig is known exactly; {DRAWS} draws, whose standard deviation stands beside the error; in brackets
    rms(error / sigma). With a lag of 10 % a picture holds a tenth of the one before; a gamma of 2.2 is
    measured by a ramp. CPU time: of one thread, decode by a profile of an earlier capture, and solve."""
    yield from _head("codes", text)
    for what, file in zip(("pictures", "CPU time"), CHARTS.values(), strict=True):
        yield from (f"![Height error of codes against {what}, two scenes under three conditions]({file})", "")
    found = list(chart_rows(silent))
    write_charts(folder, found)
    for scene, (rows, cols) in SCENES.items():
        of = {condition: each for name, condition, each in found if name == scene}
        first = next(iter(of.values()))
        yield from (f"`{scene}`, {cols} x {rows} pixels:", "")
        yield from table_of(
            ("code", "pictures", "CPU time", *of),
            (
                (name, str(row.frames), _seconds(row), *(_error(each[name][1]) for each in of.values()))
                for name, (_, row) in first.items()
            ),
        )
        designed = (
            f"{name}: `{code.text}`" for name, (code, _) in first.items() if code.text not in CODES.values()
        )
        yield from ("", *_filled("; ".join(designed) + "."), "")


def _seconds(row: Tradeoff) -> str:
    return f"{row.cpu_seconds:.2f} ± {row.cpu_spread:.2f} s"


def _error(row: Tradeoff) -> str:
    if not row.share >= LEAST_SHARE:
        return "no height"
    return f"{quantity(row.simulated, 'mm', row.spread, size=1e-6)} ({row.ratio:.2f})"


def _decode(_: Path) -> Iterator[str]:
    text = """time over that of a kernel that reads the frames and writes as many bytes (floors); profile: of
    the rig, of an earlier capture. Then the same frames by OpenCV."""
    yield from _head("decode", text)
    yield from _figures(decode_figures())


def _heights(_: Path) -> Iterator[str]:
    text = """time over a pair of float64 cosine transforms of as many pixels; the rig known exactly, typed,
    and typed against a rest capture."""
    yield from _head("heights", text)
    yield from _figures(run_solver_times())


def _live(_: Path) -> Iterator[str]:
    text = """frames of an independent renderer, noise of 1.5 levels; time over a pair of float32 cosine
    transforms."""
    yield from _head("live", text)
    yield from table_of(_LIVE, map(_frame, live_rows(SIZE, (2, 4), 1)))


def _frame(row: LiveRow) -> Iterator[str]:
    limit, missed = LIMITS[row.case], ", missed" if row.ratio > LIMITS[row.case] else ""
    yield from (
        row.case,
        f"{row.cell} px",
        f"{row.ms:.3g} ms",
        f"{row.ratio:.3g}",
        f"at most {limit:g}{missed}",
    )
    yield from (f"{row.error:.2g}", f"{row.sigma_ratio:.2f}")
    yield from (f"{100 * row.beyond:.2g} %", f"{100 * row.trusted:.3g} %")


def _batch(_: Path) -> Iterator[str]:
    yield from _head("batch", "`decode` of one kind of captures, wall-clock time.")
    yield from _figures(batch_figures())


def _head(part: str, text: str) -> list[str]:
    """Command, time, machine and the measured quantity."""
    command = f"python -m lab figures --page {part}"
    return [*_filled(f"`{command}`, {datetime.now():%Y-%m-%d}, commit {_commit()}, {_machine()}: {text}"), ""]


def _filled(text: str) -> list[str]:
    return textwrap.wrap(" ".join(text.split()), 120, break_long_words=False, break_on_hyphens=False)


def _figures(figures: Iterable[Figure]) -> Iterator[str]:
    """A table of figures beside their limits."""

    def cells(one: Figure) -> tuple[str, ...]:
        missed = "" if one.met else ", missed"
        return one.name, number(one.value, one.unit), one.limits() + missed, one.note

    return table_of(_FIGURES, map(cells, figures))


def table_of(header: Iterable[str], rows: Iterable[Iterable[str]]) -> Iterator[str]:
    names = list(header)
    yield f"| {' | '.join(names)} |"
    yield "|" + "---|" * len(names)
    for row in rows:
        yield f"| {' | '.join(row)} |"


def _commit() -> str:
    run = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False)
    return run.stdout.strip() or "unknown"


def _machine() -> str:
    load = f"{os.getloadavg()[2]:.1f} programs at work before"
    return f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}, {load}"


#: Part -> title of its section, what measures it.
PARTS: dict[str, tuple[str, Callable[[Path], Iterator[str]]]] = {
    "codes": ("Error against pictures and time", _codes),
    "decode": ("Decode", _decode),
    "heights": ("Heights", _heights),
    "live": ("Live", _live),
    "batch": ("Many captures", _batch),
}
