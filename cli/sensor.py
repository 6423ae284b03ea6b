"""`optolever sensor`: predicted measuring range and sensitivity of a scene."""

import time

from .arguments import program
from .options import Json, Noise, SceneName, Shown, Size, load_scene
from .show import number, progress, table, write_json

SAMPLE = """
$ optolever sensor --scene prism48 --pixels 128x96
Sensor prism48
  visible_share          1
  slope_low_deg          -24.09
  slope_high_deg         21
  ...
  reflection_margin_deg  2.829
  ...
  sigma_rms_mm           0.0003058
  ball_2mm_depth_mm      0.1241
"""


@program("sensor", SAMPLE)
def command(
    scene_name: SceneName,
    sequence: Shown = "gray+phase",
    noise: Noise = 1.0,
    size: Size = None,
    json_path: Json = None,
) -> None:
    """Measuring range and sensitivity of a scene.

    Slopes, total reflection, lever, free mode, error bars: medians over the mirror at rest, on a thinned
    camera; error bars of the full one. Balls: how deep they may press before `live` loses cells.
    """
    from optolever.experiments.design import sensor_maps

    scene = load_scene(scene_name, size)
    settings = {"scene": scene_name, "name": scene.name, "size": size, "sequence": sequence, "noise": noise}
    start = time.perf_counter()
    with progress() as step:
        step("maps")
        numbers = sensor_maps(scene, sequence, noise).numbers()
    seconds = {"total": time.perf_counter() - start}
    write_json(json_path, {"numbers": numbers, "settings": settings, "seconds": seconds})
    table(f"Sensor {scene.name}", {key: number(value) for key, value in numbers.items()})
