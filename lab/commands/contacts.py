"""`python -m lab contacts`: contacts on rigs that are not as typed.

$ python -m lab contacts --rigs 2
Share of errors within one total sigma
kind      fingers  found  cut  depth  area   position
ball      2        2      0    1      1      0.75
punch     0        0      0    -      -      -
gaussian  7        7      0    0.571  0.571  0.571
needle    1        1      0    1      1      0.5
all       10       10     0    0.7    0.7    0.6
"""

from pathlib import Path
from typing import Annotated

import click

from optolever.cli.arguments import Opt, program
from optolever.cli.options import Json, Seed
from optolever.cli.printing import grid, progress, write_json

__all__ = ["command"]


@program("contacts", __doc__)
def command(
    rigs: Annotated[int, Opt("--rigs N", "Number of them.", click.IntRange(1))] = 45,
    seed: Seed = 2,
    elastic: Annotated[
        bool, Opt("--elastic", "Force, depth and thickness of elastic contacts instead, by kinds.")
    ] = False,
    drawn: Annotated[bool, Opt("--drawn", "Of these: on rigs drawn from the priors, not as typed.")] = False,
    json_path: Json = None,
) -> None:
    """Press two to five fingers on rigs drawn from the priors, and compare contacts with the truth.

    Depth, area and position against a rest capture, in units of their total sigma. With --elastic: one
    contact of each kind a rig; medians of relative errors and sigmas, rms and largest ratio of both.
    """
    from ..figures.contacts import (
        KINDS,
        Compared,
        contact_figures,
        coverage,
    )

    if elastic:
        _elastic(rigs, seed, drawn, json_path)
        return
    every: list[Compared] = []
    with progress() as step:
        for number, part in enumerate(contact_figures(rigs, seed)):
            step("rigs", number, rigs)
            every += part
    table = {}
    for kind in (*KINDS, "all"):
        some = [each for each in every if kind in (each.finger.kind, "all")]
        table[kind] = coverage(some)
    names = ("fingers", "found", "cut", "depth", "area", "position")
    rows = [
        [kind, *(f"{row[name]:.3g}" if name in row else "-" for name in names)] for kind, row in table.items()
    ]
    grid("Share of errors within one total sigma", ("kind", *names), rows)
    write_json(json_path, {"seed": seed, "rigs": rigs, "coverage": table})


def _elastic(rigs: int, seed: int, drawn: bool, json_path: Path | None) -> None:
    from ..figures.elastic import ELASTIC, elastic_figures, elastic_scores

    scores = {}
    with progress() as step:
        for number, kind in enumerate(ELASTIC):
            step("kinds", number, len(ELASTIC))
            scores[kind] = elastic_scores(list(elastic_figures(kind, rigs, seed, drawn)))
    parts = [f"{name} {part}" for name in ("force", "depth") for part in ("error", "sigma", "ratio", "worst")]
    names = ["contacts", "found", *parts, "layers", "thickness error"]
    rows = [
        [kind, *(f"{row[name]:.3g}" if name in row else "-" for name in names)]
        for kind, row in scores.items()
    ]
    grid("Errors over the truth, and over sigma", ("kind", *names), rows)
    write_json(json_path, {"seed": seed, "rigs": rigs, "drawn": drawn, "elastic": scores})
