"""`python -m lab adapt`: frames chosen one after the other, until the height is good enough."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from optolever.cli.arguments import sample
from optolever.cli.bench import interrupted
from optolever.cli.options import (
    json_option,
    load_scene,
    noise_option,
    renderer_option,
    scene_option,
    size_option,
)
from optolever.cli.outputs import Program
from optolever.cli.show import grid, number, print_notices, progress, table, write_json

if TYPE_CHECKING:
    from ..design.adaptive_study import AdaptiveRow, AdaptiveStudy

__all__ = ["command"]

SAMPLE = """
$ python -m lab adapt --scene paper-prototype --pixels 125x200 --goal 2e-4 \\
      --dent ridge:peak=0.09,sigma=3.5 --seeds 1 --no-compare
Adaptive sensing: paper-prototype, 95 % within 0.0002 mm
ridge:peak=0.09,sigma=3.5
  frames     14
  within     95.45 %
  estimated  after so many frames 12: 94.59 %; 14: 95.15 % (first run)
  time       7.35 s
"""


@click.command("adapt", cls=Program, epilog=sample(SAMPLE))
@scene_option
@click.option(
    "--dent",
    "dents",
    multiple=True,
    metavar="NAME[:KEY=VALUE,...]",
    help="Again for more; default: six dents of different width, depth and shape.",
)
@click.option(
    "--goal",
    type=click.FloatRange(min=0, min_open=True),
    required=True,
    metavar="MM",
    help="Error that the height may have.",
)
@click.option(
    "--share",
    type=click.FloatRange(0, 1, min_open=True, max_open=True),
    default=0.95,
    show_default=True,
    help="Of the pixels that see the pattern: so many must be within the goal.",
)
@click.option(
    "--frames", type=click.IntRange(min=12), default=80, show_default=True, metavar="N", help="Most to show."
)
@click.option("--compare/--no-compare", default=True, help="Look for the best fixed sequence too (minutes).")
@click.option(
    "--seeds", type=click.IntRange(min=1), default=2, show_default=True, metavar="N", help="Runs per dent."
)
@noise_option(1.0)
@renderer_option
@size_option
@json_option
def command(
    scene_name: str,
    dents: tuple[str, ...],
    goal: float,
    share: float,
    frames: int,
    compare: bool,
    seeds: int,
    noise: float,
    renderer: str,
    size: tuple[int, int] | None,
    json_path: Path | None,
) -> None:
    """Choose frames from what was measured so far, virtually.

    It starts with the twelve fringes that do best on the mirror at rest, and stops when the share asked for
    is within the goal, or says why it cannot be; every dent is printed when it is done. Beside it stands the
    fixed sequence of fewest frames that meets the same goal on all dents, by the mean share of the seeds.
    """
    from ..design.adaptive import Goal
    from ..design.adaptive_study import AdaptiveRow, run_adaptive, study_dents

    scene = load_scene(scene_name, size)
    rows: list[AdaptiveRow] = []
    study = None
    table(f"Adaptive sensing: {scene.name}, {number(100 * share)} % within {goal:g} mm", {})
    with interrupted() as stopped, progress() as step:

        def told(row: AdaptiveRow) -> None:
            rows.append(row)
            with step.aside():
                print_notices(row.notices)
                table(row.dent, _told(row))
            write_json(json_path, {"rows": [asdict(row) for row in rows]})

        study = run_adaptive(
            scene,
            dents or study_dents(scene),
            Goal(goal, share, frames),
            noise=noise,
            seeds=seeds,
            compare=compare,
            renderer=renderer,
            progress=step,
            told=told,
        )
    if study is None or stopped.hit:
        raise KeyboardInterrupt
    write_json(json_path, study.to_dict())
    if study.fixed is not None:
        _compared(study)


def _told(row: "AdaptiveRow") -> dict[str, str]:
    steps = "; ".join(f"{at.frames}: {number(100 * at.within, '%')}" for at in row.steps)
    return {
        "frames": number(row.frames),
        "within": number(100 * row.within, "%"),
        "estimated": f"after so many frames {steps} (first run)",
        **({"not met": row.why} if row.why else {}),
        "time": number(row.seconds, "s"),
    }


def _compared(study: "AdaptiveStudy") -> None:
    """Table of both, and the fixed sequence."""
    fixed = study.fixed
    assert fixed is not None
    best = fixed.best
    frames = "-" if best is None else str(len(best.sequence))
    grid(
        "Beside the fixed sequence of fewest frames",
        ("dent", "adaptive", "within", "fixed", "within"),
        [
            [
                row.dent,
                number(row.frames),
                number(100 * row.within, "%"),
                frames,
                number(100 * row.fixed_within, "%"),
            ]
            for row in study.rows
        ],
    )
    looked = f"{fixed.offered} sequences, {fixed.simulated} of them simulated"
    times = ", ".join(f"{name} {number(value)}" for name, value in study.seconds.items())
    table(
        "In all",
        {
            "fixed sequence": "none within the frames" if best is None else best.text,
            "looked at": looked,
            "adaptive takes fewer": f"on {study.fewer} of {len(study.rows)} dents",
            "time": f"{times} s",
        },
    )
