"""`optolever camera expose`: exposure of a rig's camera by images of a white and a black display.

$ optolever camera expose --rig rig.toml --mask mask.png
Exposure in rig.toml
  exposure   16.67 ms
  saturated  0 % of the pixels
  contrast   85.1 % of full scale (median)
  lit        100 % of the pixels
"""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import optolever as ol
from optolever import InputError

from ..arguments import Opt, program
from ..options import Json, in_colour
from ..outputs import OutputFile
from ..printing import number, table, write_json
from .opened import Changes, OpenedRig, levels_of, opened

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


#: Share of full scale that a channel of white keeps: one that clips costs the three frames of its picture.
_MOST = 235 / 255


COLOUR = Opt("--colour", "For patterns in colour: no channel beyond 235 of 255.")
PNG = Opt("--mask FILE", "Also write the mask of the pixels that see the display.", OutputFile(".png"))


@program("expose", __doc__)
def command(
    rig: OpenedRig,
    changes: Changes = (),
    mask_path: Annotated[Path | None, PNG] = None,
    colour: Annotated[bool, COLOUR] = False,
    json_path: Json = None,
) -> None:
    """Choose the longest exposure that saturates no pixel.

    At most 0.01 % of the pixels reach the top level; an integer number of refreshes if the display's period
    is known. RIG.toml gets it in [devices]. The gain is unchanged: more gain only adds noise.
    """
    import cv2

    chosen, seen = chosen_exposure(rig, ol.camera.devices_of(rig, changes), colour)
    numbers = {
        "exposure_ms": chosen.exposure_ms,
        "saturated_share": seen.saturated,
        "swing": seen.swing,
        "lit_share": float(seen.mask.mean()),
    }
    with ol.files.together():
        if mask_path is not None:
            with ol.files.atomic_file(mask_path) as temporary:
                cv2.imwrite(str(temporary), 255 * seen.mask.astype("uint8"))
        ol.scene.write_sections(rig, {"devices": chosen.table()})
        write_json(json_path, numbers)
    rows = {
        "exposure": number(chosen.exposure_ms, "ms"),
        "saturated": number(100 * seen.saturated, "% of the pixels"),
        "contrast": number(100 * seen.swing, "% of full scale (median)"),
        "lit": number(100 * seen.mask.mean(), "% of the pixels"),
    }
    table(f"Exposure in {rig}", rows)


def chosen_exposure(
    rig: Path, devices: "ol.camera.Devices", colour: bool = False
) -> "tuple[ol.camera.Devices, ol.camera.Contrast]":
    """[devices] with the longest exposure that saturates no pixel, and its contrast; colour: in no channel,
    all of them lit, more than 235 of 255 levels."""
    shown = in_colour(levels_of(rig, "black", "white"), "none" if colour else None)
    with opened(rig, devices, shown, running=False) as now:
        exposure_s, found = ol.camera.choose_exposure(
            lambda exposure: _take(now, replace(devices.wanted(), exposure_s=exposure, colour=colour)),
            now.accepted.bits,
            1e-3 * devices.exposure_ms,
            now.display.refresh_s,
            _MOST if colour else 1.0,
        )
    return replace(devices, exposure_ms=1e3 * exposure_s, focus=now.accepted.focus), found


def _take(
    now: "ol.camera.Opened", wanted: "ol.projector.Wanted"
) -> "tuple[float, NDArray[np.uint8], NDArray[np.uint8]]":
    """Exposure as accepted, an image of white, one of black, each half a second after its swap."""
    accepted = now.camera.configure(wanted)
    now.camera.start()
    try:
        black, white = replace(now, clock=ol.camera.ClockMap()).acquire(None, (0, 1))
    finally:
        now.camera.stop()
    if accepted.exposure_s <= 0:
        wrong = f"reports an exposure of {accepted.exposure_s:g} s, must be above 0"
        raise InputError(f"camera: {wrong}; set it with --set exposure_ms=MS")
    lit, dark = (one.image.pixels for one in (white, black))
    return (accepted.exposure_s, *((lit, dark) if lit.ndim == 2 else (lit.max(axis=-1), dark.max(axis=-1))))
