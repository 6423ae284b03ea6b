"""`optolever reconstruct`: a correspondence and a scene to a height map.

$ optolever reconstruct c.npz --scene capture/scene.toml \\
      --truth capture/truth.npz --contacts --out h.npz
Height map in h.npz
  good                98.03 % of the pixels
  height              −0.006196 to 1.3 mm
  sigma               ± 90 nm noise (medians)
  off_pattern         1.973 %
  error               0.0002127 of the peak depth, rms
  rms(error / sigma)  0.9885
  contact             depth 1.29999 ± 0.00019 mm at (81.85, 81.85) mm
  force               unknown: the scene has no [layer] with youngs_modulus_mpa
"""

import re
import time
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import optolever as ol
from optolever import InputError

from .arguments import Arg, Opt, program
from .facets import OfFacets
from .options import (
    Anchor,
    Json,
    NoRest,
    SceneName,
    Size,
    blame,
    load_scene,
    rest_file,
    sections,
)
from .outputs import HDF5, OutputFile
from .printing import (
    budget_rows,
    contact_rows,
    flag_rows,
    flag_shares,
    grid,
    height_range,
    length,
    medians,
    noise_and_rig,
    number,
    print_notices,
    progress,
    table,
    write_json,
)


def _sofast_files(scene: str) -> list[str]:
    """Files of SOFAST that make up the scene, a facet's name the last; none where it is another."""
    commas = r"(?i)(?:(?<=\.h5)|(?<=\.hdf5)|(?<=\.json)),"
    files = [scene] if Path(scene).exists() else re.split(commas, scene)
    return files if any(Path(each).suffix.lower() in HDF5 for each in files) else []


OUT = Opt("--out H.npz", "File to write the height map to.", OutputFile(".npz"))
MASK = Opt("--mask PNG", "Pixels to reconstruct: white in an image of the camera's size.")
SLOPES = Opt("--slopes FILE.npz", "Also write slopes and curvatures, with sigma.", OutputFile(".npz"))
CONTACTS = Opt("--contacts", "Look for contacts in open air, too.")
KEEP = Opt(
    "--keep-rest", "The mirror is at rest: keep it with the rig RIG.toml; later heights are those above it."
)
VERBOSE = Opt("--verbose", "Print every flag and contact, the uncertainty by source and chi2, too.")
ACCEPT = Opt("--accept", "Keep heights that contradict the scene; else all are flagged, exit code 2.")


_RARE = 1e-3  # share of pixels from which on a flag is printed
_BUDGET = "Uncertainty by source; errors of the rig common to a dent and its surroundings cancel in its depth"


@program("reconstruct", __doc__, partial(OfFacets, captures="sources", imports=("reconstruct",)))
def command(
    sources: Annotated[tuple[Path, ...], Arg("C.npz")],
    scene_name: SceneName,
    out: Annotated[Path, OUT],
    anchor: Anchor = None,
    rest_path: Annotated[Path | None, rest_file("its deviation from the prediction is subtracted")] = None,
    mask_path: Annotated[Path | None, MASK] = None,
    slopes_path: Annotated[Path | None, SLOPES] = None,
    no_rest: NoRest = False,
    find_contacts: Annotated[bool, CONTACTS] = False,
    accept: Annotated[bool, ACCEPT] = False,
    keep_rest: Annotated[bool, KEEP] = False,
    truth: Annotated[Path | None, Opt("--truth TRUTH.npz", "Compare with the truth of a simulation.")] = None,
    size: Size = None,
    verbose: Annotated[bool, VERBOSE] = False,
    json_path: Json = None,
) -> int:
    """Reconstruct the mirror's height, with an error bar per pixel.

    H.npz receives x, y, z, sigma (mm) and flags (0 = good) on the camera's pixels. Pixels that no anchor
    reaches are flagged, not guessed. `export` writes grids and meshes. A scene ending in .h5 is a result of
    OpenCSP's SOFAST (extra `sofast`), result.h5[,FACET] with the group's name of a facet but facet_000 (all:
    each, with a table of focal lengths and slope deviations), or SOFAST's inputs,
    camera.h5,display.h5,orientation.h5,measurement.h5[,facet.json]; for a correspondence decoded from that
    measurement.
    """
    from optolever.pictures import read_mask

    source, reconstruct = sources[0], ol.reconstruct
    correspondence = ol.decode.Correspondence.load(source)
    rest = None if rest_path is None else ol.decode.Correspondence.load(rest_path)
    mask = None if mask_path is None else read_mask(mask_path, correspondence.u.shape, str(source))
    sofast = _sofast_files(scene_name)
    if sofast:
        if size is not None:
            raise InputError(f"--pixels: {scene_name} is a SOFAST rig of its camera's size; leave it out")
        named = len(sofast) > 1 and not Path(sofast[-1]).suffix
        rig = ol.formats.load_sofast_rig(*((sofast[:-1], sofast[-1]) if named else (sofast,)))
        with blame(source):
            correspondence = ol.formats.on_rig(correspondence, rig)
            rest = None if rest is None else ol.formats.on_rig(rest, rig)
        scene, anchor = rig.scene, anchor or rig.datum
    else:
        scene = load_scene(scene_name, size)
    if keep_rest:
        _require_rig(scene_name, alone=rest is None and size is None and not sofast)
    if no_rest and rest is not None:
        raise InputError(f"--no-rest: --rest {rest_path} is given; leave one out")
    if rest is None:
        rest = _kept_rest(scene_name, no_rest, sofast, keep_rest, size)
    with progress() as step:
        with blame(source):
            step("reconstruct")
            start = time.perf_counter()
            height = reconstruct.reconstruct(
                correspondence, scene, anchor, mask, rest=rest, accept=accept, progress=step
            )
            seconds = time.perf_counter() - start
            step("contacts")
            slopes = reconstruct.slope_map(height, correspondence, scene, rest)
            height = reconstruct.with_slope_noise(height, slopes)
            if find_contacts or keep_rest or scene.medium is not None:
                height = replace(height, contacts=reconstruct.contacts(height, scene.layer))
            step("compare")
            numbers = _numbers(height) | {"seconds": seconds}
            numbers |= {} if truth is None else _against_truth(truth, correspondence, height)
        step("write")
        with ol.files.together():
            height.save(out)
            dented = _keep_rest(scene_name, correspondence, height) if keep_rest else []
            if slopes_path is not None:
                ol.files.save_arrays(slopes_path, asdict(slopes) | asdict(reconstruct.curvature_map(slopes)))
            write_json(json_path, numbers)
    print_notices([*dented, *(one for one in height.notices if one not in correspondence.notices)])
    table(f"Height map in {out}", _rows(numbers, scene.layer, verbose))
    if verbose and "budget_mm" in numbers:
        grid(_BUDGET, *budget_rows(numbers["budget_mm"]))
    return 0 if height.good.any() and not height.implausible else 2


def _kept_rest(scene: str, *without: object) -> "ol.decode.Correspondence | None":
    """The rig's capture at rest, if it has one and nothing speaks against it."""
    if any(without) or "rest" not in sections(scene):
        return None
    return ol.calibration.load_rest(scene)


def _require_rig(scene: str, alone: bool) -> None:
    """InputError unless --keep-rest can store in the scene's file."""
    if not alone or not Path(scene).is_file():
        raise InputError(f"--keep-rest: {scene} must be a rig's TOML (rig new), without --rest, --pixels")


def _keep_rest(
    rig: str, correspondence: "ol.decode.Correspondence", height: "ol.reconstruct.HeightMap"
) -> list[str]:
    """The mirror at rest, stored with the rig; the notice of its largest dent."""
    if not height.good.any():
        raise InputError(
            f"--keep-rest: no pixel has a height; is the mirror in view, the scene of {rig} right?"
        )
    ol.calibration.store_rest(rig, correspondence)
    lack = "later heights lack it; capture the mirror untouched, and store it again"
    return [
        f"The mirror at rest has a dent of {length(one.depth)} at ({one.x:.3g}, {one.y:.3g}) mm: {lack}"
        for one in (height.contacts or ())[:1]
    ]


def _numbers(height: "ol.reconstruct.HeightMap") -> dict[str, Any]:
    low, high = height_range(height)
    noise, rig = medians(height.good, height.sigma, height.calibration_sigma)
    budget = {} if height.modes is None else {"budget_mm": ol.reconstruct.budget(height)}
    return budget | {
        "good_share": float(height.good.mean()),
        "z_min_mm": low,
        "z_max_mm": high,
        "sigma_mm": noise,
        "calibration_sigma_mm": None if height.modes is None else rig,
        "flags": flag_shares(height.flags, ol.decode.Flag, ol.reconstruct.HeightFlag),
        "defect": height.diagnostics.defect,
        "chi2": height.diagnostics.chi2,
        "freedom": height.diagnostics.freedom,
        "contacts": [one.to_dict() for one in height.contacts or ()],
        "tests": [test.to_dict() for test in height.tests],
        "notices": [asdict(notice) for notice in height.notices],
    }


def _against_truth(
    path: Path, correspondence: "ol.decode.Correspondence", height: "ol.reconstruct.HeightMap"
) -> dict[str, float]:
    truth = ol.scene.Trace.load(path)
    if truth.z.shape != height.z.shape:
        wrong = f"z has shape {truth.z.shape}, must be {height.z.shape} as the height map"
        raise InputError(f"{path}: {wrong}; give the truth of this capture")
    return ol.samples.height_metrics(truth, correspondence, height)


def _rows(numbers: dict[str, Any], layer: "ol.scene.Layer | None", verbose: bool) -> dict[str, str]:
    rig, flags = numbers["calibration_sigma_mm"], numbers["flags"]
    largest = max(flags, key=flags.get, default="")
    rows = {
        "good": number(100 * numbers["good_share"], "% of the pixels"),
        "height": f"{number(numbers['z_min_mm'])} to {number(numbers['z_max_mm'], 'mm')}",
        "sigma": f"{noise_and_rig(numbers['sigma_mm'], rig or 0.0)} (medians)",
        **flag_rows(
            {name: flags[name] for name in flags if verbose or (name == largest and flags[name] > _RARE)}
        ),
    }
    if verbose and numbers["chi2"] is not None:
        by = "noise explains it" if rig is None else "noise and the errors of the rig explain it"
        freedom = f"{numbers['freedom']} degrees of freedom"
        rows["curl"] = f"reduced chi2 {number(numbers['chi2'])} of the slopes, {freedom}; 1: {by}"
    if "height_rms_rel" in numbers:
        rows["error"] = f"{number(numbers['height_rms_rel'])} of the peak depth, rms"
        rows["rms(error / sigma)"] = number(numbers["sigma_ratio_total"])
    return rows | contact_rows(numbers["contacts"], layer, verbose)
