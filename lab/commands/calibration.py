"""`python -m lab calibration`: what a calibration is worth, by simulated rigs.

$ python -m lab calibration --draws 3 --setup "prism, rest + 3 balls"
Dent less rest, relative to its depth
set-up                 draws  error  worst  scale  scale/sigma  chi2/r  r  chi  seconds  absolute  change
prism, rest + 3 balls  ...
"""

from dataclasses import asdict
from typing import Annotated

import click

from optolever.cli.arguments import Opt, program
from optolever.cli.options import Json, Seed
from optolever.cli.printing import grid, progress, write_json

__all__ = ["command"]

NUMBERS = ("error", "scale", "sigma_scale", "chi2", "chi", "modes", "seconds", "absolute", "change")
HEADS = (
    *("set-up", "draws", "error", "worst", "scale", "scale/sigma", "chi2/r", "r", "chi", "seconds"),
    *("absolute", "change"),
)


@program("calibration", __doc__)
def command(
    draws: Annotated[int, Opt("--draws N", "Rigs of each set-up.", click.IntRange(1))] = 12,
    setups: Annotated[tuple[str, ...], Opt("--setup NAME", "One of the set-ups; default: all.")] = (),
    seed: Seed = 0,
    json_path: Json = None,
) -> None:
    """Simulate rigs and tell what calibrating them is worth.

    Rigs with errors of their own are calibrated, a dent is measured with each. chi2 of the coefficients of
    the modes is 1 where the covariance is true (a map is one sample); so is the rms of error over total
    sigma, of absolute heights and of their change.
    """
    import numpy as np

    from optolever import InputError

    from ..calibration.figures import SETUPS, Figure, figures

    for name in setups:
        if name not in SETUPS:
            raise InputError(f"--setup {name}: unknown, must be one of {', '.join(SETUPS)}")
    found: list[Figure] = []
    rows = []
    with progress() as step:
        for name in setups or tuple(SETUPS):
            drawn: list[Figure] = []
            for each in figures(name, range(seed, seed + draws)):
                step(name, len(drawn), draws)
                drawn.append(each)
            found += drawn
            if not drawn:
                rows.append((name, "0", *["-"] * 10))
                continue
            column = {key: np.array([getattr(each, key) for each in drawn]) for key in NUMBERS}
            share = column["scale"] / column["sigma_scale"]
            cells = [np.median(column["error"]), column["error"].max(), np.abs(column["scale"]).max()]
            cells += [np.sqrt(np.mean(share**2)), column["chi2"].mean(), np.median(column["modes"])]
            cells += [column["chi"].max(), column["seconds"].max()]
            cells += [np.sqrt(np.mean(column[key] ** 2)) for key in ("absolute", "change")]
            rows.append((name, str(len(drawn)), *(f"{cell:.3g}" for cell in cells)))
    grid("Dent less rest, relative to its depth", HEADS, rows)
    write_json(json_path, {"figures": [asdict(each) for each in found]})
