"""`optolever response`: radiometric response of display and camera, measured and stored with the rig.

$ optolever response ramp pose0 pose1 pose2 --scene rig.toml
Response in rig.response.npz
...
$ optolever decode capture --response rig.toml --out c.npz
"""

from pathlib import Path
from typing import Annotated, Any, Literal

import optolever as ol
from optolever import InputError
from optolever.quantities import quantity

from .arguments import Arg, Opt, program
from .options import Json, stored_in
from .printing import number, progress, table, write_json

CHANNELS = ("red", "green", "blue")


MOSAIC = Opt(
    "--mosaic RGGB|GRBG|GBRG|BGGR",
    "Order of the colours in raw pictures, with --colour; default: the capture's.",
)


@program("response", __doc__)
def command(
    ramp: Annotated[Path, Arg("RAMP")],
    captures: Annotated[tuple[Path, ...], Arg("[CAPTURE]...", required=False)],
    rig: Annotated[Path, stored_in(".response.npz")],
    colour: Annotated[
        bool, Opt("--colour", "RAMP is of show --sequence ramp --colour: measure the colours.")
    ] = False,
    mosaic: Annotated[Literal["RGGB", "GRBG", "GBRG", "BGGR"] | None, MOSAIC] = None,
    json_path: Json = None,
) -> None:
    """Measure the response of display and camera to levels.

    RAMP is a capture of the sequence `ramp`, by a linear camera. Captures of fringes (CAPTURE) determine the
    blur; about three of them, with the mirror in different poses as for calibrate, separate vignetting and
    backlight. decode --response RIG.toml then uses the light of every level.

    --colour measures instead how the display's channels mix in the camera's, for patterns shown in colour.
    The camera's levels must be linear, its white balance fixed, white at most 235 of 255.
    """
    if colour or mosaic is not None:
        if captures:
            raise InputError(f"response --colour: takes RAMP alone, not {captures[0]}, too")
        _colours(ramp, rig, mosaic, json_path)
        return
    with progress() as step:
        step("read")
        first, *others = [ol.projector.Capture.load(path) for path in (ramp, *captures)]
        step("measure")
        found = ol.calibration.measure_response(first, others, [str(path) for path in (ramp, *captures)])
        gamma, misfit = found.gamma
        numbers: dict[str, Any] = {
            "gamma": gamma,
            "misfit": misfit,
            "black": found.black,
            "blur_px": found.response.blur,
            "blur_sigma_px": found.blur_sigma,
            "parted_sigma": found.parted_sigma,
        }
        numbers |= {f"{name}_least": value for name, value in found.least().items()}
        step("write")
        with ol.files.together():
            path = ol.calibration.store_response(rig, found)
            write_json(json_path, numbers)
    apart = f"not separated ({len(captures)} captures"
    apart += ")" if len(captures) < 2 else f", standard deviation {100 * found.parted_sigma:.2g} %)"
    rows = {
        "gamma": f"{number(gamma)}; residual {100 * misfit:.2g} % of white (rms)",
        "black": number(100 * found.black, "% of white"),
        "blur": quantity(found.response.blur or 0.0, "cells", found.blur_sigma)
        if captures
        else "unknown: give captures of fringes",
    }
    for name, least in found.least().items():
        rows[name] = apart if least is None else number(100 * least, "% (darkest pixel over brightest)")
    table(f"Response in {path}", rows)


def _colours(ramp: Path, rig: Path, mosaic: str | None, json_path: Path | None) -> None:
    """--colour: the mix of the channels, into the rig."""
    with progress() as step:
        step("read")
        taken = ol.projector.ColourCapture.load(ramp)
        step("measure")
        found = ol.calibration.measure_colours(taken, mosaic or taken.raw)
        step("write")
        with ol.files.together():
            ol.calibration.store_colours(rig, found)
            numbers = ("mix", "mix_sigma", "dark", "misfit", "leak", "stripes")
            write_json(json_path, {name: getattr(found, name) for name in numbers})
    white = found.mix.sum(axis=1)
    shares = 100 * found.mix / white[:, None]
    rows = {
        f"camera's {name}": ", ".join(
            f"{share:.3g} % of {of}" for share, of in zip(row, CHANNELS, strict=True)
        )
        for name, row in zip(CHANNELS, shares, strict=True)
    }
    rows |= {
        "white": number(100 * float(white.max() + found.dark.max()), "% of the camera's"),
        "misfit": number(100 * found.misfit, "% of white"),
        "leak": f"{100 * found.leak:.2g} % of a channel remains in another (standard deviation, in sigma)",
    }
    rows["stripes"] = found.stripes or "not known: pictures have no fringe, or channels differ elsewise"
    table(f"Colours in {rig}", rows)
