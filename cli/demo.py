"""`optolever demo`: the full chain on a virtual sensor, and a report.

$ optolever demo --pixels 256x256 --out demo
Demo: paper-simulation, raised-cosine:peak=1.3, gray+phase, 22 frames
  height error                280 nm rms, median 63 nm
                              0.0002191 of the peak depth, rms
  sigma                       370 nm rms
  unflagged                   97.63 % of the visible pixels
  rms(error / sigma), u       0.915
  rms(error / sigma), v       0.9105
  rms(error / sigma), height  0.8096
  time                        trace 0.172, capture 0.3159, decode 0.7326,
                              reconstruct 0.255, report 0.596, total 2.071 s
  peak memory                 0.3953 GiB
  report                      demo/report.html
"""

from pathlib import Path
from typing import Annotated

import optolever as ol

from .arguments import Opt, program
from .options import Dent, Full, Json, Noise, Renderer, SceneName, Seed, Shown, Size, load_scene
from .outputs import PAGE, PAGE_IN_FULL, ReportFolder
from .printing import length, number, print_notices, progress, table, write_json

#: By another process, while this one simulates and compiles the decoder's pixels.
_COMPILED = {
    "optolever.decode": "optolever.decode:compile_neighbours",
    "optolever.reconstruct": "optolever.samples:compile_heights",
}
OUT = Opt("--out DIR", "Gets report.html and the data behind it.", ReportFolder(*PAGE, full=PAGE_IN_FULL))


@program("demo", __doc__)
def command(
    scene_name: SceneName = "paper-simulation",
    dent: Dent = None,
    sequence: Shown = "gray+phase",
    noise: Noise = 1.0,
    size: Size = None,
    out: Annotated[Path, OUT] = Path("out/demo"),
    seed: Seed = 0,
    renderer: Renderer = "auto",
    full: Full = False,
    json_path: Json = None,
) -> None:
    """Simulate a measurement, reconstruct it, compare; one page.

    The frames of a dented mirror are simulated and decoded; the height is reconstructed and compared with the
    truth.

    DIR/report.html needs no network: maps and profiles with the numbers under the pointer, a rotatable
    surface, error over sigma, flags, frames, the rig to scale, the time of every stage. The heights
    (height.npz) and every number of the page (figures.csv) are in the same folder.
    """
    from optolever.kernels import compiled_beside  # NumPy, which --help does without

    scene = load_scene(scene_name, size, exact=True)
    pressed = dent or scene.dent or "flat"
    with compiled_beside(_COMPILED) as wait, progress() as step:

        def stage(name: str, *numbers: int) -> None:
            if wait is not None and name == "reconstruct":
                step("compile kernels (once)")
                wait()
            step(name, *numbers)

        result = ol.samples.run_demo(
            scene, dent, sequence, noise=noise, seed=seed, renderer=renderer, progress=stage
        )
        step("report")
        with ol.files.together():
            result = ol.report.write_demo_report(result, out / "report.html", full=full)
            numbers = result.to_dict()
            write_json(json_path, numbers)
    print_notices(result.height.notices)
    metrics, seconds = result.metrics, result.seconds
    middle = length(metrics["height_median_mm"])
    rows = {
        "height error": f"{length(metrics['height_rms_mm'])} rms, median {middle}",
        "": f"{number(metrics['height_rms_rel'])} of the peak depth, rms",
        "sigma": f"{length(metrics['height_sigma_mm'])} rms",
        "unflagged": number(100 * metrics["unflagged_share"], "% of the visible pixels"),
        "rms(error / sigma), u": number(metrics["sigma_ratio_u"]),
        "rms(error / sigma), v": number(metrics["sigma_ratio_v"]),
        "rms(error / sigma), height": number(metrics["sigma_ratio_total"]),
        "time": ", ".join(f"{name} {number(value)}" for name, value in seconds.items()) + " s",
        "peak memory": number(result.peak_bytes / 2**30, "GiB"),
        "report": str(out / "report.html"),
    }
    table(f"Demo: {scene.name}, {pressed}, {sequence}, {len(result.sequence)} frames", rows)
