"""`python -m lab contacts`: contacts on rigs that are not as typed."""

from typing import Annotated

import click

from optolever.cli.arguments import Opt, program
from optolever.cli.options import Json, Seed
from optolever.cli.show import grid, progress, write_json

__all__ = ["command"]

SAMPLE = """
$ python -m lab contacts --rigs 2
Share of errors within one total sigma
kind      fingers  found  cut  depth  area   position
ball      2        2      0    1      1      0.75
punch     0        0      0    -      -      -
gaussian  7        7      0    0.571  0.571  0.571
needle    1        1      0    1      1      0.5
all       10       10     0    0.7    0.7    0.6
"""


@program("contacts", SAMPLE)
def command(
    rigs: Annotated[int, Opt("--rigs N", "Number of them.", click.IntRange(1))] = 45,
    seed: Seed = 2,
    json_path: Json = None,
) -> None:
    """Press two to five fingers on rigs drawn from the priors, and compare contacts with the truth.

    Depth, area and position against a rest capture, in units of their total sigma.
    """
    from ..figures.contacts import KINDS, Compared, contact_figures, coverage

    drawn: list[Compared] = []
    with progress() as step:
        for number, part in enumerate(contact_figures(rigs, seed)):
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
