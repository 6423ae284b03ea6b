"""docs/benchmarks.md: the page of figures and its chart, measured here and now."""

import os
import platform
import subprocess
import textwrap
from collections.abc import Iterable, Iterator
from datetime import datetime
from pathlib import Path

from optolever.blocks import ONE_THREAD
from optolever.cli.printing import number
from optolever.design import Tradeoff, compare_codes, write_tradeoff_chart
from optolever.processes import environment
from optolever.records import Progress, silent
from optolever.samples import Faults
from optolever.scene import load, resize

from ..judgements.record import section
from ..live.figures import LiveRow, live_rows
from .batch import batch_figures
from .decode_speed import profile_figures, run_decode_figures
from .figures import Figure
from .solver_figures import run_solver_times

__all__ = ["write_page"]

#: Codes of the chart.
CODES = (
    *("phase:steps=3", "phase", "phase:steps=8", "phase:steps=4,periods=9/10/11"),
    *("gray+phase", "gray", "micro-phase", "stripe:step=16"),
)
SCENE, SIZE, REFRESH, DRAWS = "prism48", (240, 320), 60.0, 3
CHART = "speed_against_error.png"
_FIGURES = ("figure", "measured", "limit", "")
_CODES = ("code", "frames", "acquire", "decode, solve", "height error, rms", "error/sigma", "measured")
_LIVE = ("case", "cell", "time", "transforms", "error/depth", "error/sigma", "beyond 5 sigma", "trusted")
_INTRODUCTION = """Written by `python -m lab figures --page` on {day} at commit {commit}: {machine}.
Simulated, geometry known; real captures are among the tests (`tests/real`). Times are processor times of one
thread, minima; of many captures wall-clock time. Each table stands under the command that prints it."""
_OTHERS = """`python -m lab calibration`, `rigs` and `contacts` measure what calibrations, typed rigs and
contacts are worth, `lab live --streams` and `--vibration` streams of all kinds and small vibrations, `lab
sync` displays and cameras in simulated time, `lab fuzz` damaged inputs, for minutes or hours."""


def write_page(folder: Path, progress: Progress = silent) -> Path:
    """Measure, and write benchmarks.md and its chart into a folder; the page's path. Some minutes."""
    lines: list[str] = []
    with environment(ONE_THREAD):
        for done, (name, part) in enumerate(
            {"codes": _codes, "decode": _decode, "heights": _heights, "live": _live}.items()
        ):
            progress(name, done, 5)
            lines += part(folder)
    progress("batch", 4, 5)  # two processes
    lines += _section("Many captures", "python -m lab figures", "`decode` of one kind of captures.")
    lines += _figures(batch_figures())
    known = {"day": f"{datetime.now():%Y-%m-%d}", "commit": _commit(), "machine": _machine()}
    first = ["# Benchmarks", "", *_filled(_INTRODUCTION.format(**known))]
    last = ["", "## Further commands", "", *_filled(_OTHERS)]
    path = folder / "benchmarks.md"
    kept = (
        section(path)[1].rstrip().splitlines() if path.exists() else []
    )  # `lab judgements --page` writes it
    path.write_text("\n".join([*first, *lines, *last, *(["", *kept] if kept else [])]) + "\n", "utf-8")
    progress("", 5, 5)
    return path


def _codes(folder: Path) -> Iterator[str]:
    scene = resize(load(SCENE), *SIZE)
    faults = [Faults()]
    rows = list(
        compare_codes(
            scene, None, CODES, faults=faults, noises=(1.0,), rate=REFRESH, seeds=range(DRAWS), resized=True
        )
    )
    title = f"{SCENE}, {SIZE[1]} x {SIZE[0]}, dent of 0.3 mm, {DRAWS} draws of noise, {REFRESH:g} Hz"
    write_tradeoff_chart(folder / CHART, rows, title)
    options = " ".join(f"--code {code}" for code in CODES)
    text = "a camera of 8 bits, photon noise of 30 electrons a grey level and one grey level beside it."
    command = f"optolever design --scene {SCENE} --pixels {SIZE[1]}x{SIZE[0]} {options}"
    yield from _section("Error against time", command, text)
    yield from (
        f"![Height error against CPU time and against acquisition time, a mark per code]({CHART})",
        "",
    )
    yield from _table(_CODES, map(_code, rows))


def _code(row: Tradeoff) -> Iterator[str]:
    yield from (f"`{row.code}`", str(row.frames), number(row.acquisition_seconds, "s"))
    yield f"{1e3 * row.cpu_seconds:.0f} ms"
    yield f"{1e6 * row.simulated:.3g} ± {1e6 * row.spread:.2g} nm"
    yield from (f"{row.ratio:.2f}", f"{100 * row.share:.1f} %")


def _decode(_: Path) -> Iterator[str]:
    command = "python -m lab figures --decode --pixels 640x480"
    text = """time over that of a kernel that reads the frames and writes as many bytes (floors); profile: of
    the rig, of an earlier capture. Then the same frames by OpenCV and, where it is installed, `fringes`."""
    yield from _section("Decode", command, text)
    figures = [*profile_figures((480, 640), 3), *profile_figures((1080, 1920), 1)]
    figures += run_decode_figures(size=(480, 640), parts=("fringes", "gray"))
    yield from _figures(figures)


def _heights(_: Path) -> Iterator[str]:
    text = """time over a pair of float64 cosine transforms of as many pixels; the rig known exactly, typed,
    and typed against a rest capture."""
    yield from _section("Heights", "python -m lab figures --reconstruct", text)
    yield from _figures(run_solver_times())


def _live(_: Path) -> Iterator[str]:
    command = f"python -m lab live --pixels {SIZE[1]}x{SIZE[0]}"
    text = """frames of an independent renderer, noise of 1.5 levels; time over a pair of float32 cosine
    transforms."""
    yield from _section("Live", command, text)
    yield from _table(_LIVE, map(_frame, live_rows(SIZE, (2, 4), 1)))


def _frame(row: LiveRow) -> Iterator[str]:
    yield from (row.case, f"{row.cell} px", f"{row.ms:.3g} ms", f"{row.ratio:.3g}")
    yield from (f"{row.error:.2g}", f"{row.sigma_ratio:.2f}")
    yield from (f"{100 * row.beyond:.2g} %", f"{100 * row.trusted:.3g} %")


def _section(title: str, command: str, text: str) -> list[str]:
    return ["", f"## {title}", "", *_filled(f"`{command}`: {text}"), ""]


def _filled(text: str) -> list[str]:
    return textwrap.wrap(" ".join(text.split()), 120, break_long_words=False, break_on_hyphens=False)


def _figures(figures: Iterable[Figure]) -> Iterator[str]:
    """A table of figures beside their limits."""

    def cells(one: Figure) -> tuple[str, ...]:
        missed = "" if one.met else ", missed"
        return one.name, number(one.value, one.unit), one.limits() + missed, one.note

    return _table(_FIGURES, map(cells, figures))


def _table(header: Iterable[str], rows: Iterable[Iterable[str]]) -> Iterator[str]:
    names = list(header)
    yield f"| {' | '.join(names)} |"
    yield "|" + "---|" * len(names)
    for row in rows:
        yield f"| {' | '.join(row)} |"


def _commit() -> str:
    run = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False)
    return run.stdout.strip() or "unknown"


def _machine() -> str:
    load = f"{os.getloadavg()[2]:.1f} programs at work"
    return f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}, {load}"
