"""`optolever rest`: the mirror at rest, checked and stored with the rig."""

from pathlib import Path
from typing import Annotated

import optolever as ol
from optolever import InputError

from .arguments import Arg, program
from .options import Anchor, Json, Rig, blame, correspondence_of
from .show import length, medians, number, print_notices, progress, table, write_json

SAMPLE = """
$ optolever rest rest.npz --scene rig.toml
Mirror at rest in rig.rest_places.npz
...
$ optolever reconstruct pressed.npz --scene rig.toml --out h.npz
"""


@program("rest", SAMPLE)
def command(
    source: Annotated[Path, Arg("CAPTURE")], rig: Rig, anchor: Anchor = None, json_path: Json = None
) -> None:
    """Store the mirror at rest with the rig.

    From then on `reconstruct` gives heights above it (--no-rest: absolute ones). CAPTURE, of the
    untouched mirror, is an .npz of decode or a folder of frames. Run it again whenever reconstruct says that
    the rig has moved: its calibration stays.
    """
    scene = ol.scene.load(rig)
    with progress() as step:
        step("read")
        seen = correspondence_of(source, rig)
        step("reconstruct")
        with blame(source):
            height = ol.reconstruct.reconstruct(seen, scene, anchor=anchor)
            if not height.good.any():
                cure = "check that the mirror at rest is in view, and the scene"
                raise InputError(f"no pixel has a height; {cure}")
            dents = ol.reconstruct.contacts(height)
        (sigma,) = medians(height.good, height.total_sigma)
        z = height.z[height.good]
        numbers = {"good_share": float(height.good.mean()), "z_rms_mm": float((z**2).mean() ** 0.5)}
        step("write")
        with ol.files.together():
            path = ol.calibration.store_rest(rig, seen)
            write_json(json_path, numbers | {"sigma_mm": sigma})
    print_notices(height.notices)
    for one in dents[:1]:
        place = f"a dent of {length(one.depth)} at ({one.x:.3g}, {one.y:.3g}) mm"
        lack = "later heights lack it; capture the mirror untouched, and run optolever rest again"
        print_notices([f"The mirror at rest has {place}: {lack}"])
    rows = {
        "good": number(100 * numbers["good_share"], "% of the pixels"),
        "height": number(numbers["z_rms_mm"], "mm rms"),
        "sigma": f"{length(sigma)} (median, noise and rig)",
    }
    table(f"Mirror at rest in {path}", rows)
