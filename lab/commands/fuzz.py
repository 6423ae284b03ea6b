"""`python -m lab fuzz`: damaged inputs of every kind, by number.

$ python -m lab fuzz --cases 100 --seed 1
Damaged inputs
kind       results  refused  faults
scene      5        6        0
...
"""

import tempfile
from collections import Counter
from pathlib import Path
from typing import Annotated

import click

from optolever.cli.arguments import Opt, program
from optolever.cli.options import Json, Seed
from optolever.cli.printing import grid, number, progress, table, write_json

__all__ = ["command"]


@program("fuzz", __doc__)
def command(
    cases: Annotated[int, Opt("--cases N", "Number of them.", click.IntRange(1))] = 1000,
    seed: Seed = 0,
    first: Annotated[int, Opt("--first N", "The first case's number.", click.IntRange(0))] = 0,
    json_path: Json = None,
) -> int:
    """Run the program on damaged inputs of every kind.

    Each must end with 0 and a result that holds, or with 2, one line and no result, within 30 s and 4 GiB.
    Exit code 1 if one does not.
    """
    from optolever.cli.app import app, run

    from ..fuzz.fuzz import FUZZED, fuzz

    ended: Counter[tuple[str, str]] = Counter()
    faults, slowest, largest = [], 0.0, 0
    with tempfile.TemporaryDirectory() as folder, progress() as step:
        for done, outcome in enumerate(fuzz(run, app, cases, seed, first, Path(folder))):
            step("cases", done, cases)
            how = "faults" if outcome.fault else ("results", "", "refused")[outcome.code or 0]
            ended[outcome.kind, how] += 1
            slowest, largest = max(slowest, outcome.seconds), max(largest, outcome.bytes)
            if outcome.fault:
                faults.append(outcome)
    columns = ("results", "refused", "faults")
    rows = [(kind, *(str(ended[kind, name]) for name in columns)) for kind in FUZZED]
    grid("Damaged inputs", ("kind", *columns), rows)
    for outcome in faults:
        last = outcome.fault.strip().splitlines()[-1]
        click.echo(f"--seed {seed} --first {outcome.number}, {outcome.kind}: {last}")
        click.echo(f"  {' '.join(outcome.args)}")
    verdict = {"faults": f"{len(faults)} of {cases}", "slowest": number(slowest, "s")}
    table("Verdict", verdict | {"memory": number(largest / 2**30, "GiB (the most of one case)")})
    if json_path is not None:
        found = {"seconds": slowest, "bytes": largest, "faults": [outcome.number for outcome in faults]}
        write_json(json_path, {"cases": cases, "seed": seed, "first": first} | found)
    return 1 if faults else 0
