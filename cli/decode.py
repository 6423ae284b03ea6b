"""`optolever decode`: pictures (a capture folder, any camera's folder, a SOFAST file) to a correspondence."""

import time
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import optolever as ol
from optolever import InputError

from .arguments import AT_LEAST_0, Arg, Opt, Rare, program
from .batch import Many
from .options import Display, Json, Pictured, blame, mask_file, mask_from, shown_sequence
from .outputs import HDF5, OutputFile
from .rig_capture import measured_lag
from .show import coverage_text, flag_shares, number, print_notices, progress, table, write_json

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


__all__ = ["command"]

SAMPLE = """
$ optolever decode capture --out c.npz
Correspondence in c.npz
  frames       22 of 256 x 256
  good         98.83 % of the pixels
  mirror       the mirror fills 100.0 % of the image; 98.8 % of it decoded
  sigma u      0.0097 px (median of the good pixels)
  sigma v      0.0098 px (median of the good pixels)
  off_pattern  1.169 %
  time         0.607 s
"""


OUT = Opt("--out C.npz", "File to write the correspondence to.", OutputFile(".npz"))
DESCRIPTION = Opt("--description TOML", "capture.toml by show, in place of --sequence and --pixels.")
CHANNEL = Rare("--channel red|green|blue|luminance", "Channel of colour pictures.")
RESPONSE = Opt("--response RIG.toml|H5", "Response to levels: of a rig (`response`), or by SOFAST.")
ROI = Opt("--roi TOP,LEFT,ROWS,COLS", "Decode this rectangle only; the rest of C.npz is INVALID.")
LENS = Rare("--lens PX", "Rms blur of the lens, at most 4; default: 0.28, sigma allows 0 to 0.6.", AT_LEAST_0)
PROFILE = Opt("--profile RIG.toml|NPZ", "Profile of the rig by --save-profile, instead of a new estimate.")
SAVE = Opt("--save-profile RIG.toml|NPZ", "Store this capture's profile, with the rig or in a file.")
BLUR = Rare("--blur CELLS", "Rms blur of the display's cells; default: by the fringes' contrast.", AT_LEAST_0)
IDEAL = Rare("--no-cells", "Frames were ideal cosines, not shown on a display's cells.")


@program("decode", SAMPLE, partial(Many, captures="sources", folders=True))
def command(
    sources: Annotated[tuple[Path, ...], Arg("DIR|PATTERN|FILE")],
    out: Annotated[Path, OUT],
    text: Pictured = None,
    display: Display = None,
    description: Annotated[Path | None, DESCRIPTION] = None,
    mask_path: Annotated[Path | None, mask_file("Pixels to decode")] = None,
    roi: Annotated[str | None, ROI] = None,
    response: Annotated[Path | None, RESPONSE] = None,
    profile: Annotated[Path | None, PROFILE] = None,
    save_profile: Annotated[Path | None, SAVE] = None,
    channel: Annotated[Literal["red", "green", "blue", "luminance"], CHANNEL] = "luminance",
    lens: Annotated[float | None, LENS] = None,
    blur: Annotated[float | None, BLUR] = None,
    no_cells: Annotated[bool, IDEAL] = False,
    json_path: Json = None,
) -> None:
    """Find the pattern coordinates of every pixel, with sigma.

    DIR is a folder with capture.toml and its frames, or a measurement of OpenCSP's SOFAST (HDF5, extra
    `sofast`). With --sequence and --pixels, or --description: any camera's folder of pictures, a PATTERN
    such as 'shots/*.png', or a FILE of several (TIFF, NPY, video), sorted as people count. C.npz receives u,
    v, sigma_u, sigma_v (pattern pixels), flags (0 = good), amplitude, offset.
    """
    with progress() as step:
        step("read frames")
        source = sources[0]
        capture = _read(sources, text, display, description, channel)
        step("decode")
        start = time.perf_counter()
        with blame(source):
            inverse = _inverse(response)
            inside = _inside(mask_path, roi, capture.frames.shape[1:])
            settings = ol.decode.Settings(
                response=inverse,
                lens_px=lens,
                blur_px=blur,
                on_cells=not no_cells,
            )
            known = None
            if profile is not None:
                known = ol.calibration.load_profile(profile).with_lag(measured_lag(profile, source))
                if settings not in (ol.decode.Settings(), known.settings):
                    raise InputError(
                        f"--profile {profile}: is of another response, lens, blur or cells; leave out "
                        "--response, --lens, --blur and --no-cells"
                    )
                settings = known.settings
            decoder = ol.decode.Decoder(capture.sequence, known, settings)
            result = decoder.decode(capture.frames, mask=inside, progress=step)
            if inverse is not None and result.notices:
                plain = ol.decode.Decoder(capture.sequence, settings=replace(settings, response=None))
                result = ol.calibration.with_better_fit(result, plain.decode(capture.frames, mask=inside))
        seconds = time.perf_counter() - start
        weak = ol.experiments.code_that_decodes(result, capture.sequence)
        if weak is not None:
            result = replace(result, notices=(*result.notices, weak))
        step("write")
        numbers = _numbers(result) | {"frames": len(capture), "seconds": seconds}
        numbers["faults"] = [notice.name for notice in result.notices]
        result = replace(result, notices=capture.notices + result.notices)
        numbers["notices"] = [asdict(notice) for notice in result.notices]
        told = decoder.profile
        if told is None and save_profile is not None:
            raise InputError(
                f"--save-profile {save_profile}: not written, the frames of {source} contradict their "
                "description (see the notices)"
            )
        numbers["profile"] = [] if told is None else [effect._asdict() for effect in told.effects()]
        with ol.files.together():
            result.save(out)
            if told is not None and save_profile is not None:
                ol.calibration.store_profile(save_profile, told)
            write_json(json_path, numbers)
    print_notices(result.notices)
    rows, cols = result.u.shape
    table(
        f"Correspondence in {out}",
        {
            "frames": f"{len(capture)} of {rows} x {cols}",
            "good": number(100 * numbers["good_share"], "% of the pixels"),
            "mirror": coverage_text(numbers["mirror_share"], numbers["mirror_good_share"]),
            **{
                f"sigma {axis}": f"{numbers[f'sigma_{axis}_px']:.2g} px (median of the good pixels)"
                for axis in "uv"
            },
            **{name: number(100 * share, "%") for name, share in numbers["flags"].items()},
            "time": number(seconds, "s"),
        },
    )


def _inside(mask: Path | None, roi: str | None, shape: tuple[int, ...]) -> "NDArray[np.bool_] | None":
    """Pixels (H, W) inside --mask and --roi; None: all."""
    import numpy as np

    if mask is None and roi is None:
        return None
    inside = np.ones(shape, np.bool_) if mask is None else mask_from(mask, shape, "frames are")
    if roi is not None:
        parts = roi.split(",")
        if len(parts) != 4 or not all(part.strip().isdecimal() for part in parts):
            raise InputError(f"--roi {roi!r}: must be four whole numbers, TOP,LEFT,ROWS,COLS")
        top, left, rows, cols = (int(part) for part in parts)
        if rows < 1 or cols < 1 or top + rows > shape[0] or left + cols > shape[1]:
            raise InputError(f"--roi {roi}: reaches beyond the frames, which are {shape[0]}x{shape[1]}")
        rectangle = np.zeros(shape, np.bool_)
        rectangle[top : top + rows, left : left + cols] = True
        inside &= rectangle
    return inside


def _read(
    sources: tuple[Path, ...],
    text: str | None,
    display: tuple[int, int] | None,
    description: Path | None,
    channel: str,
) -> "ol.projector.Capture":

    if sources[0].suffix.lower() in HDF5:
        for name, value in (("--description", description), ("--sequence", text)):
            if value is not None:
                raise InputError(
                    f"{name} {value}: is for pictures; {sources[0]} describes itself, leave the option out"
                )
        return ol.formats.load_sofast(sources[0])
    if text is None:
        if display is not None:
            raise InputError("--pixels: needs --sequence, which is missing, such as --sequence gray+phase")
        return ol.projector.Capture.load(sources, description, channel)
    if description is not None:
        raise InputError(
            f"--sequence {text} and --description {description}: exclude each other, leave one out"
        )
    shown = shown_sequence(text, display)
    return ol.projector.Capture.from_pictures(sources, shown, channel=channel)


def _inverse(response: Path | None) -> "ol.decode.Response | None":

    if response is None:
        return None
    if response.suffix.lower() in HDF5:
        return ol.decode.Response.from_table(*ol.formats.load_sofast_response(response))
    return ol.calibration.load_response(response).response


def _numbers(result: "ol.decode.Correspondence") -> dict[str, Any]:
    import numpy as np

    good = result.good
    median = {
        f"sigma_{axis}_px": float(np.median(sigma[good])) if good.any() else float("nan")
        for axis, sigma in (("u", result.sigma_u), ("v", result.sigma_v))
    }
    mirror, decoded = ol.experiments.mirror_coverage(result.flags)
    shares = {"good_share": float(good.mean()), "mirror_share": mirror, "mirror_good_share": decoded}
    return {**shares, **median, "flags": flag_shares(result.flags, ol.decode.Flag)}
