"""`optolever sensor`: predicted measuring range and sensitivity of a scene."""

import time
from collections.abc import Mapping
from typing import Annotated

from optolever import InputError

from .arguments import Opt, program
from .options import Json, Noise, SceneName, Shown, Size, load_scene
from .show import grid, number, progress, table, write_json

SAMPLE = """
$ optolever sensor --scene prism48 --pixels 128x96 --sweep angle=45/48/50
Sensor prism48
  visible_share          1
  slope_low_deg          -24.09
  ...
  sigma_rms_mm           0.0003058
Sweep over angle
angle  sees  slope from  to, °  total up to, °  cells / mrad  folds below, mm  sigma, mm  rms, mm
45     1     -22.72      22.5   -0.1715         0.1131        60               0.0001381  0.0004043
...
"""


SWEEP = Opt(
    "--sweep NAME=VALUE/...",
    "angle (deg), index, distance (mm), camera or pattern (factor on the pixels); again for more.",
)
#: Numbers of a sweep's table, and their headings.
COLUMNS = {
    "visible_share": "sees",
    "slope_low_deg": "slope from",
    "slope_high_deg": "to, °",
    "reflection_margin_deg": "total up to, °",
    "lever_cells_per_mrad": "cells / mrad",
    "fold_radius_mm": "folds below, mm",
    "sigma_mm": "sigma, mm",
    "sigma_rms_mm": "rms, mm",
}


@program("sensor", SAMPLE)
def command(
    scene_name: SceneName,
    sweeps: Annotated[tuple[str, ...], SWEEP] = (),
    sequence: Shown = "gray+phase",
    noise: Noise = 1.0,
    size: Size = None,
    json_path: Json = None,
) -> None:
    """Measuring range and sensitivity of a scene.

    Slopes, total reflection, lever, free mode, error bars: medians over the mirror at rest, on a thinned
    camera; error bars are those of the full one. Contacts of balls: until `live` loses cells. A sweep
    computes the same numbers for other values of one parameter.
    """
    from optolever.experiments.design import SWEEPS, sensor_maps, sweep_sensor

    asked = [_sweep(text) for text in sweeps]
    for name, _ in asked:
        if name not in SWEEPS:
            raise InputError(f"--sweep: {name!r} must be one of {', '.join(SWEEPS)}")
    scene = load_scene(scene_name, size)
    settings = {"scene": scene_name, "name": scene.name, "size": size, "sequence": sequence, "noise": noise}
    start, rows = time.perf_counter(), list[dict[str, float | str]]()
    with progress() as step:
        step("maps")
        numbers = sensor_maps(scene, sequence, noise).numbers()
        for name, values in asked:
            for row in sweep_sensor(scene, name, values, sequence, noise):
                rows.append(row)
                step(f"sweep {name}", len(rows), sum(len(values) for _, values in asked))
    found = {"numbers": numbers, "sweeps": rows, "settings": settings | {"sweeps": list(sweeps)}}
    write_json(json_path, found | {"seconds": {"total": time.perf_counter() - start}})
    table(f"Sensor {scene.name}", {key: number(value) for key, value in numbers.items()})
    for name, _ in asked:
        mine = [row for row in rows if row["sweep"] == name]
        grid(f"Sweep over {name}", [name, *COLUMNS.values()], [_cells(row) for row in mine])


def _cells(row: Mapping[str, float | str]) -> list[str]:
    """Cells of a sweep's row; one without numbers says why."""
    if "why" in row:
        return [f"{row['value']:g}", str(row["why"]), *[""] * (len(COLUMNS) - 1)]
    return [number(float(row[key])) for key in ("value", *COLUMNS)]


def _sweep(text: str) -> tuple[str, list[float]]:
    name, _, rest = text.partition("=")
    try:
        return name.strip(), [float(part) for part in rest.split("/")]
    except ValueError:
        must = "must read name=value/value, such as angle=45/48"
        raise InputError(f"--sweep: {text!r} {must}") from None
