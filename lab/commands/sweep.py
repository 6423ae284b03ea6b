"""`python -m lab sweep`: a grid of cells, resumable, here or on a Dask cluster."""

import importlib.util
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from optolever import InputError
from optolever.blocks import ONE_THREAD
from optolever.cli.arguments import FILE, sample
from optolever.cli.bench import finish, interrupted
from optolever.cli.options import json_option, report_option
from optolever.cli.outputs import Program
from optolever.cli.show import progress

if TYPE_CHECKING:
    from optolever.experiments.bench import Row

__all__ = ["command"]

SAMPLE = """
$ python -m lab sweep grid.toml --workers 2 --out sweep
paper-simulation, own dent, 64 × 64, noise 1
sequence    solver   frames  display  decode  solve   rms         max     err/sigma  flagged  silent
gray+phase  coupled  18      0.30 s   9.9 ms  0.01 s  1.1 × 10⁻³  0.0157  0.933      3.08 %   0.00 %
gray+phase  coupled  18      0.30 s   5.8 ms  0.03 s  1.4 × 10⁻³  0.0344  1.011      3.03 %   0.00 %
Run
  cells   2 measured of 2
  time    5.2 s
  report  sweep/report.html
where grid.toml holds
  scenes = ["paper-simulation"]
  sizes = ["64x64"]
  sequences = ["gray+phase"]
  seeds = [0, 1]
"""


@click.command("sweep", cls=Program, epilog=sample(SAMPLE))
@click.argument("grid_path", type=FILE, metavar="GRID.toml")
@click.option(
    "--workers",
    type=click.IntRange(min=0),
    metavar="N",
    help="Local processes of one thread each; 0: this one. Default: one per core where Dask is installed.",
)
@click.option("--scheduler", metavar="ADDRESS", help="A running Dask scheduler, such as tcp://10.0.0.1:8786.")
@report_option("sweep", "Gets the results.", "report.html", "results.json", "results.csv")
@json_option
def command(
    grid_path: Path, workers: int | None, scheduler: str | None, out: Path, json_path: Path | None
) -> None:
    """Run every combination of the lists in GRID.toml.

    What DIR already has is not run again. GRID.toml: scenes, sequences, and optionally solvers, dents, sizes
    ('96x96' or 'own'), noises, seeds, renderer, refresh. Each cell is seeded by itself and becomes one file
    in DIR/cells, so that Ctrl-C or a lost worker costs nothing that was finished, and the numbers do not
    depend on where they were computed.
    """
    dask = importlib.util.find_spec("distributed") is not None
    if (workers or scheduler) and not dask:
        raise InputError("--workers, --scheduler: need Dask; pip install distributed, or --workers 0")
    os.environ.update(ONE_THREAD)  # before NumPy is loaded: the same sums here as on any worker
    from optolever.experiments.bench import Store, load_grid

    from ..bench.sweeps import sweep

    asked = load_grid(grid_path)
    if workers is None:
        workers = (os.cpu_count() or 1) if scheduler is None and dask else 0
    start = time.perf_counter()
    rows: list[Row] = []
    with interrupted() as stopped, progress() as step:
        for row in sweep(asked.cells(), Store(out), workers, scheduler, step):
            rows.append(row)
    finish(out, rows, asked, time.perf_counter() - start, json_path)
    if stopped.hit:
        raise KeyboardInterrupt
