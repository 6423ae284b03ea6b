"""`optolever demo`: the full chain on a virtual sensor, and a report."""

from pathlib import Path

import click

from .options import dent_of, json_option, load_scene, sample, virtual_sensor
from .outputs import Program, report_option
from .show import number, print_notices, progress, table, write_json

__all__ = ["command"]

SAMPLE = """
$ optolever demo --size 256x256 --out demo
Demo: paper-simulation, raised-cosine:peak=1.3, gray+phase, 22 frames
  height error                0.0001273 of the peak depth, rms
  unflagged                   98.83 % of the visible pixels
  rms(error / sigma), u       0.9828
  rms(error / sigma), v       0.972
  rms(error / sigma), height  1.002
  time                        trace 0.05844, capture 0.08406, decode 0.8246,
                              reconstruct 0.1971, report 2.664, total 3.828 s
  peak memory                 0.4656 GiB
  report                      demo/report.html
"""


@click.command("demo", cls=Program, epilog=sample(SAMPLE))
@virtual_sensor(scene="paper-simulation", noise=1.0)
@click.option(
    "--blur",
    type=click.FloatRange(min=0),
    metavar="CELLS",
    help="Rms blur of the pattern in cells, in place of the scene's.",
)
@report_option("demo", "Gets report.html and the data behind it.", "report.html", "figures.csv")
@json_option
def command(
    scene_name: str,
    dent: str | None,
    sequence: str,
    noise: float,
    seed: int,
    blur: float | None,
    renderer: str,
    size: tuple[int, int] | None,
    out: Path,
    json_path: Path | None,
) -> None:
    """Simulate a measurement, reconstruct it, compare; one page.

    The frames of a dented mirror are simulated and decoded; the height is reconstructed and compared with the
    truth.

    DIR/report.html needs no network: maps and profiles with the numbers under the pointer, a rotatable
    surface, error over sigma, flags, frames, the rig to scale, the time of every stage. The full data (.npz)
    and every number of the page (figures.csv) are in the same folder.
    """
    from dataclasses import replace

    from optolever.experiments import run_demo, write_demo_report
    from optolever.files import report_folder, together

    scene = load_scene(scene_name, size, exact=True)
    if blur is not None:
        scene = replace(scene, pattern=replace(scene.pattern, blur_px=blur))
    pressed = dent_of(scene, dent)
    with progress() as step:
        result = run_demo(scene, dent, sequence, noise=noise, seed=seed, renderer=renderer, progress=step)
        step("report")
        with report_folder(out), together():
            result = write_demo_report(result, out / "report.html")
            numbers = result.to_dict()
            write_json(json_path, numbers)
    print_notices(result.height.notices)
    metrics, seconds = result.metrics, result.seconds
    table(
        f"Demo: {scene.name}, {pressed}, {sequence}, {len(result.sequence)} frames",
        {
            "height error": f"{number(metrics['height_rms_rel'])} of the peak depth, rms",
            "unflagged": number(100 * metrics["unflagged_share"], "% of the visible pixels"),
            "rms(error / sigma), u": number(metrics["sigma_ratio_u"]),
            "rms(error / sigma), v": number(metrics["sigma_ratio_v"]),
            "rms(error / sigma), height": number(metrics["sigma_ratio_height"]),
            "time": ", ".join(f"{name} {number(value)}" for name, value in seconds.items()) + " s",
            "peak memory": number(result.peak_bytes / 2**30, "GiB"),
            "report": str(out / "report.html"),
        },
    )
