"""`optolever measure`: capture, decode, reconstruct and report with a rig, in one go."""

from pathlib import Path
from typing import Any

import click

from optolever import InputError

from .options import FILE, json_option, sample, sequence_option
from .outputs import Program
from .rig_capture import capture_rig, measured_lag
from .rig_devices import device_options, devices_of
from .show import length, noise_and_rig, number, print_notices, progress, table, write_json

__all__ = ["command"]

SAMPLE = """
$ optolever measure --rig rig.toml --out press1
Measured in press1
  camera  virtual
  frames  20 in 0.1069 s
  good    97.15 % of the pixels
  height  -1.5e+02 nm to 0.3 mm
  sigma   ± 42 nm noise ± 0.38 mm rig (medians)
  report  press1/report.html
"""


@click.command("measure", cls=Program, epilog=sample(SAMPLE))
@device_options
@sequence_option("Displayed sequence.")
@click.option("--out", type=FILE, required=True, metavar="DIR", help="Folder to make: capture, maps, report.")
@json_option
def command(rig: Path, sequence: str, out: Path, json_path: Path | None, **given: Any) -> None:
    """Take a capture with a rig and make heights and a report.

    DIR gets capture/, c.npz, h.npz, report.html and its data. Every frame is checked against its pattern and
    the preceding one: a display's light changes later than its buffer is swapped.
    """
    import numpy as np

    from optolever.decode import Decoder
    from optolever.experiments import Measurement, frames_of_another, write_measurement_report
    from optolever.patterns import sequence_from_text
    from optolever.reconstruct import reconstruct
    from optolever.scene import load

    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out}: exists and is no empty folder; name another")
    devices, scene = devices_of(rig, **given), load(rig)
    shown = sequence_from_text(sequence, scene.pattern.rows, scene.pattern.cols)
    with progress() as step:
        out.mkdir(parents=True, exist_ok=True)
        step("capture")
        done = capture_rig(rig, devices, shown, out / "capture", keep=False)
        step("decode")
        decoder = Decoder(shown)
        seen, lag = decoder.decode(done.capture.frames), measured_lag(rig, out / "capture")
        if lag and decoder.profile is not None:
            seen = Decoder(shown, decoder.profile.with_lag(lag)).decode(done.capture.frames)
        seen.save(out / "c.npz")
        wrong = frames_of_another(done.capture, seen)
        step("reconstruct")
        height = reconstruct(seen, scene)
        height.save(out / "h.npz")
        found = Measurement(
            height,
            seen,
            done.capture,
            scene,
            source=str(out / "h.npz"),
            rig=str(rig),
            simulated=devices.camera == "virtual",
            saved=("c.npz", "h.npz"),
        )
        write_measurement_report(out / "report.html", found)
    good = height.good
    noise, rig_error = (
        float(np.median(sigma[good])) if good.any() else float("nan")
        for sigma in (height.sigma, height.calibration_sigma)
    )
    numbers = {
        **done.numbers(),
        "wrong_frames": wrong,
        "good_share": float(good.mean()),
        "noise_mm": noise,
        "rig_mm": rig_error,
    }
    write_json(json_path, numbers)
    print_notices(height.notices)  # the correspondence's among them
    table(
        f"Measured in {out}",
        {
            "camera": devices.camera,
            "frames": f"{len(shown)} in {number(done.seconds, 's')}",
            "good": number(100 * good.mean(), "% of the pixels"),
            "height": f"{length(height.z[good].min())} to {length(height.z[good].max())}"
            if good.any()
            else "-",
            "sigma": f"{noise_and_rig(noise, rig_error)} (medians)",
            "report": str(out / "report.html"),
        },
    )
    if wrong:
        numbered = ", ".join(map(str, wrong))
        raise InputError(
            f"frames {numbered} fit the preceding pattern better than their own: the display had "
            "not settled; run "
            "optolever sync"
        )
