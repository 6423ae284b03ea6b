"""`python -m lab contacts`: contacts on rigs that are not as typed."""

from typing import Annotated

import click

from optolever.cli.arguments import Opt, program
from optolever.cli.options import Json, Seed
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


@program("contacts", SAMPLE)
def command(
    rigs: Annotated[int, Opt("--rigs N", "Number of them.", click.IntRange(1))] = 45,
    seed: Seed = 2,
    differences: Annotated[bool, Opt("--differences", "Modes by whole solves, not `reconstruct`'s.")] = False,
    json_path: Json = None,
) -> None:
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
