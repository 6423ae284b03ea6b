"""`optolever decode`: pictures (a capture folder, any camera's folder, a SOFAST file) to a correspondence.

$ optolever decode capture --out c.npz
Correspondence in c.npz
  frames       22 of 256 x 256
  good         98.03 % of the pixels
  mirror       the mirror fills 100.0 % of the image; 98.0 % of it decoded
  sigma u      0.021 px (median of the good pixels)
  sigma v      0.021 px (median of the good pixels)
  off_pattern  1.973 %
  time         0.607 s
"""

import re
import time
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import optolever as ol
from optolever import InputError
from optolever.numbers import listed, whole

from .arguments import AT_LEAST_0, Arg, Opt, Rare, program
from .batch import Many
from .options import Display, Json, Pictured, blame, checked_response, colours_of, shown_sequence
from .outputs import HDF5, OutputFile
from .printing import (
    coverage_text,
    flag_rows,
    flag_shares,
    medians,
    number,
    print_notices,
    progress,
    table,
    write_json,
)
from .rig.recorded_capture import measured_lag

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


PROFILES = OutputFile(".toml", ".npz", updates=True, beside=(".profile.npz",))
OUT = Opt("--out C.npz", "File to write the correspondence to.", OutputFile(".npz"))
DESCRIPTION = Opt("--description TOML", "capture.toml by show, in place of --sequence and --pixels.")
CHANNEL = Rare("--channel red|green|blue|luminance", "Channel of colour pictures.")
RESPONSE = Opt("--response RIG.toml|H5", "Response to levels: of a rig (`response`), or by SOFAST.")
MASK = Opt(
    "--mask PNG|TOP,LEFT,ROWS,COLS",
    "Pixels to read: white in an image of the camera's size, or a rectangle; others are INVALID.",
)
LENS = Rare("--lens PX", "Rms blur of the lens, at most 4; default: 0.28, sigma allows 0 to 0.6.", AT_LEAST_0)
PROFILE = Opt("--profile RIG.toml|NPZ", "Profile of the rig by --save-profile, instead of a new estimate.")
SAVE = Opt("--save-profile RIG.toml|NPZ", "Store this capture's profile, with the rig or alone.", PROFILES)
WITHOUT = Opt(
    "--without N,...", "Numbers of pictures to leave out, from 0; the others hold the place if they can."
)
BLUR = Rare(
    "--blur CELLS", "Rms blur of the cells, for --response and look-ups; default: fitted.", AT_LEAST_0
)


@program("decode", __doc__, partial(Many, captures="sources", imports=("decode", "projector"), folders=True))
def command(
    sources: Annotated[tuple[Path, ...], Arg("DIR|PATTERN|FILE")],
    out: Annotated[Path, OUT],
    text: Pictured = None,
    display: Display = None,
    description: Annotated[Path | None, DESCRIPTION] = None,
    mask: Annotated[str | None, MASK] = None,
    response: Annotated[Path | None, RESPONSE] = None,
    profile: Annotated[Path | None, PROFILE] = None,
    save_profile: Annotated[Path | None, SAVE] = None,
    channel: Annotated[Literal["red", "green", "blue", "luminance"], CHANNEL] = "luminance",
    lens: Annotated[float | None, LENS] = None,
    blur: Annotated[float | None, BLUR] = None,
    left_out: Annotated[str | None, WITHOUT] = None,
    json_path: Json = None,
) -> int:
    """Find the pattern coordinates of every pixel, with sigma.

    DIR is a folder with capture.toml and its frames, or a measurement of OpenCSP's SOFAST (HDF5, extra
    `sofast`). With --sequence and --pixels, or --description: any camera's folder of pictures, a PATTERN
    such as 'shots/*.png', or a FILE of several (TIFF, NPY, video), sorted as people count. C.npz receives u,
    v, sigma_u, sigma_v (pattern pixels), flags (0 = good), amplitude, offset.
    """
    source = sources[0]
    with progress() as step:
        step("read frames")
        capture = read_capture(sources, text, display, description, channel, left_out, response)
        step("decode")
        with blame(source):
            start = time.perf_counter()
            inside = mask_of(mask, capture.shape)
            coloured = capture.sequence.packing is not None
            light = None if response is None or coloured else _response(response)
            settings = ol.decode.Settings(response=light, lens_px=lens, blur_px=blur)
            known = None
            if profile is not None:
                known = ol.decode.RigProfile.load(profile).with_lag(measured_lag(profile, source))
                if settings not in (ol.decode.Settings(), known.settings):
                    wrong = "is of another response, lens or blur"
                    cure = "leave out --response, --lens and --blur"
                    raise InputError(f"--profile {profile}: {wrong}; {cure}")
                settings = known.settings
            decoder = ol.decode.Decoder(capture.sequence, known, settings)
            result = decoder.decode(capture.frames, mask=inside, progress=step)
            if light is not None:
                result = checked_response(result, capture, settings, inside)
        seconds = time.perf_counter() - start
        found = result.notices
        result = replace(result, notices=capture.notices + found)
        kept = decoder.profile
        if kept is None and save_profile is not None:
            why = f"the frames of {source} contradict their description (see the notices)"
            raise InputError(f"--save-profile {save_profile}: not written, {why}")
        numbers = _numbers(result) | {
            "frames": len(capture),
            "seconds": seconds,
            "faults": [notice.name for notice in found],
            "tests": [one.to_dict() for one in result.tests],
            "notices": [asdict(notice) for notice in result.notices],
            "profile": [] if kept is None else [effect._asdict() for effect in kept.effects()],
        }
        step("write")
        with ol.files.together():
            result.save(out)
            if kept is not None and save_profile is not None:
                kept.save(save_profile)
            write_json(json_path, numbers)
    print_notices(result.notices)
    rows, cols = capture.shape
    figures = {
        "frames": f"{len(capture)} of {rows} x {cols}",
        "good": number(100 * numbers["good_share"], "% of the pixels"),
        "mirror": coverage_text(numbers["mirror_share"], numbers["mirror_good_share"]),
    }
    if good := result.good.any():
        medians_px = {f"sigma {axis}": numbers[f"sigma_{axis}_px"] for axis in "uv"}
        figures |= {name: f"{one:.2g} px (median of the good pixels)" for name, one in medians_px.items()}
    table(f"Correspondence in {out}", figures | flag_rows(numbers["flags"]) | {"time": number(seconds, "s")})
    if not good:
        said = any("lit pixels are good" in notice.name for notice in found)
        said |= any(one.fails for one in result.tests)
        shown = "{2}x{1} pixels".format(*capture.sequence.shape)
        cause = f"; most likely the display had not {shown} or showed another sequence or order"
        cure = "correct --pixels, --sequence or capture.toml"
        print_notices([f"{source}: no pixel is good" + ("" if said else f"{cause}: {cure}")])
    return 0 if good else 2


def _numbers(result: "ol.decode.Correspondence") -> dict[str, Any]:
    mirror, decoded = ol.decode.mirror_coverage(result.flags)
    sigma_u, sigma_v = medians(result.good, result.sigma_u, result.sigma_v)
    return {
        "good_share": float(result.good.mean()),
        "mirror_share": mirror,
        "mirror_good_share": decoded,
        "sigma_u_px": sigma_u,
        "sigma_v_px": sigma_v,
        "flags": flag_shares(result.flags, ol.decode.Flag),
    }


def mask_of(text: str | None, shape: tuple[int, int]) -> "NDArray[np.bool_] | None":
    """Pixels (H, W) of --mask; None: all."""
    import numpy as np

    from optolever.pictures import read_mask

    if text is None:
        return None
    if Path(text).exists() or not re.fullmatch(r"[-+\d.,\s]+", text):
        return read_mask(Path(text), shape, "the frames")
    form = "four whole numbers, TOP,LEFT,ROWS,COLS"
    top, left, rows, cols = (whole("--mask", each) for each in listed("--mask", text, form, 4))
    inside = np.zeros(shape, np.bool_)
    inside[top : top + rows, left : left + cols] = True
    if min(top, left) < 0 or rows < 1 or cols < 1 or inside.sum() != rows * cols:
        raise InputError(f"--mask {text}: reaches beyond the frames of {shape[1]}x{shape[0]} pixels")
    return inside


def read_capture(
    sources: tuple[Path, ...],
    text: str | None,
    display: tuple[int, int] | None,
    description: Path | None,
    channel: str,
    left_out: str | None,
    rig: Path | None = None,
) -> "ol.projector.Capture":
    """Pictures of any source; left_out: numbers of the unused ones; rig: of pictures in colour."""
    capture = _read(sources, text, display, description, channel, rig)
    if left_out is None:
        return capture
    if capture.sequence.packing is not None:
        raise InputError(f"--without {left_out}: of pictures in colour each holds three frames; leave it out")
    numbers = [whole("--without", each) for each in listed("--without", left_out, "numbers from 0, N,N,...")]
    kept, shown = ol.decode.without(capture.sequence, numbers)
    times = None if capture.timestamps is None else capture.timestamps[list(kept)]
    return replace(capture, frames=capture.frames[list(kept)], sequence=shown, timestamps=times)


def _read(
    sources: tuple[Path, ...],
    text: str | None,
    display: tuple[int, int] | None,
    description: Path | None,
    channel: str,
    rig: Path | None,
) -> "ol.projector.Capture":
    if sources[0].suffix.lower() in HDF5:
        for name, value in (("--description", description), ("--sequence", text)):
            if value is not None:
                raise InputError(f"{name} {value}: {sources[0]} describes itself, leave it out")
        return ol.formats.load_sofast(sources[0])
    if text is None:
        if display is not None:
            raise InputError("--pixels: needs --sequence, which is missing, such as --sequence gray+phase")
        colours = None if rig is None or rig.suffix.lower() in HDF5 else colours_of(rig)
        return ol.projector.load_capture(sources, description, channel, colours)
    if description is not None:
        raise InputError(f"--sequence {text} and --description {description}: leave one out")
    shown = shown_sequence(text, display)
    if shown.packing is not None:
        raise InputError(f"--sequence {text}: is in colour; take --description of the capture.toml by show")
    return ol.projector.Capture.load(sources, shown, channel=channel)


def _response(path: Path) -> "ol.decode.Response":
    if path.suffix.lower() in HDF5:
        return ol.decode.Response.from_table(*ol.formats.load_sofast_response(path))
    return ol.calibration.load_response(path).response
