"""`python -m lab contacts`: forces, depths and thicknesses of elastic contacts, by kinds.

$ python -m lab contacts --rigs 2
Errors over the truth, and over sigma
kind  contacts  found  force error  ...
ball  2         2      ...
...
"""

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
    drawn: Annotated[bool, Opt("--drawn", "On rigs drawn from the priors, not as typed.")] = False,
    json_path: Json = None,
) -> None:
    """Press one contact of each kind a rig, against a rest capture, and compare it with the truth.

    Medians of relative errors and sigmas, rms and largest ratio of both.
    """
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
