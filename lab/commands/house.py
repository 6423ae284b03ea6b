"""`python -m lab house`: the source in figures, and the guard that keeps it light.

$ python -m lab house
Parts
part       files  code   limit  over  JS, GLSL
patterns   6      567    567          0
...
installed         28143  28143
Only to fall
number          now  limit  over
long_functions  6    6
"""

from dataclasses import asdict
from typing import Annotated

from optolever.cli.arguments import Opt, program
from optolever.cli.options import Json
from optolever.cli.printing import grid, write_json

__all__ = ["command"]


@program("house", __doc__)
def command(
    reason: Annotated[
        str | None, Opt("--accept REASON", "Make today's lines the limits, for this reason.")
    ] = None,
    json_path: Json = None,
) -> int:
    """Compare lines of code with the limits of house.toml; exit code 1 where the total exceeds its limit.

    A part above its limit is listed. Counts that may only fall: functions of more than 90 lines or 30
    branches, named numbers, repeated file names, commands, options of the largest, expected failures.
    --accept never raises these.
    """
    from ..figures.house import BESIDE, PARTS, accept, house, limits, over, ratchets

    rows, now = [house(part) for part in (*PARTS, *BESIDE)], ratchets()
    if reason is not None:
        accept(reason, rows, now)
    code, limit = {row.part: row.code for row in rows}, limits()
    total = {"installed": sum(code[part] for part in PARTS)}
    more, above = over(code | total, limit), over(now, limit)

    def line(name: str, count: int) -> list[str]:
        exceeds = (more | above).get(name)
        return [str(count), str(limit.get(name, "")), "" if exceeds is None else f"+{exceeds}"]

    parts = [[row.part, str(row.files), *line(row.part, row.code), str(row.scripts)] for row in rows]
    sums = ["installed", "", *line("installed", total["installed"]), ""]
    grid("Parts", ("part", "files", "code", "limit", "over", "JS, GLSL"), [*parts, sums])
    grid("Only to fall", ("number", "now", "limit", "over"), [[name, *line(name, now[name])] for name in now])
    write_json(json_path, {"parts": [asdict(row) for row in rows], "installed": total, "over": more | above})
    return int("installed" in more or bool(above))
