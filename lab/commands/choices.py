"""`python -m lab choices`: is the first choice of `design` the right one."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from optolever.cli.arguments import sample
from optolever.cli.bench import interrupted
from optolever.cli.options import json_option, renderer_option
from optolever.cli.outputs import Program
from optolever.cli.show import number, progress, table, write_json

if TYPE_CHECKING:
    from ..design.exhaustive import ChoiceRow

__all__ = ["command"]

SAMPLE = """
$ python -m lab choices --case 2 --pixels 72
Case 2: prism48 distance 5, flat, blur 0.6, noise 3, 24 frames
  chosen       phase:steps=4,periods=5.05524/4.18223/4: 0.0001215 mm rms on 100 %
  best of all  phase:steps=4,periods=5.05524/4.18223/4: 0.0001215 mm rms on 100 %
  excess       0 %
  within 15 %  100 % of 52 candidates; median error 5.747 %
  time         359.2 s
In all
  within 5 % of the best  1 of 1
  predicted within 15 %   100 % of the candidates
"""


@click.command("choices", cls=Program, epilog=sample(SAMPLE))
@click.option(
    "--case", "numbers", multiple=True, type=click.IntRange(0, 9), metavar="N", help="Default: all."
)
@click.option(
    "--random", "drawn", type=click.IntRange(0), default=0, metavar="N", help="N random scenes instead."
)
@click.option("--first", type=click.IntRange(0), default=0, metavar="N", help="The first one's number.")
@click.option("--pixels", type=click.IntRange(min=48), default=108, show_default=True, metavar="N",
              help="Along the camera's shorter side.")  # fmt: skip
@click.option("--seeds", type=click.IntRange(min=1), default=12, show_default=True, metavar="N",
              help="Draws of noise for every candidate.")  # fmt: skip
@click.option("--more", type=click.IntRange(min=1), default=40, show_default=True, metavar="N",
              help="Draws for the best of them.")  # fmt: skip
@renderer_option
@json_option
def command(
    numbers: tuple[int, ...],
    drawn: int,
    first: int,
    pixels: int,
    seeds: int,
    more: int,
    renderer: str,
    json_path: Path | None,
) -> None:
    """Compare what design chooses with the best of all candidates.

    For ten scenes every candidate is simulated: how far from the best is the choice? --random draws scenes,
    dents, blur, noise and frames that nobody has thought of; a number's is always the same.

    One to eight minutes a scene; each is printed when done, and Ctrl-C keeps those. merit: rms error over
    all pixels, one without a height counted as five times the rms of the others; excess: merit of the choice
    over that of the best found, minus one; within 15 %: candidates whose predicted rms error is so near the
    simulated one (which --seeds draws leave unsure by a fifth over their square root).
    """
    if first and not drawn:
        raise click.UsageError("--first goes with --random")
    if numbers and drawn:
        raise click.UsageError("--case and --random exclude each other")
    from ..design.exhaustive import CASES, drawn_cases, run_choice

    if drawn:
        cases = dict(zip(range(first, first + drawn), drawn_cases(drawn, first), strict=True))
    else:
        cases = {number: CASES[number] for number in numbers or range(len(CASES))}
    rows: list[ChoiceRow] = []
    with interrupted() as stopped:
        for index, case in cases.items():
            with progress() as step:
                row = run_choice(
                    case, pixels=pixels, seeds=seeds, more=more, renderer=renderer, progress=step
                )
            rows.append(row)
            table(f"Case {index}: {row.case}", _told(row))
            write_json(json_path, {"rows": [asdict(row) for row in rows], "pixels": pixels})
    good = sum(row.excess <= 0.05 for row in rows)
    near = sum(row.within_15 * row.candidates for row in rows) / max(1, sum(row.candidates for row in rows))
    table(
        "In all",
        {
            "within 5 % of the best": f"{good} of {len(rows)}",
            "predicted within 15 %": f"{number(100 * near, '%')} of the candidates",
        },
    )
    if stopped.hit:
        raise KeyboardInterrupt


def _told(row: "ChoiceRow") -> dict[str, str]:
    def result(text: str, error: float, share: float) -> str:
        return f"{text}: {number(error, 'mm')} rms on {number(100 * share, '%')}"

    worst = "".join(f"; worst x {number(by)}, {text}" for text, by in list(row.outside.items())[:1])
    return {
        "chosen": result(row.chosen, row.chosen_error, row.chosen_share),
        "best of all": result(row.best, row.best_error, row.best_share),
        "excess": number(100 * row.excess, "%"),
        "within 15 %": f"{number(100 * row.within_15, '%')} of {row.candidates} candidates; "
        f"median error {number(100 * row.median_error, '%')}" + worst,
        "time": number(row.seconds, "s"),
    }
