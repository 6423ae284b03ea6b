"""`optolever bench`: speed against error, of every sequence with every solver."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .arguments import FILE, sample
from .options import SIZE, json_option, renderer_option, report_option
from .outputs import PEERS, Program
from .show import grid, number, progress, table, write_json

if TYPE_CHECKING:
    from optolever.experiments.bench import Grid, Row

__all__ = ["command", "finish", "interrupted"]

SAMPLE = """
$ optolever bench --scene paper-simulation --size 96x96 --out bench --sequence exact \\
    --sequence gray+phase --solver coupled --solver paper-drops
paper-simulation, own dent, 96 × 96, noise 1
sequence    solver       frames  display  decode  solve   rms         max         err/sigma  flagged  silent
exact       coupled                               0.02 s  7.7 × 10⁻⁸  2.1 × 10⁻⁷  0.000      0.00 %   0.00 %
gray+phase  coupled      20      0.33 s   0.01 s  0.03 s  7.2 × 10⁻⁴  0.0193      1.111      2.06 %   0.00 %
exact       paper-drops                           0.02 s  0.0109      0.0302      –          0.00 %   –
gray+phase  paper-drops  20      0.33 s   0.01 s  0.02 s  0.0109      0.032       –          2.06 %   –
Run
  cases   4 measured of 4
  time    2.018 s
  report  bench/report.html
"""


SHARE = click.FloatRange(0, 1, max_open=True)


@click.command("bench", cls=Program, epilog=sample(SAMPLE))
@click.option("--scene", "scenes", multiple=True, metavar="PRESET_OR_TOML", help="Scene; repeatable.")
@click.option(
    "--dent", "dents", multiple=True, metavar="NAME[:KEY=VALUE,...]", help="Dent; default: the scene's."
)
@click.option(
    "--sequence",
    "sequences",
    multiple=True,
    metavar="NAME[:KEY=VALUE,...][@DECODER]",
    help="Sequence, and another decoder: fringes, cv2 or MODULE:FUNCTION (FUNCTION(frames, "
    "sequence) returns a "
    "Correspondence). exact: the true correspondence, no frames.",
)
@click.option(
    "--add",
    "added",
    multiple=True,
    metavar="MODULE:FUNCTION[@DECODER]",
    help="Also a pattern of yours: FUNCTION(rows, cols) returns a patterns.Sequence, or images "
    "(N, rows, cols), which need a decoder of yours.",
)
@click.option(
    "--solver",
    "solvers",
    multiple=True,
    metavar="NAME",
    help="Method of reconstruct, or a peer's integrator.",
)
@click.option(
    "--size",
    "sizes",
    multiple=True,
    type=SIZE,
    metavar="ROWSxCOLS",
    help="Size of the camera; default 512x512.",
)
@click.option(
    "--noise",
    "noises",
    multiple=True,
    type=click.FloatRange(min=0),
    metavar="LEVELS",
    help="Noise of a frame; default 1.",
)
@click.option(
    "--seed",
    "seeds",
    multiple=True,
    type=click.IntRange(min=0),
    metavar="N",
    help="Seed of the noise; default 0.",
)
@click.option("--grid", "grid_path", type=FILE, metavar="TOML", help="File with the lists above.")
@click.option(
    "--refresh",
    type=click.FloatRange(min=0, min_open=True),
    metavar="HZ",
    help="Frames that the display shows per second; default 60.",
)
@click.option("--lag", "lags", multiple=True, type=SHARE, metavar="SHARE",
              help="Share of the preceding frame in each frame; default 0.")  # fmt: skip
@click.option("--gamma", "gammas", multiple=True, type=click.FloatRange(min=0, min_open=True), metavar="G",
              help="Gamma of the display, unknown to the decoder; default: the scene's.")  # fmt: skip
@click.option("--flicker", "flickers", multiple=True, type=SHARE, metavar="SHARE",
              help="Amplitude of the light's oscillation at 100 Hz; default: the scene's.")  # fmt: skip
@click.option("--blur", "blurs", multiple=True, type=click.FloatRange(min=0), metavar="CELLS",
              help="Rms blur between display and camera; default: the scene's.")  # fmt: skip
@click.option("--exposure", "exposure", type=click.FloatRange(min=0), metavar="MS",
              help="Exposure of a frame, rounded up to full refreshes; default 0.")  # fmt: skip
@renderer_option
@report_option("bench", "Gets the report.", "report.html", "results.json", "results.csv")
@click.option("--readme", is_flag=True, help="Print the summary as a Markdown table, in place of all rows.")
@json_option
def command(
    grid_path: Path | None,
    refresh: float | None,
    exposure: float | None,
    renderer: str,
    out: Path,
    readme: bool,
    json_path: Path | None,
    added: tuple[str, ...],
    **lists: tuple[Any, ...],
) -> None:
    """Compare speed and error of sequences and solvers.

    Time, memory, error, error bars, silent errors. Every combination of the lists runs on this machine, one
    after the other; omitted lists are those of the default grid. DIR gets report.html (a section per mirror
    with a chart of error over time), results.json, results.csv and a file per case.
    """
    from dataclasses import replace

    from optolever.experiments.bench import Store, absent_modules, time_cells

    asked = _grid(grid_path, lists, {"refresh": refresh, "exposure_ms": exposure}, renderer)
    asked = replace(asked, sequences=asked.sequences + added)
    absent = absent_modules(asked.cells())
    if absent:
        click.echo(f"Notice: {', '.join(absent)}: not installed, no numbers of them; {PEERS}", err=True)
    start = time.perf_counter()
    rows: list[Row] = []
    with interrupted() as stopped, progress() as step:
        for row in time_cells(asked.cells(), Store(out), step):
            rows.append(row)
    finish(out, rows, asked, time.perf_counter() - start, json_path, readme)
    if stopped.hit:
        raise KeyboardInterrupt


class interrupted:
    """Ctrl-C ends the block, not the program: finished results are reported, then the exit code is 130."""

    def __init__(self) -> None:
        self.hit = False

    def __enter__(self) -> "interrupted":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> bool:
        self.hit = kind is not None and issubclass(kind, KeyboardInterrupt)
        return self.hit


def finish(
    out: Path,
    rows: "list[Row]",
    asked: "Grid",
    seconds: float,
    json_path: Path | None,
    readme: bool = False,
) -> None:
    """Write results and report, print the tables; readme: the summary as Markdown instead."""
    from dataclasses import asdict

    from optolever.experiments.bench import Store, bench_markdown, bench_table, write_bench_report

    settings = asdict(asked) | {"rate": asked.rate}
    Store(out).finish(rows, settings, asked.rate)
    write_bench_report(out / "report.html", rows, settings, {"total": seconds})
    write_json(json_path, {"settings": settings, "rows": [row.flat(asked.rate) for row in rows]})
    if readme:
        click.echo(bench_markdown(rows))
        return
    for name, (header, *lines), absent in bench_table(rows, asked.rate):
        grid(name, header, lines)
        for line in absent:
            click.echo(f"no number: {line}")
    table(
        "Run",
        {
            "cases": f"{sum(row.done for row in rows)} measured of {len(asked.cells())}",
            "time": number(seconds, "s"),
            "report": str(out / "report.html"),
        },
    )


def _grid(
    path: Path | None, lists: dict[str, tuple[Any, ...]], times: dict[str, float | None], renderer: str
) -> "Grid":
    from dataclasses import replace

    from optolever.experiments.bench import DEFAULT_GRID, load_grid

    base = DEFAULT_GRID if path is None else load_grid(path)
    given: dict[str, Any] = {name: tuple(values) for name, values in lists.items() if values}
    given |= {name: value for name, value in times.items() if value is not None}
    if path is None or renderer != "auto":
        given["renderer"] = renderer
    return replace(base, **given)
