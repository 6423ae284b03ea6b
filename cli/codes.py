"""`optolever codes`: comparison of codes."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from .arguments import sample
from .options import SIZE, json_option
from .outputs import Program
from .show import grid, number, progress, write_json

if TYPE_CHECKING:
    from optolever.experiments import CodeRow

__all__ = ["command"]

SAMPLE = """
$ optolever codes gray phase gray+phase --size 200x320
Codes
code        frames  range   sigma       gross  stripe  lost   swapped
gray        36      200 px  0.2972 px   0      2 px    100 %  100 %
phase       24      200 px  0.06148 px  0      8 px    100 %  100 %
gray+phase  23      200 px  0.03062 px  0      4 px    100 %  100 %
"""
HEADER = ("code", "frames", "range", "sigma", "gross", "stripe", "lost", "swapped")


@click.command("codes", cls=Program, epilog=sample(SAMPLE))
@click.argument("codes", nargs=-1, metavar="[CODE]...")
@click.option(
    "--size",
    type=SIZE,
    default="1080x1920",
    show_default=True,
    metavar="ROWSxCOLS",
    help="Size of the display.",
)
@click.option(
    "--amplitude",
    default=60.0,
    show_default=True,
    metavar="LEVELS",
    help="Amplitude, from mid grey to white.",
)
@click.option(
    "--noise", default=2.0, show_default=True, metavar="LEVELS", help="Standard deviation of the noise."
)
@json_option
def command(
    codes: tuple[str, ...], size: tuple[int, int], amplitude: float, noise: float, json_path: Path | None
) -> None:
    """Compare frames, errors and fault detection of codes.

    White noise only. CODE as in --sequence. Simulated patches at the surface's start, middle and end are
    decoded. range: unambiguous range, pixels; sigma: rms error, of the worse axis; gross: share of wrong
    orders or bits; stripe: the narrowest, most sensitive to blur; lost, swapped: share of the frames whose
    loss (or swap with the next) causes no unflagged error.
    """
    from optolever.experiments import CODES, code_rows

    with progress(lines=True) as step:
        rows = list(code_rows(codes or CODES, size, amplitude, noise, step))
    fields = ("name", "frames", "reach", "sigma", "gross", "stripe", "lost", "swapped")
    write_json(json_path, {"codes": [{name: getattr(row, name) for name in fields} for row in rows]})
    grid("Codes", HEADER, [_cells(row) for row in rows])


def _cells(row: "CodeRow") -> list[str]:
    return [
        row.name,
        str(row.frames),
        number(row.reach, "px"),
        number(row.sigma, "px"),
        number(row.gross),
        number(row.stripe, "px"),
        number(100 * row.lost, "%"),
        number(100 * row.swapped, "%"),
    ]
