"""`optolever choices`: is the first choice of `design` the right one."""

from pathlib import Path

import click

from .bench import interrupted
from .options import json_option, renderer_option, sample, writable
from .show import grid, number, progress, table, write_json

__all__ = ["command"]

SAMPLE = """
$ optolever choices --case 1 --pixels 72 --more 4
First choice against all candidates
scene                                           chosen                              best of all ...
prism48 index 1.49, blur 1, noise 1, 28 frames  phase:steps=7,periods=7.65/7.06154  phase:steps= ...
In all
  within 5 % of the best  1 of 1
"""


@click.command("choices", epilog=sample(SAMPLE))
@click.option(
    "--case", "numbers", multiple=True, type=click.IntRange(0, 9), metavar="N", help="Default: all."
)
@click.option("--pixels", type=click.IntRange(min=48), default=108, show_default=True, metavar="N",
              help="Along the camera's shorter side.")  # fmt: skip
@click.option("--seeds", type=click.IntRange(min=1), default=3, show_default=True, metavar="N",
              help="Draws of noise for every candidate.")  # fmt: skip
@click.option("--more", type=click.IntRange(min=1), default=10, show_default=True, metavar="N",
              help="Draws for the best of them.")  # fmt: skip
@renderer_option
@json_option
def command(
    numbers: tuple[int, ...], pixels: int, seeds: int, more: int, renderer: str, json_path: Path | None
) -> None:
    """Choose by `design` for ten scenes and simulate every candidate of each: how far from the best is it?

    Minutes per scene. excess: error of the choice over that of the best found, minus one.
    """
    writable(json_path)
    from optolever.experiments.design import CASES, ChoiceRow, run_choices

    cases = tuple(CASES[number] for number in numbers) or CASES
    rows: list[ChoiceRow] = []
    with interrupted() as stopped, progress() as step:
        for row in run_choices(
            cases, pixels=pixels, seeds=seeds, more=more, renderer=renderer, progress=step
        ):
            rows.append(row)
            write_json(json_path, {"rows": [row.to_dict() for row in rows], "pixels": pixels})
    header = ("scene", "chosen", "best of all", "excess", "candidates", "predicted within 15 %", "worst")
    grid(
        "First choice against all candidates",
        header,
        [
            [
                row.case,
                row.chosen,
                row.best,
                number(100 * row.excess, "%"),
                str(row.candidates),
                number(100 * row.within_15, "%"),
                f"x {number(row.worst_ratio)}",
            ]
            for row in rows
        ],
    )
    good = sum(row.excess <= 0.05 for row in rows)
    table("In all", {"within 5 % of the best": f"{good} of {len(rows)}"})
    if stopped.hit:
        raise KeyboardInterrupt
