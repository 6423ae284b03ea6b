"""`optolever report`: a page from saved records."""

from pathlib import Path

import click

from .options import FILE, json_option, sample
from .outputs import Program, report_option
from .show import budget_rows, grid, noise_and_rig, number, print_notices, table, write_json

__all__ = ["command"]

SAMPLE = """
$ optolever report h.npz --correspondence c.npz --capture capture --out report
Report of h.npz
  good   98.83 % of the pixels
  sigma  ± 39 nm noise (medians)
  page   report/report.html
"""


@click.command("report", cls=Program, epilog=sample(SAMPLE))
@click.argument("source", type=FILE, metavar="H.npz")
@click.option("--correspondence", type=FILE, metavar="C.npz", help="What decode wrote: adds maps of u and v.")
@click.option("--capture", "folder", type=FILE, metavar="DIR", help="Capture folder: adds its frames.")
@click.option(
    "--less", type=FILE, metavar="H.npz", help="Height map of the same rig: uncertainty of the difference."
)
@report_option("report", "Gets report.html.", "report.html")
@json_option
def command(
    source: Path,
    correspondence: Path | None,
    folder: Path | None,
    less: Path | None,
    out: Path,
    json_path: Path | None,
) -> None:
    """Write a page from saved records: height, error bars, flags.

    H.npz is what reconstruct wrote. DIR/report.html is one self-contained page, as the one of demo, without
    what only a simulation knows.
    """
    import numpy as np

    from optolever.decode import Correspondence
    from optolever.experiments import write_record_report
    from optolever.files import report_folder, together
    from optolever.projector import Capture
    from optolever.reconstruct import HeightMap, budget

    height = HeightMap.load(source)
    seen = None if correspondence is None else Correspondence.load(correspondence)
    capture = None if folder is None else Capture.load(folder)
    other = None if less is None else HeightMap.load(less)
    good = height.good
    total, noise, rig = (
        float(np.median(sigma[good])) if good.any() else float("nan")
        for sigma in (height.total_sigma, height.sigma, height.calibration_sigma)
    )
    readings = budget(height, other)
    with report_folder(out), together():
        write_record_report(out / "report.html", height, seen, capture, str(source), other)
        numbers = {"good_share": float(good.mean()), "sigma_mm": total, "noise_mm": noise, "rig_mm": rig}
        write_json(json_path, numbers | {"budget_mm": readings})
    print_notices(height.notices)
    table(
        f"Report of {source}",
        {
            "good": number(100 * good.mean(), "% of the pixels"),
            "sigma": f"{noise_and_rig(noise, rig)} (medians)",
            "page": str(out / "report.html"),
        },
    )
    if readings:
        grid("Uncertainty by source", *budget_rows(readings))
