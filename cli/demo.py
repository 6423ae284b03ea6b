"""`optolever demo`: the whole chain on a virtual sensor, and a report."""

from pathlib import Path

import click

from .options import FILE, json_option, load_scene, report_into, sample, size_option
from .show import number, progress, table, write_json

__all__ = ["command"]

SAMPLE = """
$ optolever demo --size 256x256 --out demo
"""


@click.command("demo", epilog=sample(SAMPLE))
@click.option(
    "--scene", "scene_name", metavar="PRESET_OR_TOML", default="paper-simulation", show_default=True
)
@click.option("--dent", metavar="NAME[:KEY=VALUE,...]", default="raised-cosine", show_default=True)
@click.option("--sequence", metavar="NAME[:KEY=VALUE,...]", default="gray+phase", show_default=True)
@click.option(
    "--noise",
    type=click.FloatRange(min=0),
    default=1.0,
    show_default=True,
    metavar="LEVELS",
    help="Standard deviation of added Gaussian noise, in 8-bit levels.",
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the noise.")
@click.option(
    "--blur",
    type=click.FloatRange(min=0),
    metavar="CELLS",
    help="Rms blur of the pattern in cells, in place of the scene's own.",
)
@click.option(
    "--renderer",
    type=click.Choice(["auto", "gl", "numpy"]),
    default="auto",
    show_default=True,
    help="auto: OpenGL where there is a context, else NumPy.",
)
@size_option
@click.option(
    "--out", type=FILE, default=Path("out/demo"), show_default=True, metavar="DIR", help="Gets report.html."
)
@json_option
def command(
    scene_name: str,
    dent: str,
    sequence: str,
    noise: float,
    seed: int,
    blur: float | None,
    renderer: str,
    size: tuple[int, int] | None,
    out: Path,
    json_path: Path | None,
) -> None:
    """Show a sequence to a dented mirror, decode what the camera saw, reconstruct the mirror, compare.

    DIR/report.html is one self-contained page: patterns, frames, maps of u and v, flags, the height as a
    picture and as a surface that can be turned, error, error against sigma, the time of every stage.
    """
    report_into(out, json_path)
    from dataclasses import replace

    from optolever.experiments import run_demo, write_demo_report

    scene = load_scene(scene_name, size)
    if blur is not None:
        scene = replace(scene, pattern=replace(scene.pattern, blur_px=blur))
    with progress() as step:
        result = run_demo(scene, dent, sequence, noise=noise, seed=seed, renderer=renderer, progress=step)
        step("report")
        out.mkdir(parents=True, exist_ok=True)
        result = write_demo_report(result, out / "report.html")
    numbers = result.to_dict()
    write_json(json_path, numbers)
    metrics, seconds = result.metrics, result.seconds
    table(
        f"Demo: {scene.name}, {dent}, {sequence}, {len(result.sequence)} frames",
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
