"""`optolever simulate`: frames of a dented mirror by a virtual sensor.

$ optolever simulate --scene paper-simulation --pixels 256x256 \\
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

import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import optolever as ol
from optolever import InputError

from .arguments import Opt, program
from .options import Colour, Dent, Json, Noise, Renderer, SceneName, Seed, Shown, Size, in_colour, load_scene
from .outputs import NewFolder
from .printing import number, progress, table, write_json


@program("simulate", __doc__)
def command(
    scene_name: SceneName,
    out: Annotated[Path, Opt("--out DIR", "Folder to make; it must be new or empty.", NewFolder())],
    dent: Dent = None,
    sequence: Shown = "gray+phase",
    noise: Noise = 0.0,
    size: Size = None,
    seed: Seed = 0,
    renderer: Renderer = "auto",
    colour: Colour = None,
    json_path: Json = None,
) -> None:
    """Simulate a capture: frames of a scene's mirror.

    DIR receives capture.toml, frames/*.png, scene.toml and truth.npz: for every camera pixel the exact u, v,
    x, y, z, normal, incidence, visible. With --colour it receives images/*.png, by the scene's
    pattern.stripes, sensor.mix and sensor.mosaic.
    """
    scene = load_scene(scene_name, size, exact=True)
    pressed = dent or scene.dent or "flat"
    scene = replace(scene, dent=pressed)
    surface = ol.scene.dent_from_text(pressed, scene)
    shown = ol.patterns.sequence_from_text(sequence, scene.pattern.rows, scene.pattern.cols)
    shown = in_colour(shown, colour)
    with ol.files.together(), progress() as step:
        with ol.files.atomic_folder(out) as folder:
            step("trace the truth")
            truth = ol.scene.trace(scene, surface)
            if not truth.visible.any():
                mirror = f"{scene.mirror.length:.4g} x {scene.mirror.width:.4g} mm"
                cure = "check the poses, and that all lengths are in millimetres"
                raise InputError(f"no pixel sees the pattern in {scene_name}'s mirror of {mirror}: {cure}")
            step(f"capture {shown.exposures} frames")
            start = time.perf_counter()
            take = ol.projector.capture if colour is None else ol.projector.capture_colour
            record = take(scene, surface, shown, renderer=renderer, noise=noise, seed=seed, progress=step)
            seconds = time.perf_counter() - start
            levels = record.frames if isinstance(record, ol.projector.Capture) else record.images
            step("write")
            record.save(folder, truth)
        numbers = {
            "frames": shown.exposures,
            "rows": scene.camera.rows,
            "cols": scene.camera.cols,
            "visible_share": float(truth.visible.mean()),
            "mean_level": float(levels.mean()),
            "seconds": seconds,
        }
        write_json(json_path, numbers)
    rows = {
        "scene": scene.name,
        "dent": pressed,
        "sequence": sequence,
        "frames": f"{shown.exposures} of {scene.camera.rows} x {scene.camera.cols}",
        "visible": number(100 * numbers["visible_share"], "% of the pixels"),
        "mean level": number(numbers["mean_level"]),
        "time": number(seconds, "s"),
    }
    table(f"Capture in {out}", rows)
