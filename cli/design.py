"""`optolever design`: sequences for a scene, ranked by predicted height error."""

import math
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import optolever as ol
from optolever import InputError

from .arguments import sample
from .options import (
    dent_of,
    dent_option,
    json_option,
    load_scene,
    renderer_option,
    scene_option,
    size_option,
)
from .outputs import OutputFile, Program
from .show import grid, number, progress, table, write_json

if TYPE_CHECKING:
    from optolever.experiments.design import Design, DesignRow

__all__ = ["command"]

SAMPLE = """
$ optolever design --scene prism48 --size 96x128 --frames 14 --rows 3 --out best.toml
Height error, rms in mm: prism48, at most 14 frames
sequence                               frames  time   predicted  +-   simulated  wrong order  measured
phase:steps=3,periods=4.53333/4.37143  12      0.2 s  6.8e-05    1 %  6.61e-05   0e+00        100 %
phase:steps=3,periods=3.70909/3.6      12      0.2 s  6.922e-05  1 %  6.587e-05  0e+00        99.78 %
phase:steps=3,periods=5.56364/5.32174  12      0.2 s  7.183e-05  1 %  7.22e-05   0e+00        100 %
Choice
  sequence    phase:steps=3,periods=4.53333/4.37143
  candidates  18
  time        predict 37.78, simulate 4.291, total 42.07 s
  written to  best.toml
"""

HEADER = ("sequence", "frames", "time", "predicted", "+-", "simulated", "wrong order", "measured", "")


SHARE = click.FloatRange(0, 1, max_open=True)


@click.command("design", cls=Program, epilog=sample(SAMPLE))
@scene_option
@dent_option
@click.option(
    "--frames", type=click.IntRange(min=2), metavar="N", help="Maximum number of frames; default 24."
)
@click.option("--time", "seconds", type=click.FloatRange(min=0, min_open=True), metavar="SECONDS",
              help="Maximum display time, in place of --frames.")  # fmt: skip
@click.option("--refresh", type=click.FloatRange(min=0, min_open=True), default=60.0, show_default=True,
              metavar="HZ", help="Frames that the display shows per second.")  # fmt: skip
@click.option("--code", "codes", multiple=True, metavar="PATTERN[@DECODER]",
              help="Compare these codes, each as in --add, in place of a ranking; the next five options are "
              "then axes: each may be given several times.")  # fmt: skip
@click.option("--noise", "noises", multiple=True, type=click.FloatRange(min=0), default=(1.0,),
              metavar="LEVELS", help="Noise of a frame, 8-bit levels.")  # fmt: skip
@click.option("--lag", "lags", multiple=True, type=SHARE, default=(0.0,), metavar="SHARE",
              help="Share of the preceding frame in each simulated frame; not predicted.")  # fmt: skip
@click.option("--gamma", "gammas", multiple=True, type=click.FloatRange(min=0, min_open=True), metavar="G",
              help="Gamma of the display in place of the scene's; unknown to the decoder.")  # fmt: skip
@click.option("--flicker", "flickers", multiple=True, type=SHARE, metavar="SHARE",
              help="Amplitude of the light's oscillation at 100 Hz, in simulated frames.")  # fmt: skip
@click.option("--exposure", type=click.FloatRange(min=0), default=0.0, metavar="MS",
              help="Exposure of a frame, rounded up to full refreshes.")  # fmt: skip
@click.option("--blur", "blurs", multiple=True, type=click.FloatRange(min=0), metavar="CELLS",
              help="Rms blur in place of the scene's.")  # fmt: skip
@click.option("--failure", type=click.FloatRange(0, 1), default=1e-3, show_default=True, metavar="RATE",
              help="Largest probability of a wrong fringe order or code bit.")  # fmt: skip
@click.option("--add", "added", multiple=True, metavar="PATTERN",
              help="Also rank a sequence; a folder of images with a coordinates.toml ([[frames]] file, axis) "
              "or MODULE:FUNCTION, where FUNCTION(rows, cols) returns a patterns.Sequence or images; "
              "@MODULE:FUNCTION after it: a decoder of yours (simulated only).")  # fmt: skip
@click.option("--verify", type=click.IntRange(min=0), default=3, show_default=True, metavar="N",
              help="Number of the best candidates to simulate.")  # fmt: skip
@click.option("--rows", "shown", type=click.IntRange(min=1), default=12, show_default=True, metavar="N",
              help="Rows of the table to print; the JSON file has all.")  # fmt: skip
@renderer_option
@size_option
@click.option(
    "--out",
    type=OutputFile(".toml", bare=False),
    metavar="FILE.toml",
    help="Gets the best sequence, for capture --sequence.",
)
@click.option("--chart", type=OutputFile(".png", bare=False), metavar="FILE.png",
              help="With --code: error over CPU seconds and seconds of acquisition.")  # fmt: skip
@click.option("--csv", "csv_path", type=OutputFile(".csv", bare=False), metavar="FILE.csv",
              help="With --code: all numbers.")  # fmt: skip
@json_option
def command(
    scene_name: str,
    dent: str | None,
    frames: int | None,
    seconds: float | None,
    refresh: float,
    codes: tuple[str, ...],
    noises: tuple[float, ...],
    lags: tuple[float, ...],
    gammas: tuple[float, ...],
    flickers: tuple[float, ...],
    blurs: tuple[float, ...],
    exposure: float,
    failure: float,
    added: tuple[str, ...],
    verify: int,
    shown: int,
    renderer: str,
    size: tuple[int, int] | None,
    out: Path | None,
    chart: Path | None,
    csv_path: Path | None,
    json_path: Path | None,
) -> None:
    """Rank codes for a scene by predicted error; simulate the best.

    The prediction runs the decoder on simulated images of the scene (of a large camera: on windows of its
    image), and then the solver. Codes that fail too often or lose pixels are listed last; codes of --add are
    always printed. +-: standard error of the prediction; measured: share of the pixels with a height.

    With --code: predicted and simulated error of the named codes beside CPU seconds and seconds of
    acquisition, for every combination of noise and faults.
    """
    from optolever.experiments.design import frame_rate, own_candidate, run_design, user_candidate

    rate = frame_rate(refresh, exposure)
    faults = [
        ol.experiments.Faults(*each)
        for each in product(lags, gammas or (None,), flickers or (None,), blurs or (None,))
    ]
    if codes:
        scene = load_scene(scene_name, size)
        settings = {"faults": faults, "noises": noises, "rate": rate, "renderer": renderer}
        _compare(scene, dent_of(scene, dent), codes, settings, size is not None, chart, csv_path, json_path)
        return
    if len(faults) * len(noises) > 1 or chart or csv_path:
        raise InputError("--code: missing; several noises or faults, --chart and --csv compare named codes")
    (fault,), (noise,) = faults, noises
    budget = _budget(frames, seconds, rate)
    scene = fault.on(load_scene(scene_name, size))
    cells, resized = (scene.pattern.rows, scene.pattern.cols), size is not None
    extra = [user_candidate(text, *cells, resized=resized) for text in added if "@" not in text]
    own = [own_candidate(text, *cells, resized=resized) for text in added if "@" in text]
    with progress() as step:
        design = run_design(
            scene,
            dent_of(scene, dent),
            frames=budget,
            refresh=rate,
            noise=noise,
            failure=failure,
            verify=verify,
            extra=extra,
            own=own,
            lag=fault.lag,
            renderer=renderer,
            progress=step,
        )
    with ol.files.together():
        if out is not None and design.chosen is not None:
            design.chosen.sequence.save(out)
        write_json(json_path, design.to_dict())
    grid(
        f"Height error, rms in mm: {scene.name}, at most {budget} frames",
        HEADER,
        map(_cells, _printed(design, shown, added)),
    )
    chosen = design.chosen
    table(
        "Choice",
        {
            "sequence": "none: no candidate meets the limits" if chosen is None else chosen.text,
            "candidates": str(len(design.rows)),
            "time": ", ".join(f"{name} {number(value)}" for name, value in design.seconds.items()) + " s",
            **({"written to": str(out)} if out is not None and chosen is not None else {}),
        },
    )


def _compare(
    scene: "ol.scene.Scene",
    dent: str | None,
    codes: tuple[str, ...],
    settings: dict[str, Any],
    resized: bool,
    chart: Path | None,
    csv_path: Path | None,
    json_path: Path | None,
) -> None:
    """Print, draw and write the comparison of named codes."""
    from dataclasses import asdict

    from optolever.experiments.design import compare_codes, write_tradeoff_chart, write_tradeoff_csv

    with progress() as step:
        rows = list(compare_codes(scene, dent, codes, resized=resized, progress=step, **settings))
    with ol.files.together():
        if csv_path is not None:
            write_tradeoff_csv(csv_path, rows)
        if chart is not None:
            write_tradeoff_chart(chart, rows)
        write_json(json_path, {"rows": [asdict(row) for row in rows]})
    lines = []
    for row in rows:
        axes = [row.noise, row.lag, row.gamma, row.flicker, row.blur]
        values = [row.acquisition_seconds, row.cpu_seconds, row.predicted, row.simulated, 100 * row.share]
        cells = [number(value, unit) if math.isfinite(value) else ""
                 for value, unit in zip(values, ("s", "s", "", "", "%"), strict=True)]  # fmt: skip
        lines.append([row.code, *("" if value is None else f"{value:g}" for value in axes), *cells, row.why])
    names = ("noise", "lag", "gamma", "flicker", "blur", "acquire", "CPU", "predicted", "simulated")
    grid(f"Height error, rms in mm: {scene.name}", ("code", *names, "measured", ""), lines)


def _printed(design: "Design", shown: int, added: tuple[str, ...]) -> "list[DesignRow]":
    """The best rows, and the rows of --add."""
    return design.rows[:shown] + [row for row in design.rows[shown:] if row.text in added]


def _budget(frames: int | None, seconds: float | None, refresh: float) -> int:
    if frames is not None and seconds is not None:
        raise InputError("--frames and --time: exclude each other, leave one out")
    if seconds is None:
        return frames or 24
    if seconds * refresh < 2:
        raise InputError(
            f"--time {seconds:g}: shows less than two frames, must be at least {2 / refresh:.3g}"
        )
    return int(seconds * refresh + 1e-9)


def _cells(row: "DesignRow") -> list[Any]:
    return [
        row.text,
        str(row.frames),
        number(row.seconds, "s"),
        number(row.predicted),
        f"{100 * row.spread:.0f} %" if math.isfinite(row.spread) else "",
        number(row.simulated) if math.isfinite(row.simulated) else "",
        f"{row.failure:.0e}" if math.isfinite(row.failure) else "",
        number(100 * row.share, "%"),
        row.why,
    ]
