"""`python -m lab folders`: folders of pictures with one fault or none, as `optolever decode` reads them."""

from pathlib import Path

import click

from optolever.cli.options import json_option, sample
from optolever.cli.outputs import Program
from optolever.cli.show import grid, progress, table, write_json

__all__ = ["command"]

SAMPLE = """
$ python -m lab folders --every
Folders of other programs' pictures
number  fault           code   good   silent  verdict        told
0       order reversed  phase  0.00%  0.00%   named rightly  the frames are there in reverse order
"""


SHOWN = 110  # letters of a notice in the table


@click.command("folders", cls=Program, epilog=sample(SAMPLE))
@click.option("--faulty", type=click.IntRange(0), default=60, show_default=True, metavar="N")
@click.option(
    "--plain", type=click.IntRange(0), default=30, show_default=True, metavar="N", help="Without a fault."
)
@click.option("--every", is_flag=True, help="A row for every folder.")
@json_option
def command(faulty: int, plain: int, every: bool, json_path: Path | None) -> None:
    """Decode folders of pictures, drawn with one fault each or none, and compare with rays.

    A row for each fault that is not named rightly, and each alarm without a fault: shares of the lit pixels
    that are good, and good and off by more than 5 sigma, and what the notices or the error say.
    """
    from dataclasses import asdict
    from tempfile import TemporaryDirectory

    from ..folders import FAULTS, SILENT, drawn_folder, judged

    kinds, found = list(FAULTS), []
    asked = [(i // len(kinds), kinds[i % len(kinds)]) for i in range(faulty)] + [
        (i, "") for i in range(plain)
    ]
    with progress(lines=True) as step:
        for number, fault in asked:
            with TemporaryDirectory() as place:
                found.append(judged(drawn_folder(number, fault), Path(place)))
            step(f"{fault or 'no fault'} {number}", len(found), len(asked))
    rows = [
        (
            str(one.number),
            one.fault,
            one.code,
            f"{one.good:.2%}",
            f"{one.silent:.2%}",
            one.verdict,
            "; ".join(one.told)[:SHOWN],
        )
        for one in found
        if every or one.verdict != ("named rightly" if one.fault else "within 5 sigma")
    ]
    heads = ("number", "fault", "code", "good", "silent", "verdict", "told")
    grid("Folders of other programs' pictures", heads, rows)
    counts = [(("no fault", "fault")[bool(one.fault)], one.verdict) for one in found]
    named = [one.named == "rightly" for one in found if one.fault and one.named]
    table(
        "Verdict",
        {f"{fault}: {verdict}": str(counts.count((fault, verdict))) for fault, verdict in sorted({*counts})}
        | {"causes named": f"{len(named)}, {sum(named) / max(len(named), 1):.0%} of them rightly"}
        | {f"over {SILENT:.0%} beyond 5 sigma": str(sum(one.silent > SILENT for one in found))},
    )
    write_json(json_path, {"folders": [asdict(one) | {"verdict": one.verdict} for one in found]})
