"""`optolever measure`: capture, decode, reconstruct and report with a rig, in one go."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from optolever import InputError

from .options import FILE, json_option, sample
from .outputs import Program
from .rig_capture import RigCapture, capture_rig
from .rig_devices import device_options, devices_of
from .show import length, number, print_notices, progress, table, write_json

if TYPE_CHECKING:
    from optolever.decode import Correspondence

__all__ = ["command"]

SAMPLE = """
$ optolever measure --rig rig.toml --out press1
Measured in press1
  camera  serial:22781
  frames  36 in 2.9 s
  good    97.1 % of the pixels
  height  -0.002 mm to 0.31 mm
  sigma   1.2 um (median)
  report  press1/report.html
"""


@click.command("measure", cls=Program, epilog=sample(SAMPLE))
@device_options
@click.option(
    "--sequence", metavar="NAME[:KEY=VALUE,...]", default="gray+phase", show_default=True, help="To show."
)
@click.option("--out", type=FILE, required=True, metavar="DIR", help="Folder to make: capture, maps, report.")
@json_option
def command(rig: Path, sequence: str, out: Path, json_path: Path | None, **given: Any) -> None:
    """Take a capture with a rig and make heights and a report.

    DIR gets capture/, c.npz, h.npz and report.html. Every frame is checked to be nearer to its own pattern
    than to the one shown before it: a swap is not the light.
    """
    import numpy as np

    from optolever.decode import decode
    from optolever.experiments import write_record_report
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
        seen = decode(done.capture.frames, shown)
        seen.save(out / "c.npz")
        wrong = frames_of_another(done, seen)
        step("reconstruct")
        height = reconstruct(seen, scene)
        height.save(out / "h.npz")
        write_record_report(out / "report.html", height, seen, done.capture, str(out / "h.npz"))
    good = height.good
    numbers = {
        **done.numbers(),
        "wrong_frames": wrong,
        "good_share": float(good.mean()),
        "sigma_mm": float(np.median(height.total_sigma[good])) if good.any() else float("nan"),
    }
    write_json(json_path, numbers)
    print_notices(seen.notices)
    print_notices(height.notices)
    table(
        f"Measured in {out}",
        {
            "camera": devices.camera,
            "frames": f"{len(shown)} in {number(done.seconds, 's')}",
            "good": number(100 * good.mean(), "% of the pixels"),
            "height": f"{length(height.z[good].min())} to {length(height.z[good].max())}"
            if good.any()
            else "-",
            "sigma": f"{length(numbers['sigma_mm'])} (median)",
            "report": str(out / "report.html"),
        },
    )
    if wrong:
        numbered = ", ".join(map(str, wrong))
        raise InputError(f"frames {numbered} are nearer to the pattern before theirs; run optolever sync")


def frames_of_another(done: RigCapture, seen: "Correspondence") -> list[int]:
    """Frames that the pattern shown before them explains better than their own, at the decoded places.

    Light of a pixel is an offset and a gain times the pattern's level at its place; both by least squares.
    """
    import numpy as np

    sequence = done.capture.sequence
    good = (seen.flags == 0).ravel()
    places = np.flatnonzero(good)[:: max(1, int(good.sum()) // 20_000)]
    if len(places) == 0:
        return []
    u = np.clip(np.rint(seen.u.ravel()[places]), 0, sequence.cols - 1).astype(int)
    v = np.clip(np.rint(seen.v.ravel()[places]), 0, sequence.rows - 1).astype(int)
    shown = np.array([sequence.render_frame(k)[v, u] for k in range(len(sequence))], np.float64)
    light = done.capture.frames.reshape(len(sequence), -1)[:, places].astype(np.float64)
    level = shown - shown.mean(axis=0)
    gain = (level * light).sum(axis=0) / np.maximum((level**2).sum(axis=0), 1e-9)
    model = light.mean(axis=0) + gain * level
    own = ((light[1:] - model[1:]) ** 2).sum(axis=1)
    before = ((light[1:] - model[:-1]) ** 2).sum(axis=1)
    return [int(k) + 1 for k in np.flatnonzero(before < own)]
