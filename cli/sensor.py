"""`optolever sensor`: predicted measuring range and sensitivity of a scene."""

import time
from pathlib import Path
from typing import Annotated

from optolever import InputError

from .arguments import Opt, program
from .options import Json, Noise, SceneName, Shown, Size, load_scene
from .outputs import ReportFolder
from .show import grid, number, progress, table, write_json

__all__ = ["command"]

SAMPLE = """
$ optolever sensor --scene prism48 --pixels 128x96 --sweep angle=45/48/50 --out sensor
Sensor prism48
  visible_share          1
  slope_low_deg          -24.09
  slope_high_deg         21
  slope_worst_deg        3.217
  slope_y_deg            20.95
  reflection_margin_deg  2.829
  reflectance            1
  path_mm                22.29
  lever_cells_per_mrad   0.1189
  fold_radius_mm         66.63
  free_mode_median       0.5059
  sigma_mm               4.13e-05
  sigma_rms_mm           0.0001057
Sweep over angle
angle  sees  slope from  to, °  total up to, °  cells / mrad  folds below, mm  sigma, mm   rms, mm
45     1     -22.7       22.5   -0.171          0.113         60               6.8 × 10⁻⁵  2.0 × 10⁻⁴
48     1     -24.1       21     2.83            0.119         66.6             4.1 × 10⁻⁵  1.1 × 10⁻⁴
50     1     -25.1       20     4.83            0.123         71.5             4.1 × 10⁻⁵  1.0 × 10⁻⁴
Report
  page  sensor/report.html
  time  9.7 s
"""


SWEEP = Opt(
    "--sweep NAME=VALUE/...",
    "angle (deg), index, distance (mm), camera or pattern (factor on the pixels); again for more.",
)
FILES = ReportFolder("report.html")


@program("sensor", SAMPLE)
def command(
    scene_name: SceneName,
    sweeps: Annotated[tuple[str, ...], SWEEP] = (),
    sequence: Shown = "gray+phase",
    noise: Noise = 1.0,
    size: Size = None,
    out: Annotated[Path, Opt("--out DIR", "Gets report.html.", FILES)] = Path("out/sensor"),
    json_path: Json = None,
) -> None:
    """Map the measuring range and sensitivity of a scene.

    Slopes, total reflection, lever, free mode, error bars of the height. Computed at rest, on a thinned
    camera; error bars are those of the full one. A sweep computes the same numbers for other values of one
    parameter.
    """
    asked = [_sweep(text) for text in sweeps]
    from optolever.experiments.design import (
        COLUMNS,
        SWEEPS,
        SensorStudy,
        sensor_maps,
        sensor_rows,
        sweep_sensor,
        write_sensor_report,
    )
    from optolever.files import report_folder, together
    from optolever.patterns import sequence_from_text

    for name, _ in asked:
        if name not in SWEEPS:
            raise InputError(f"--sweep: {name!r} must be one of {', '.join(SWEEPS)}")
    scene = load_scene(scene_name, size)
    sequence_from_text(sequence, scene.pattern.rows, scene.pattern.cols)
    settings = {"scene": scene_name, "name": scene.name, "size": size, "sequence": sequence, "noise": noise}
    with progress(lines=True) as step:
        step("maps")
        start = time.perf_counter()
        maps = sensor_maps(scene, sequence, noise)
        seconds = {"maps": time.perf_counter() - start}
        rows: list[dict[str, float | str]] = []
        for name, values in asked:
            begun = time.perf_counter()
            for row in sweep_sensor(scene, name, values, sequence, noise):
                rows.append(row)
                step(f"sweep {name}", len(rows), sum(len(values) for _, values in asked))
            seconds[f"sweep {name}"] = time.perf_counter() - begun
        step("report")
        seconds["total"] = time.perf_counter() - start
        study = SensorStudy(maps, rows, settings | {"sweeps": list(sweeps)}, seconds)
        with report_folder(out), together():
            write_sensor_report(study, out / "report.html")
            write_json(json_path, study.to_dict())
    table(f"Sensor {scene.name}", {key: number(value) for key, value in maps.numbers().items()})
    for name, _ in asked:
        mine = [row for row in rows if row["sweep"] == name]
        grid(f"Sweep over {name}", [heading or name for _, heading in COLUMNS], sensor_rows(mine))
    table("Report", {"page": str(out / "report.html"), "time": number(seconds["total"], "s")})


def _sweep(text: str) -> tuple[str, list[float]]:
    name, equals, rest = text.partition("=")
    try:
        values = [float(part) for part in rest.split("/")]
    except ValueError:
        values = []
    if not equals or not values:
        raise InputError(f"--sweep: {text!r} must read name=value/value, such as angle=45/48")
    return name.strip(), values
