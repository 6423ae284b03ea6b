"""`python -m lab rigs`: heights of rigs that are not as typed, against their total sigma.

$ python -m lab rigs --draws 5
Rigs off by draws of their priors
kind         capture  runs  error   total sigma  error/sigma  worst  beyond  notices  refused  silent
camera pose  alone    5     ...
"""

from dataclasses import asdict
from typing import Annotated

import click

from optolever.cli.arguments import AT_LEAST_0, Opt, program
from optolever.cli.options import Json, Seed
from optolever.cli.printing import grid, length, progress, write_json

__all__ = ["command"]

HEADS = (
    *("kind", "capture", "runs", "error", "total sigma", "error/sigma", "worst", "beyond"),
    *("notices", "refused", "silent"),
)


@program("rigs", __doc__)
def command(
    draws: Annotated[int, Opt("--draws N", "Of every kind.", click.IntRange(1))] = 5,
    chosen: Annotated[tuple[str, ...], Opt("--kind NAME", "Kinds of errors; default: all.")] = (),
    times: Annotated[float, Opt("--times FACTOR", "Of the priors.", AT_LEAST_0)] = 1.0,
    seed: Seed = 0,
    json_path: Json = None,
) -> None:
    """Draw rigs from the priors of typed numbers and compare heights with their total sigma.

    Medians of the heights' error and of total sigma; error/sigma: rms, median over runs and worst run;
    beyond: largest share of heights beyond five total sigma; silent: runs with more than 1 % of them and no
    notice.
    """
    import numpy as np

    from optolever import InputError

    from ..calibration.typed import KINDS, typed_runs

    for name in chosen:
        if name not in KINDS:
            raise InputError(f"--kind {name}: unknown, must be one of {', '.join(KINDS)}")
    kinds = chosen or tuple(KINDS)
    with progress() as step:
        runs = []
        for run in typed_runs(kinds, range(seed, seed + draws), times):
            runs.append(run)
            step(run.kind, len(runs), 2 * draws * len(kinds))
    rows = []
    for kind in kinds:
        for rest in (False, True):
            some = [run for run in runs if run.kind == kind and run.rest is rest]
            ratios = [run.ratio for run in some]
            cells = (
                length(float(np.nanmedian([run.error for run in some]))),
                length(float(np.nanmedian([run.sigma for run in some]))),
                f"{np.nanmedian(ratios):.2f}",
                f"{np.nanmax(ratios):.2f}",
                f"{max(run.beyond for run in some):.2%}",
                str(sum(bool(run.named) for run in some)),
                str(sum(run.refused for run in some)),
                str(sum(run.silent for run in some)),
            )
            rows.append((kind, "against rest" if rest else "alone", str(len(some)), *cells))
    grid("Rigs off by draws of their priors", HEADS, rows)
    write_json(json_path, {"runs": [asdict(run) for run in runs]})
