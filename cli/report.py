"""`optolever report`: a page from saved records."""

from pathlib import Path

import click

from optolever import InputError

from .arguments import FILE, sample
from .options import blame, json_option, load_scene, preset_option, report_option, rest_option
from .outputs import Program
from .show import budget_rows, grid, noise_and_rig, number, print_notices, table, write_json

__all__ = ["command"]

SAMPLE = """
$ optolever report h.npz --correspondence c.npz --capture capture \\
      --scene capture/scene.toml --out report
Report of h.npz: simulated, geometry known
  good   98.83 % of the pixels
  sigma  ± 39 nm noise (medians)
  page   report/report.html
"""


@click.command("report", cls=Program, epilog=sample(SAMPLE))
@click.argument("source", type=FILE, metavar="H.npz")
@click.option(
    "--correspondence", type=FILE, metavar="C.npz", help="File of decode: adds maps of u and v, and slopes."
)
@click.option("--capture", "folder", type=FILE, metavar="DIR", help="Capture folder: adds its frames.")
@rest_option("slopes and dents are those less rest, as in reconstruct")
@preset_option(text=": adds its drawing, areas, slopes and dents")
@click.option(
    "--remove",
    "form",
    metavar="FORM[:NUMBER=VALUE,...]",
    help="Form to subtract from the heights, as in `form`, or none; default: a sphere for a mirror in open "
    "air, else none.",
)
@click.option(
    "--less",
    type=FILE,
    multiple=True,
    metavar="H.npz",
    help="Height map of the same rig: the difference and its uncertainty; again for more.",
)
@report_option(
    "report",
    "Gets report.html and the data behind it.",
    *("report.html", "figures.csv", "height.npz"),
)
@json_option
def command(
    source: Path,
    correspondence: Path | None,
    folder: Path | None,
    rest_path: Path | None,
    scene_name: str | None,
    form: str | None,
    less: tuple[Path, ...],
    out: Path,
    json_path: Path | None,
) -> None:
    """Write a page from saved records: heights, error bars, flags.

    H.npz is a file of reconstruct. DIR/report.html is the page of demo, without the comparison with the
    truth. The full data (.npz) and every number of the page (figures.csv) are in the same folder.
    """
    import numpy as np

    from optolever.decode import Correspondence
    from optolever.experiments import Measurement, write_measurement_report
    from optolever.files import report_folder, together
    from optolever.projector import Capture
    from optolever.reconstruct import HeightMap, budget

    if rest_path is not None and (correspondence is None or scene_name is None):
        raise InputError(f"--rest {rest_path}: needs --correspondence and --scene")
    height = HeightMap.load(source)
    paths = (source, *less)
    stems = [path.stem for path in paths]
    name, *names = stems if len(set(stems)) == len(paths) else [str(path) for path in paths]
    others = {each: HeightMap.load(path) for each, path in zip(names, less, strict=True)}
    given = Measurement(
        height,
        None if correspondence is None else Correspondence.load(correspondence),
        None if folder is None else Capture.load(folder),
        None if scene_name is None else load_scene(scene_name, height.z.shape),
        source=str(source),
        name=name,
        rig=scene_name or "",
        simulated=folder is not None and (folder / "truth.npz").is_file(),
        form="" if form == "none" else form,
        less=others,
        rest=None if rest_path is None else Correspondence.load(rest_path),
    )
    good = height.good
    total, noise, rig = (
        float(np.median(sigma[good])) if good.any() else float("nan")
        for sigma in (height.total_sigma, height.sigma, height.calibration_sigma)
    )
    with blame(source):
        readings = budget(height, next(iter(others.values()), None))
        with report_folder(out), together():
            write_measurement_report(out / "report.html", given)
            uncertainty = given.readings
            numbers = {"good_share": float(good.mean()), "sigma_mm": total, "noise_mm": noise, "rig_mm": rig}
            write_json(json_path, numbers | {"budget_mm": readings})
    print_notices(given.notices)
    table(
        f"Report of {source}: {given.provenance}",
        {
            "good": number(100 * good.mean(), "% of the pixels"),
            "sigma": f"{noise_and_rig(noise, rig)} (medians)",
            "page": str(out / "report.html"),
        },
    )
    if uncertainty:
        grid("Uncertainty by source", *budget_rows(uncertainty))
