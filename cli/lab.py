"""`optolever lab`: commands for those who work on the program itself."""

import tempfile
from collections import Counter
from pathlib import Path

import click

from .options import json_option, sample
from .outputs import Program
from .show import grid, progress, table, write_json

__all__ = ["command"]

SAMPLE = """
$ optolever lab fuzz --cases 100 --seed 1
Damaged inputs
kind       cases  results  refused  faults
arguments  9      2        7        0
...
"""


@click.group("lab")
def command() -> None:
    """The laboratory: attacks on the program itself."""


@command.command("fuzz", cls=Program, epilog=sample(SAMPLE))
@click.option("--cases", type=click.IntRange(1), default=1000, show_default=True, metavar="N")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The first one's number.")
@json_option
def fuzz_command(cases: int, seed: int, json_path: Path | None) -> int:
    """Damage inputs of every kind at random and run the program on them, in this process.

    Each must end with 0 and a result that holds, or with 2, one line and no result, within 30 s and 4 GiB.
    Exit code 1 if one does not.
    """
    from optolever.experiments import FUZZED, fuzz

    from .app import run

    ended: Counter[tuple[str, str]] = Counter()
    faults = []
    with tempfile.TemporaryDirectory() as folder, progress() as step:
        for done, outcome in enumerate(fuzz(run, cases, seed, Path(folder))):
            step("cases", done, cases)
            ended[
                outcome.kind, "faults" if outcome.fault else ("results", "", "refused")[outcome.code or 0]
            ] += 1
            if outcome.fault:
                faults.append(outcome)
    columns = ("results", "refused", "faults")
    rows = [(kind, *(str(ended[kind, name]) for name in columns)) for kind in FUZZED]
    grid("Damaged inputs", ("kind", *columns), rows)
    for outcome in faults:
        last = outcome.fault.strip().splitlines()[-1]
        click.echo(f"case {outcome.number}, {outcome.kind}: {last}\n  {' '.join(outcome.args)}")
    table("Verdict", {"faults": f"{len(faults)} of {cases}"})
    if json_path is not None:
        write_json(
            json_path, {"cases": cases, "seed": seed, "faults": [outcome.number for outcome in faults]}
        )
    return 1 if faults else 0


CALIBRATION = """
$ optolever lab calibration --draws 3 --setup "prism, rest + 3 balls"
Dent less rest, relative to its depth
set-up                 draws  error  worst  scale  scale/sigma  chi2/r  r  chi
prism, rest + 3 balls  ...
"""


@command.command("calibration", cls=Program, epilog=sample(CALIBRATION))
@click.option("--draws", type=click.IntRange(1), default=12, show_default=True, metavar="N")
@click.option("--setup", "setups", multiple=True, metavar="NAME", help="One of the set-ups; default: all.")
@click.option("--rendered", is_flag=True, help="Rendered frames with a noise of one level, decoded.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The first one's number.")
@json_option
def calibration_command(
    draws: int, setups: tuple[str, ...], rendered: bool, seed: int, json_path: Path | None
) -> None:
    """What a calibration is worth: rigs with errors of their own, calibrated, a dent measured with each.

    chi2 of the coefficients of the modes is 1 where the covariance is true (a map is one sample).
    """
    import numpy as np

    from optolever import InputError
    from optolever.calibration import SETUPS, Figure, figures

    for name in setups:
        if name not in SETUPS:
            raise InputError(f"--setup {name}: unknown, must be one of {', '.join(SETUPS)}")
    found: list[Figure] = []
    rows = []
    with progress() as step:
        for name in setups or tuple(SETUPS):
            drawn: list[Figure] = []
            for each in figures(name, range(seed, seed + draws), rendered):
                step(name, len(drawn), draws)
                drawn.append(each)
            found += drawn
            if not drawn:
                rows.append((name, "0", *["-"] * 7))
                continue
            column = {
                key: np.array([getattr(each, key) for each in drawn])
                for key in ("error", "scale", "sigma_scale", "chi2", "chi", "modes")
            }
            share = column["scale"] / column["sigma_scale"]
            cells = [np.median(column["error"]), column["error"].max(), np.abs(column["scale"]).max()]
            cells += [np.sqrt(np.mean(share**2)), column["chi2"].mean(), np.median(column["modes"])]
            rows.append(
                (name, str(len(drawn)), *(f"{cell:.3g}" for cell in cells), f"{column['chi'].max():.3g}")
            )
    heads = ("set-up", "draws", "error", "worst", "scale", "scale/sigma", "chi2/r", "r", "chi")
    grid("Dent less rest, relative to its depth", heads, rows)
    if json_path is not None:
        write_json(json_path, {"figures": [each.to_dict() for each in found]})
