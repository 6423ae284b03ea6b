"""`optolever capture`: a virtual sensor looks at a dented mirror."""

import time
from pathlib import Path

import click

from .options import FILE, json_option, load_scene, sample, scene_option, size_option, writable
from .show import number, progress, table, write_json

__all__ = ["command"]

SAMPLE = """
$ optolever capture --scene paper-simulation --dent gaussian:peak=1.3,sigma=20 --sequence gray+phase \\
      --noise 1 --seed 1 --size 256x256 --out capture
"""


@click.command("capture", epilog=sample(SAMPLE))
@scene_option
@click.option(
    "--dent", metavar="NAME[:KEY=VALUE,...]", default="flat", show_default=True, help="What is pressed in."
)
@click.option(
    "--sequence",
    "sequence_text",
    metavar="NAME[:KEY=VALUE,...]",
    default="gray+phase",
    show_default=True,
    help="What the surface shows.",
)
@click.option(
    "--noise",
    type=click.FloatRange(min=0),
    default=0.0,
    show_default=True,
    metavar="LEVELS",
    help="Standard deviation of added Gaussian noise, in 8-bit levels.",
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the noise.")
@click.option(
    "--renderer",
    type=click.Choice(["auto", "gl", "numpy"]),
    default="auto",
    show_default=True,
    help="auto: OpenGL where there is a context, else NumPy.",
)
@size_option
@click.option(
    "--out", type=FILE, required=True, metavar="DIR", help="Folder to make; it must be new or empty."
)
@json_option
def command(
    scene_name: str,
    dent: str,
    sequence_text: str,
    noise: float,
    seed: int,
    renderer: str,
    size: tuple[int, int] | None,
    out: Path,
    json_path: Path | None,
) -> None:
    """Show a sequence to a dented mirror and keep what the camera sees.

    DIR receives capture.toml and frames/*.png, and, since the sensor is virtual, scene.toml and truth.npz:
    for every camera pixel the exact u, v, x, y, z, normal, incidence, visible.
    """
    writable(json_path)
    from optolever.files import atomic_folder
    from optolever.patterns import sequence_from_text
    from optolever.projector import capture
    from optolever.scene import dent_from_text, trace

    scene = load_scene(scene_name, size)
    surface = dent_from_text(dent, scene)
    sequence = sequence_from_text(sequence_text, scene.pattern.rows, scene.pattern.cols)
    with atomic_folder(out) as folder, progress() as step:
        step(f"capture {len(sequence)} frames")
        start = time.perf_counter()
        record = capture(scene, surface, sequence, renderer=renderer, noise=noise, seed=seed)
        seconds = time.perf_counter() - start
        step("trace the truth")
        truth = trace(scene, surface)
        step("write")
        record.save(folder)
        scene.save(folder / "scene.toml")
        truth.save(folder / "truth.npz")
    numbers = {
        "frames": len(sequence),
        "rows": scene.camera.rows,
        "cols": scene.camera.cols,
        "seconds": seconds,
        "visible_share": float(truth.visible.mean()),
        "mean_level": float(record.frames.mean()),
    }
    write_json(json_path, numbers)
    table(
        f"Capture in {out}",
        {
            "scene": scene.name,
            "dent": dent,
            "sequence": sequence_text,
            "frames": f"{len(sequence)} of {scene.camera.rows} x {scene.camera.cols}",
            "visible": number(100 * numbers["visible_share"], "% of the pixels"),
            "mean level": number(numbers["mean_level"]),
            "time": number(seconds, "s"),
        },
    )
