"""`optolever report`: a page from saved records.

$ optolever report h.npz --correspondence c.npz --scene capture/scene.toml --out report
Report of h.npz: simulated, geometry known
  good   98.83 % of the pixels
  sigma  ± 39 nm noise (medians)
  page   report/report.html
"""

from pathlib import Path
from typing import Annotated

import optolever as ol
from optolever import InputError

from .arguments import ABOVE_0, Arg, Opt, program
from .options import Full, Json, blame, load_scene, preset, rest_file
from .outputs import PAGE, PAGE_IN_FULL, ReportFolder
from .printing import medians, noise_and_rig, number, print_notices, table, write_json

CORRESPONDENCE = Opt("--correspondence C.npz", "File of decode: adds maps of u and v, and slopes.")
REST = rest_file("slopes and dents are those less rest, as in reconstruct")
REMOVE = Opt(
    "--remove FORM[:NUMBER=VALUE,...]",
    "Form to subtract, as in `form`, or none; default: a sphere for a mirror in open air, else none.",
)
LESS = Opt("--less H.npz", "Height map of the same rig: the difference and its uncertainty; again for more.")
APERTURE = Opt("--aperture SHAPE|MASK.png", "Of the form and its deviation, as in `form`; again for more.")
WAVES = Opt("--waves NM", "Also the deviation as a reflected wavefront in waves of this length.", ABOVE_0)
FILES = ReportFolder(*PAGE, full=PAGE_IN_FULL)


@program("report", __doc__)
def command(
    source: Annotated[Path, Arg("H.npz")],
    correspondence: Annotated[Path | None, CORRESPONDENCE] = None,
    rest_path: Annotated[Path | None, REST] = None,
    scene_name: Annotated[str | None, preset(": adds its drawing, areas, slopes and dents")] = None,
    form: Annotated[str | None, REMOVE] = None,
    apertures: Annotated[tuple[str, ...], APERTURE] = (),
    waves: Annotated[float | None, WAVES] = None,
    less: Annotated[tuple[Path, ...], LESS] = (),
    out: Annotated[Path, Opt("--out DIR", "Gets report.html and its data.", FILES)] = Path("out/report"),
    full: Full = False,
    json_path: Json = None,
) -> None:
    """Write a page from saved records: heights, error bars, flags.

    H.npz is a file of reconstruct. DIR/report.html is the page of demo, without the comparison with the
    truth. The heights (height.npz) and every number of the page (figures.csv) are in the same folder.
    """
    if rest_path is not None and (correspondence is None or scene_name is None):
        raise InputError(f"--rest {rest_path}: needs --correspondence and --scene")
    height = ol.reconstruct.HeightMap.load(source)
    paths, size = (source, *less), height.z.shape
    stems = [path.stem for path in paths]
    name, *names = stems if len(set(stems)) == len(paths) else [str(path) for path in paths]
    others = {each: ol.reconstruct.HeightMap.load(path) for each, path in zip(names, less, strict=True)}
    for path, other in zip(less, others.values(), strict=True):
        if other == height:
            raise InputError(f"--less {path}: is the map {source} itself; give another map of the rig")
    given = ol.samples.Measurement(
        height, None if correspondence is None else ol.decode.Correspondence.load(correspondence),
        None if scene_name is None else load_scene(scene_name, None if Path(scene_name).exists() else size),
        source=str(source), name=name, rig=scene_name or "",
        form="" if form == "none" else form, less=others, apertures=apertures, waves=waves, apart=True,
        rest=None if rest_path is None else ol.decode.Correspondence.load(rest_path),
    )  # fmt: skip
    total, noise, rig = medians(height.good, height.total_sigma, height.sigma, height.calibration_sigma)
    shares = {"good_share": float(height.good.mean()), "sigma_mm": total, "noise_mm": noise, "rig_mm": rig}
    with blame(source):
        readings = ol.reconstruct.budget(height, next(iter(others.values()), None))
        with ol.files.together():
            ol.report.write_measurement_report(out / "report.html", given, full=full)
            write_json(json_path, shares | {"budget_mm": readings})
    print_notices(one for one in given.notices if one not in height.notices)
    rows = {
        "good": number(100 * shares["good_share"], "% of the pixels"),
        "sigma": f"{noise_and_rig(noise, rig)} (medians)",
        "page": str(out / "report.html"),
    }
    table(f"Report of {source}: {given.provenance}", rows)
