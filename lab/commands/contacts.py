"""`python -m lab contacts`: contacts on rigs that are not as typed."""

from pathlib import Path

import click

from optolever.cli.arguments import sample
from optolever.cli.options import json_option
from optolever.cli.outputs import Program
from optolever.cli.show import grid, progress, write_json

__all__ = ["command"]

SAMPLE = """
$ python -m lab contacts --rigs 48
Share of errors within one total sigma
kind      fingers  found  cut  depth  area   position
ball      34       32     0    0.562  0.562  0.578
punch     18       13     0    0.615  0.385  0.769
gaussian  60       59     0    0.746  0.814  0.669
needle    57       57     0    0.596  0.702  0.658
all       169      161    0    0.646  0.689  0.655
"""


@click.command("contacts", cls=Program, epilog=sample(SAMPLE))
@click.option("--rigs", type=click.IntRange(1), default=45, show_default=True, metavar="N")
@click.option("--seed", type=click.IntRange(0), default=2, show_default=True)
@click.option("--differences", is_flag=True, help="Modes by whole solves instead of those of `reconstruct`.")
@json_option
def command(rigs: int, seed: int, differences: bool, json_path: Path | None) -> None:
    """Press two to five fingers on rigs drawn from the priors, and compare contacts with the truth.

    Depth, area and position against a rest capture, in units of their total sigma.
    """
    from ..figures.contacts import KINDS, Compared, contact_figures, coverage

    drawn: list[Compared] = []
    with progress() as step:
        for number, part in enumerate(contact_figures(rigs, seed, differences=differences)):
            step("rigs", number, rigs)
            drawn += part
    table = {}
    for kind in (*KINDS, "all"):
        some = [each for each in drawn if kind in (each.finger.kind, "all")]
        table[kind] = coverage(some)
    names = ("fingers", "found", "cut", "depth", "area", "position")
    rows = [
        [kind, *(f"{row[name]:.3g}" if name in row else "-" for name in names)] for kind, row in table.items()
    ]
    grid("Share of errors within one total sigma", ("kind", *names), rows)
    write_json(json_path, {"seed": seed, "rigs": rigs, "coverage": table})
