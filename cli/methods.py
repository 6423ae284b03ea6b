"""`optolever methods`: every solver and integrator on the same cases, speed beside error."""

from itertools import groupby
from pathlib import Path

import click

from .options import FILE, SIZE, json_option, sample, writable
from .show import grid, number, progress, write_json

__all__ = ["command"]

SAMPLE = """
$ optolever methods --size 128x128 --case "reconstruct, cusp" \\
      --method coupled --method march --method paper-drops
reconstruct, cusp
method       time       processor  error      error/sigma  flagged    silent
coupled      2.242 s    1.092 s    1.994e-05  0.1177       0.04883 %  0.03664 %
march        0.02899 s  0.01794 s  5.668e-05  0.1003       0.02441 %  0.01221 %
paper-drops  0.03335 s  0.01335 s  0.006875   -            0 %        -
"""
HEADER = ("method", "time", "processor", "error", "error/sigma", "flagged", "silent", "")


@click.command("methods", epilog=sample(SAMPLE))
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
    """Measure speed against error of every method on the same fields and mirrors.

    integrate: plain gradient fields; error without its mean over the field's rms. reconstruct: heights from
    correspondences; error of the unflagged pixels over the peak depth, rms(error / sigma), flagged pixels,
    silent ones (unflagged, off by more than 5 sigma). Packages from PyPI run beside, where installed (extra
    `bench`).
    """
    writable(json_path)
    from optolever.experiments.bench import missing_peers, run_methods

    with progress() as step:
        rows = run_methods(size, cases, methods, step, files)
    missing = missing_peers()
    write_json(json_path, {"size": size, "rows": [row.to_dict() for row in rows], "not_installed": missing})
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
    if missing:
        click.echo(f"Not installed, not beside: {', '.join(missing)} (pip install 'optolever[bench]')")
