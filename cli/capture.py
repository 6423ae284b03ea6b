"""`optolever capture`: frames of a dented mirror by a virtual sensor, or of a real one by a rig's camera."""

import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from optolever import InputError

from .options import FILE, dent_of, json_option, load_scene, sample, virtual_sensor
from .outputs import Program
from .rig_capture import capture_rig
from .rig_devices import device_options, devices_of
from .show import number, progress, table, write_json

if TYPE_CHECKING:
    from optolever.scene import Scene

__all__ = ["command"]

SAMPLE = """
$ optolever capture --scene paper-simulation --size 256x256 \\
      --dent gaussian:peak=1.3,sigma=20 --noise 1 --seed 1 --out capture
Capture in capture
  scene       paper-simulation
  dent        gaussian:peak=1.3,sigma=20
  sequence    gray+phase
  frames      22 of 256 x 256
  visible     100 % of the pixels
  mean level  123.6
  time        0.209 s
"""


@click.command("capture", cls=Program, epilog=sample(SAMPLE))
@virtual_sensor(scene=None, noise=0.0, required=False)
@partial(device_options, required=False)
@click.option("--keep", is_flag=True, help="Of a rig: keep the recording of all images, DIR.recording.")
@click.option(
    "--out", type=FILE, required=True, metavar="DIR", help="Folder to make; it must be new or empty."
)
@json_option
def command(
    scene_name: str | None,
    rig: Path | None,
    keep: bool,
    dent: str | None,
    sequence: str,
    noise: float,
    seed: int,
    renderer: str,
    size: tuple[int, int] | None,
    out: Path,
    json_path: Path | None,
    **given: Any,
) -> None:
    """Render, or take by a rig's camera, a sequence in a mirror.

    DIR receives capture.toml and frames/*.png, and from a virtual sensor scene.toml and truth.npz: for every
    camera pixel the exact u, v, x, y, z, normal, incidence, visible.

    With --rig its display shows the frames, and its camera takes the first image of each whose exposure began
    after the pattern had settled ([sync], else after 0.5 s); acquisition.jsonl lists the times and the
    repeated frames. The recording of an aborted capture stays in DIR.recording (optolever replay).
    """
    if rig is not None:
        _take(rig, sequence, out, keep=keep, json_path=json_path, given=given)
        return
    if scene_name is None:
        raise click.UsageError("Missing option '--scene' (a virtual sensor), or '--rig' (a camera).")
    from optolever.files import atomic_folder, together
    from optolever.patterns import sequence_from_text
    from optolever.projector import capture
    from optolever.scene import dent_from_text, trace

    scene = load_scene(scene_name, size, exact=True)
    pressed = dent_of(scene, dent)
    scene = replace(scene, dent=pressed)
    surface = dent_from_text(pressed, scene)
    shown = sequence_from_text(sequence, scene.pattern.rows, scene.pattern.cols)
    with together(), progress() as step:
        with atomic_folder(out) as folder:
            step("trace the truth")
            truth = trace(scene, surface)
            if not truth.visible.any():
                raise InputError(f"--scene {scene_name}: {_missed(scene)}")
            step(f"capture {len(shown)} frames")
            start = time.perf_counter()
            record = capture(scene, surface, shown, renderer=renderer, noise=noise, seed=seed, progress=step)
            seconds = time.perf_counter() - start
            step("write")
            record.save(folder, truth)
        numbers = {
            "frames": len(shown),
            "rows": scene.camera.rows,
            "cols": scene.camera.cols,
            "visible_share": float(truth.visible.mean()),
            "mean_level": float(record.frames.mean()),
            "seconds": seconds,
        }
        write_json(json_path, numbers)
    table(
        f"Capture in {out}",
        {
            "scene": scene.name,
            "dent": pressed,
            "sequence": sequence,
            "frames": f"{len(shown)} of {scene.camera.rows} x {scene.camera.cols}",
            "visible": number(100 * numbers["visible_share"], "% of the pixels"),
            "mean level": number(numbers["mean_level"]),
            "time": number(seconds, "s"),
        },
    )


def _missed(scene: "Scene") -> str:
    """Why no pixel has a pattern in it, as far as the central ray says."""
    camera, mirror = scene.camera, scene.mirror
    origin, direction = camera.rays_at(0.5 * (camera.rows - 1), 0.5 * (camera.cols - 1))
    x, y = (float(part) for part in (origin - origin[2] / direction[2] * direction)[:2])
    return (
        f"no pixel sees the pattern in the mirror: the image's centre is at x = {x:.4g}, y = {y:.4g} mm of a "
        f"mirror of {mirror.length:.4g} x {mirror.width:.4g} mm; check the poses, and that all lengths are "
        "in millimetres"
    )


def _take(
    rig: Path, sequence: str, out: Path, *, keep: bool, json_path: Path | None, given: dict[str, Any]
) -> None:
    """With the devices of a rig."""
    from optolever.files import together
    from optolever.patterns import sequence_from_text
    from optolever.scene import load

    pattern = load(rig).pattern
    shown = sequence_from_text(sequence, pattern.rows, pattern.cols)
    devices = devices_of(rig, **given)
    with together():
        done = capture_rig(rig, devices, shown, out, keep=keep)
        write_json(json_path, done.numbers())
    rows, cols = done.capture.shape
    numbers = done.numbers()
    table(
        f"Capture in {out}",
        {
            "camera": devices.camera,
            "sequence": sequence,
            "frames": f"{len(shown)} of {rows} x {cols}",
            "images": f"{done.lost} lost, {numbers['incomplete']} incomplete",
            "patterns": f"{numbers['repeats']} shown again, {numbers['late']} late",
            "time": number(done.seconds, "s"),
        },
    )
