"""`optolever paper`: the tables of Saga, Kajimoto and Tachi, redone."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from .arguments import sample
from .options import json_option, noise_option, renderer_option, report_option, seed_option, size_option
from .outputs import Program
from .show import grid, number, print_notices, progress, table, write_json

if TYPE_CHECKING:
    from optolever.experiments import PaperRow

__all__ = ["command"]

SAMPLE = """
$ optolever paper --out paper
Errors in % of the peak depth
case    data    light       method   equations               drops  rises  mean
smooth  exact   print       lattice  printed sign, gamma kept  3.29   3.47  0.297
smooth  exact   reflection  pixels   true sign, gamma kept    0.127    3.7   1.88
...
"""

HEADER = ("case", "data", "light", "method", "equations", "drops", "rises", "mean", "peak", "field")


@click.command("paper", cls=Program, epilog=sample(SAMPLE))
@noise_option(1.0)
@seed_option
@renderer_option
@size_option
@report_option("paper", "Gets report.html.", "report.html")
@json_option
def command(
    noise: float,
    seed: int,
    renderer: str,
    size: tuple[int, int] | None,
    out: Path,
    json_path: Path | None,
) -> None:
    """Redo Saga, Kajimoto and Tachi's simulation and experiment.

    Smooth and needle dent, and a pencil's tip. By the paper's recursion on lattice points and on every pixel,
    as printed and with the reflection law's sign, and by the dense solver; from exact correspondences and
    from rendered, noisy 8-bit frames. Errors are rms over the peak depth, along the line through the dent's
    middle; field: over all pixels.
    """
    from optolever.experiments import run_paper, write_paper_report
    from optolever.files import report_folder, together

    with progress() as step:
        study = run_paper(noise=noise, seed=seed, size=size, renderer=renderer, progress=step)
        step("report")
        with report_folder(out), together():
            study = write_paper_report(study, out / "report.html")
            write_json(json_path, study.to_dict())
    print_notices(study.notices)
    grid("Errors in % of the peak depth", HEADER, [_cells(row) for row in study.rows])
    table(
        "Run",
        {
            "time": number(study.seconds["total"], "s"),
            "peak memory": number(study.peak_bytes / 2**30, "GiB"),
            "report": str(out / "report.html"),
        },
    )


def _cells(row: "PaperRow") -> list[str]:
    if row.sign is None:
        equations = ""
    else:
        equations = f"{'true' if row.sign == 1 else 'printed'} sign, gamma {'kept' if row.gamma else '0'}"
    shares = (row.drops, row.rises, row.mean, row.peak, row.field)
    return [row.case, row.data, row.law, row.method, equations, *map(_percent, shares)]


def _percent(share: float | None) -> str:
    return "" if share is None else f"{100 * share:.3g}"
