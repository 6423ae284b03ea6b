"""`python -m lab house`: the source in figures."""

from dataclasses import asdict
from typing import Annotated

from optolever.cli.arguments import Opt, program
from optolever.cli.options import Json
from optolever.cli.show import grid, write_json

__all__ = ["command"]

SAMPLE = """
$ python -m lab house --part patterns
Parts
part       files  lines  at most  JS, GLSL  private words  Any  wide  constants
patterns   6      1016   1000     0         0.0 in 100     5    0     3
installed         1016   38000
"""
HEADER = ("part", "files", "lines", "at most", "JS, GLSL", "private words", "Any", "wide", "constants")


@program("house", SAMPLE)
def command(
    parts: Annotated[tuple[str, ...], Opt("--part NAME", "Only this one; again for more.")] = (),
    json_path: Json = None,
) -> None:
    """Count lines of the installed parts, lab and tests beside their limits, private words, types, constants.

    private words: of the project's own dialect (STYLE.md), per 100 words of docstrings and comments; Any:
    parameters typed so; wide: functions of more than 8 parameters, kernels apart; constants: numbers named
    at a module's top.
    """
    from ..figures.house import BESIDE, PARTS, ROOT, house, total

    rows = [house(part) for part in parts or (*PARTS, *BESIDE) if (ROOT / part).is_dir()]
    installed = total(rows)
    lines = [
        [
            *map(str, (row.part, row.files, row.lines, row.limit or "", row.scripts)),
            f"{row.private_words:.1f} in 100",
            *map(str, (row.any_parameters, row.wide_functions, row.constants)),
        ]
        for row in rows
    ]
    sums = ["installed", "", str(installed["lines"]), str(installed["limit"]), *[""] * 5]
    grid("Parts", HEADER, [*lines, sums])
    write_json(json_path, {"parts": [asdict(row) for row in rows], "installed": installed})
