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
part       files  lines  at most  JS, GLSL  constants
patterns   6      963    1000     0         7
installed         963    38000
"""
HEADER = ("part", "files", "lines", "at most", "JS, GLSL", "constants")


@program("house", SAMPLE)
def command(
    parts: Annotated[tuple[str, ...], Opt("--part NAME", "Only this one; again for more.")] = (),
    json_path: Json = None,
) -> None:
    """Count lines of the installed parts, lab and tests beside their limits.

    constants: numbers named at a module's top.
    """
    from ..figures.house import BESIDE, PARTS, ROOT, house, total

    rows = [house(part) for part in parts or (*PARTS, *BESIDE) if (ROOT / part).is_dir()]
    installed = total(rows)
    lines = [
        [*map(str, (row.part, row.files, row.lines, row.limit or "", row.scripts, row.constants))]
        for row in rows
    ]
    sums = ["installed", "", str(installed["lines"]), str(installed["limit"]), "", ""]
    grid("Parts", HEADER, [*lines, sums])
    write_json(json_path, {"parts": [asdict(row) for row in rows], "installed": installed})
