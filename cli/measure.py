"""`optolever camera measure`: capture, decode, reconstruct and report with a rig, in one go.

$ optolever camera measure --rig rig.toml --out press1
Measured in press1
  camera  virtual
  frames  20 in 0.1069 s
  good    97.15 % of the pixels
  height  −150 nm to 0.3 mm
  sigma   ± 42 nm noise, ± 0.38 mm rig (medians)
  report  press1/report.html
"""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

import optolever as ol
from optolever import InputError

from .arguments import Arg, Opt, Rare, program
from .batch import Many
from .options import Colour, Json, NoRest, Shown, checked_response, colours_of, name_unused, response_of
from .outputs import NewFolder, OutputFile
from .printing import (
    contact_rows,
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
from .rig.opened import Changes, OpenedRig, sequence_of
from .rig.recorded_capture import capture_rig, measured_lag

PROFILE = Rare("--profile NPZ", "Profile of the rig, instead of a new estimate.")
ONLY = Opt("--frames-only", "Take the capture, into --out itself, and stop.")
KEEP = Rare("--keep", "Keep the recording of all images, OUT.recording.")
SAVE = Rare("--save-profile NPZ", "Store this capture's profile of the rig.", OutputFile(".npz"))


@program("measure", __doc__, partial(Many, captures="captures", imports=("camera", "samples"), folders=True))
def command(
    captures: Annotated[tuple[Path, ...], Arg("[DIR...]", required=False)],
    rig: OpenedRig,
    out: Annotated[Path, Opt("--out DIR", "Folder to make: capture, maps, report.", NewFolder())],
    sequence: Shown = "gray+phase",
    changes: Changes = (),
    no_rest: NoRest = False,
    profile: Annotated[Path | None, PROFILE] = None,
    save_profile: Annotated[Path | None, SAVE] = None,
    frames_only: Annotated[bool, ONLY] = False,
    colour: Colour = None,
    keep: Annotated[bool, KEEP] = False,
    json_path: Json = None,
) -> None:
    """Take a capture with a rig, or read one; heights and a report.

    The folder --out gets capture/, c.npz, h.npz, report.html and its data; with --frames-only capture.toml,
    frames/*.png and acquisition.jsonl. The display shows the frames, and the camera takes the first image of
    each whose exposure began after the pattern had settled ([sync], else after 0.5 s). The recording of an
    aborted capture stays in OUT.recording (optolever camera replay). --colour takes a third of the pictures,
    in colour, of a rig with [colour] (response --colour).
    """
    scene, colours = ol.scene.load(rig), colours_of(rig)
    devices = None if captures else ol.camera.devices_of(rig, changes)
    if frames_only:
        _take(rig, devices, sequence, colour, out, keep, json_path)
        return
    if colour is not None and colours is None:
        cure = "take --sequence ramp --frames-only with it, then optolever response --colour"
        raise InputError(f"{rig}: --colour {colour} needs [colour], which is missing; {cure}")
    with progress() as step:
        out.mkdir(parents=True, exist_ok=True)
        step("capture")
        folder, taken = captures[0] if captures else out / "capture", None
        if devices is not None:
            record = out.with_name(f"{out.name}.recording")  # beside: a folder that failed can be used again
            shown = sequence_of(rig, sequence, colour)
            taken = capture_rig(rig, devices, shown, folder, keep=keep, record=record)
        capture = ol.projector.load_capture(folder, colours=colours) if taken is None else taken.capture
        if isinstance(capture, ol.projector.ColourCapture):
            assert colours is not None
            capture = capture.unmixed(colours)
        step("decode")
        known = None if profile is None else ol.decode.RigProfile.load(profile)
        grey = capture.sequence.packing is None
        light = known.settings.response if known is not None else response_of(rig) if grey else None
        settings = ol.decode.Settings(response=light)
        decoder = ol.decode.Decoder(capture.sequence, known, settings)
        seen, lag = decoder.decode(capture.frames), measured_lag(rig, folder)
        if lag and decoder.profile is not None:
            lagged = ol.decode.Decoder(capture.sequence, decoder.profile.with_lag(lag))
            seen = lagged.decode(capture.frames)
        seen = checked_response(seen, capture, settings) if known is None else seen
        with ol.files.together():
            if save_profile is not None and decoder.profile is not None:
                decoder.profile.save(save_profile)
            seen.save(out / "c.npz")
            step("reconstruct")
            rest = None if no_rest else ol.calibration.load_rest(rig)
            height = ol.reconstruct.reconstruct(seen, scene, rest=rest)
            if scene.medium is not None:
                height = replace(height, contacts=ol.reconstruct.contacts(height, layer=scene.layer))
            plain = ol.reconstruct.slope_map(replace(height, modes=None), seen, scene, rest)
            height = ol.reconstruct.with_slope_noise(height, plain)
            height.save(out / "h.npz")
            found = ol.samples.Measurement(
                height, seen, scene, source=f"{out.name}/h.npz", rig=str(rig), saved=("c.npz", "h.npz"),
                origin="simulated" if devices and devices.camera == "virtual" else "measured", rest=rest,
            )  # fmt: skip
            ol.report.write_measurement_report(out / "report.html", found, full=True)
            noise, rig_error = medians(height.good, height.sigma, height.calibration_sigma)
            frames = {"frames": len(capture)} if taken is None else taken.numbers()
            numbers = {"good_share": float(height.good.mean()), "noise_mm": noise, "rig_mm": rig_error}
            contacts = [one.to_dict() for one in height.contacts or ()]
            write_json(json_path, frames | {"contacts": contacts} | numbers)
    name_unused(rig, "measure", **({} if profile else {"profile": f"give --profile {rig}"}))
    print_notices(height.notices)  # the correspondence's among them
    rows = {
        "camera": str(folder) if devices is None else devices.camera,
        "frames": f"{len(capture)}" + ("" if taken is None else f" in {number(taken.seconds, 's')}"),
        "good": number(100 * numbers["good_share"], "% of the pixels"),
        "height": " to ".join(map(length, height_range(height))),
        "sigma": f"{noise_and_rig(noise, rig_error)} (medians)",
        "report": str(out / "report.html"),
        **contact_rows(contacts, scene.layer),
    }
    table(f"Measured in {out}", rows)


def _take(
    rig: Path,
    devices: "ol.camera.Devices | None",
    sequence: str,
    colour: str | None,
    out: Path,
    keep: bool,
    json_path: Path | None,
) -> None:
    """--frames-only: the capture alone."""
    if devices is None:
        raise InputError("--frames-only: takes a new capture; leave DIR out")
    shown = sequence_of(rig, sequence, colour)
    with ol.files.together():
        done = capture_rig(rig, devices, shown, out, keep=keep)
        write_json(json_path, done.numbers())
    numbers, (rows, cols) = done.numbers(), done.capture.shape
    figures = {
        "camera": devices.camera,
        "sequence": sequence,
        "frames": f"{shown.exposures} of {rows} x {cols}",
        "images": f"{done.lost} lost, {numbers['incomplete']} incomplete",
        "patterns": f"{numbers['repeats']} shown again, {numbers['late']} late",
        "time": number(done.seconds, "s"),
    }
    table(f"Capture in {out}", figures)
