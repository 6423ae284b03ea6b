"""`python -m lab judgements`: every test of the program, its false alarms and its misses.

$ python -m lab judgements --part heights --seeds 2
False alarms on right captures
part     test        limit  right captures  false alarms  of kind
heights  moved       0.02   18              0
...
Faults that no test names
part     fault                  named by  wrong captures  missed
heights  camera moved by .2 px  moved     2               0
"""

from collections.abc import Callable
from dataclasses import asdict
from typing import Annotated, Literal

import click

from optolever.cli.arguments import Opt, program
from optolever.cli.options import Json
from optolever.cli.printing import grid, progress, write_json

__all__ = ["command"]


@program("judgements", __doc__)
def command(
    seeds: Annotated[int, Opt("--seeds N", "Captures of every kind.", click.IntRange(1))] = 3,
    part: Annotated[
        Literal["decode", "heights", "all"],
        Opt("--part decode|heights|all", "One part, or all."),
    ] = "all",
    page: Annotated[bool, Opt("--page", "Write the tables into docs/benchmarks.md, too.")] = False,
    json_path: Json = None,
) -> None:
    """Count, for every test, right captures that it refuses or names, and wrong ones that it misses.

    Captures are drawn, right ones of many kinds and wrong ones by kind of fault; a fault counts where the
    result is wrong.
    """
    from ..figures.house import ROOT
    from ..judgements import decode, heights
    from ..judgements.record import FALSE_HEADS, MISSED_HEADS, Row, false_alarms, misses, with_section

    parts: dict[str, Callable[[int], list[Row]]] = {"decode": decode.rows, "heights": heights.rows}
    with progress() as step:
        step(f"part {part}")
        chosen = parts.values() if part == "all" else [parts[part]]
        rows = [row for some in chosen for row in some(seeds)]
    grid("False alarms on right captures", FALSE_HEADS, false_alarms(rows))
    grid("Faults that no test names", MISSED_HEADS, misses(rows))
    if page:
        command = f"python -m lab judgements --seeds {seeds} --part PART"
        with_section(ROOT / "docs" / "benchmarks.md", rows, command)
    write_json(json_path, {"rows": [asdict(row) for row in rows]})
