"""`python -m lab pairs`: two effects at once, or structural faults, on drawn rigs: what is silently wrong."""

from pathlib import Path

import click

from optolever.cli.options import json_option, sample
from optolever.cli.outputs import Program
from optolever.cli.show import grid, progress, table, write_json

__all__ = ["command"]

SAMPLE = """
$ python -m lab pairs --draws 20
Pairs of effects on drawn rigs
number  code        effects               good    places  heights  named
0       gray+phase  swapped 3 2, lag 0.1  98.1 %  0 %     0 %      right
"""
#: Share of the heights beyond 5 sigma from which on a draw is listed.
SILENT = 0.01


@click.command("pairs", cls=Program, epilog=sample(SAMPLE))
@click.option("--draws", type=click.IntRange(1), default=200, show_default=True, metavar="N")
@click.option("--first", type=click.IntRange(0), default=0, metavar="N", help="The first one's number.")
@click.option("--structural", is_flag=True, help="One structural fault each instead of two effects.")
@click.option("--every", is_flag=True, help="A row for every draw.")
@json_option
def command(draws: int, first: int, structural: bool, every: bool, json_path: Path | None) -> None:
    """Decode drawn rigs under two effects at once and compare with rays.

    A row for each draw of which more than 1 % of the heights (of structural faults: of the places) are good
    and off by more than 5 sigma: what was done, good share, share of the good places and heights beyond 5
    sigma, and whether the faulty frames are named rightly, partly (others too, or not all) or falsely.
    """
    import numpy as np

    from ..pairs.drawn import drawn_pair, drawn_structure, judged

    draw = drawn_structure if structural else drawn_pair
    with progress(lines=True) as step:
        found = []
        for number in range(first, first + draws):
            found.append(judged(draw(number)))
            step(f"{number}", len(found), draws)
    rows = []
    for one in found:
        if every or one.silent > SILENT:
            shares = (f"{share:.2%}" for share in (one.good, one.places, one.heights))
            rows.append((str(one.number), one.code, one.what, *shares, one.named, *one.told))
    heads = ("number", "code", "effects", "good", "places", "heights", "named", "told")
    grid("Structural faults on drawn rigs" if structural else "Pairs of effects on drawn rigs", heads, rows)
    alone = [
        one
        for one in found
        if sum(name in one.what for name in ("swapped", "lost", "torn", "window")) == 1
        and ("swapped" in one.what or "lost" in one.what)
    ]
    named = {
        f"named {how}": str(sum(one.named == how for one in found)) for how in ("right", "partly", "false")
    }
    table(
        "Verdict",
        {
            "draws": str(len(found)),
            "silent beyond 1 %": str(sum(one.silent > SILENT for one in found)),
            "median good share": f"{np.median([one.good for one in found]):.2%}",
            "less than half good": str(sum(one.good < 0.5 for one in found)),
            **named,
            "swapped or lost alone": str(len(alone)),
            "of these named rightly": str(sum(one.named == "right" for one in alone)),
            "of these left out": str(sum(one.left_out for one in alone)),
        },
    )
    if json_path is not None:
        write_json(json_path, {"draws": [one.to_dict() for one in found]})
