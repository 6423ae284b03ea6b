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


DECODE = Opt(
    "--decode", "The decoder's time beside memory's, `fringes` and OpenCV, on the same frames, instead."
)
RECONSTRUCT = Opt("--reconstruct", "The reconstructor's time beside that of cosine transforms, instead.")
PAGE = Opt(
    "--page PART",
    "Measure a part of docs/benchmarks.md and write it there, instead: codes (and charts), decode, heights, "
    "live, batch. Repeatable.",
    click.Choice(["codes", "decode", "heights", "live", "batch"]),
)


@program("figures", __doc__)
def command(
    seeds: Annotated[int, Opt("--seeds N", "Runs of the mean over seeds.", click.IntRange(1))] = 30,
    only_decode: Annotated[bool, DECODE] = False,
    only_reconstruct: Annotated[bool, RECONSTRUCT] = False,
    page: Annotated[tuple[str, ...], PAGE] = (),
    size: Size = None,
    json_path: Json = None,
) -> None:
    """Measure errors and speed, each beside its limit.

    The demo with and without blur, error bars over many seeds, and many captures by two processes. --pixels
    resamples the demo alone (with --decode: it is the frames' size, 1920x1080 if not given).
    """
    from ..figures.batch import batch_figures
    from ..figures.decode_speed import run_decode_figures
    from ..figures.figures import run_figures
    from ..figures.house import ROOT
    from ..figures.solver_figures import run_solver_times

    if page:
        from ..figures.page import write_page

        with progress() as step:
            path = write_page(ROOT / "docs", page, step)
        click.echo(f"Written: {path}")
        return
    if only_decode and only_reconstruct:
        raise click.UsageError("--decode and --reconstruct: one at a time")
    if only_reconstruct and size is not None:
        raise click.UsageError("--pixels: the reconstructor's figures have their own sizes")
    with progress() as step:
        if only_reconstruct:
            figures = run_solver_times()
        elif only_decode:
            figures = run_decode_figures(size=size or (1080, 1920), progress=step)
        else:
            figures = [*run_figures(seeds=seeds, size=size, progress=step), *batch_figures()]
    write_json(json_path, {"figures": [asdict(figure) | {"met": figure.met} for figure in figures]})
    rows = []
    for figure in figures:
        note = figure.note if figure.met else f"NOT MET; {figure.note}".rstrip("; ")
        rows.append((figure.name, number(figure.value, figure.unit), figure.limits(), note))
    grid("Figures", ("figure", "measured", "limit", ""), rows)
