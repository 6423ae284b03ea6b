"""`python -m lab figures`: figures beside their limits, measured here and now.

$ python -m lab figures --pixels 256x256
Figures
figure                                measured  limit
...
demo, unflagged                       97.63 %   at least 95
demo, rms(error / sigma) of u         0.915     at least 0.9, at most 1.1
...
"""

from dataclasses import asdict
from typing import Annotated

import click

from optolever.cli.arguments import Opt, program
from optolever.cli.options import Json, Size
from optolever.cli.printing import grid, number, progress, write_json

__all__ = ["command"]


PAGE = Opt(
    "--page PART",
    "Measure a part of docs/benchmarks.md and write it there, instead: codes (and charts), decode, heights, "
    "live, batch. Repeatable.",
    click.Choice(["codes", "decode", "heights", "live", "batch"]),
)


@program("figures", __doc__)
def command(
    seeds: Annotated[int, Opt("--seeds N", "Runs of the mean over seeds.", click.IntRange(1))] = 30,
    page: Annotated[tuple[str, ...], PAGE] = (),
    size: Size = None,
    json_path: Json = None,
) -> None:
    """Measure errors and speed, each beside its limit.

    The demo with and without blur, and error bars over many seeds. --pixels resamples the demo alone.
    """
    from ..figures.figures import run_figures
    from ..figures.house import ROOT

    if page:
        from ..figures.page import write_page

        with progress() as step:
            path = write_page(ROOT / "docs", page, step)
        click.echo(f"Written: {path}")
        return
    with progress() as step:
        figures = run_figures(seeds=seeds, size=size, progress=step)
    write_json(json_path, {"figures": [asdict(figure) | {"met": figure.met} for figure in figures]})
    rows = []
    for figure in figures:
        note = figure.note if figure.met else f"NOT MET; {figure.note}".rstrip("; ")
        rows.append((figure.name, number(figure.value, figure.unit), figure.limits(), note))
    grid("Figures", ("figure", "measured", "limit", ""), rows)
