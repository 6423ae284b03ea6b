"""`python -m lab methods`: every solver and integrator on the same cases, speed beside error."""

from dataclasses import asdict
from itertools import groupby
from pathlib import Path

import click

from optolever.cli.arguments import FILE, sample
from optolever.cli.options import SIZE, json_option
from optolever.cli.outputs import PEERS, Program
from optolever.cli.show import grid, number, progress, write_json

__all__ = ["command"]

SAMPLE = """
$ python -m lab methods --size 128x128 --case "reconstruct, cusp" \\
      --method coupled --method paper-drops
reconstruct, cusp
method       time       processor  error      error/sigma  flagged    silent
coupled      0.6842 s   0.4443 s   4.069e-06  0.01376      0.1526 %   0 %
paper-drops  0.02219 s  0.02 s     0.006875   -            0 %        -
"""
HEADER = ("method", "time", "processor", "error", "error/sigma", "flagged", "silent", "")


@click.command("methods", cls=Program, epilog=sample(SAMPLE))
@click.option(
    "--size",
    type=SIZE,
    default="256x256",
    show_default=True,
    metavar="ROWSxCOLS",
    help="Of fields and cameras.",
)
@click.option(
    "--case", "cases", multiple=True, metavar="WORDS", help="Only cases that hold them; again for more."
)
@click.option("--method", "methods", multiple=True, metavar="NAME", help="Only this one; again for more.")
@click.option(
    "--field",
    "files",
    multiple=True,
    type=FILE,
    metavar="FILE.npz",
    help="A field of your own to integrate too: z, gx, gy (per pixel), mask; again for more.",
)
@json_option
def command(
    size: tuple[int, int],
    cases: tuple[str, ...],
    methods: tuple[str, ...],
    files: tuple[Path, ...],
    json_path: Path | None,
) -> None:
    """Compare speed and error of every solver and integrator.

    integrate: plain gradient fields; error without its mean over the field's rms. reconstruct: heights from
    correspondences; error of the unflagged pixels over the peak depth, rms(error / sigma), flagged pixels,
    silent ones (unflagged, off by more than 5 sigma). Packages from PyPI run beside, where installed (extra
    `bench`).
    """
    from optolever.experiments.bench import missing_peers

    from ..bench.methods import run_methods

    missing = missing_peers()
    if missing:
        click.echo(f"Not installed, not beside: {', '.join(missing)} ({PEERS})", err=True)
    with progress() as step:
        rows = run_methods(size, cases, methods, step, files)
    write_json(json_path, {"size": size, "rows": [asdict(row) for row in rows], "not_installed": missing})
    for title, group in groupby(rows, key=lambda row: f"{row.part}, {row.case}"):
        lines = [
            [
                row.method,
                number(row.seconds, "s"),
                number(row.cpu, "s"),
                number(row.error),
                number(row.sigma_ratio),
                number(100 * row.flagged, "%"),
                number(100 * row.silent, "%"),
                row.why,
            ]
            for row in group
        ]
        grid(title, HEADER, lines)
