"""`optolever design`: sequences for a scene, ranked by predicted height error."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from optolever import InputError

from .arguments import ABOVE_0, AT_LEAST_0, SHARE, Opt, Rare, program
from .options import Dent, Json, Renderer, SceneName, Size, dent_of, load_scene
from .outputs import OutputFile
from .show import grid, number, progress, table, write_json

if TYPE_CHECKING:
    from optolever.experiments.design import Candidate, Design, DesignRow, OwnCandidate
    from optolever.scene import Scene

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

HEADER = ("sequence", "frames", "time", "cpu", "predicted", "+-", "simulated", "wrong order", "measured", "")
_OWN = (
    "a folder of images with a coordinates.toml ([[frames]] file, axis) or MODULE:FUNCTION, where "
    "FUNCTION(rows, cols) returns a patterns.Sequence or images; @MODULE:FUNCTION after it: a decoder of "
    "yours (simulated only)."
)
_SEVERAL = "; with --code several times: the axis."


@program("design", SAMPLE)
def command(
    scene_name: SceneName,
    dent: Dent = None,
    frames: Annotated[
        int | None, Opt("--frames N", "Maximum number of frames; default 24.", click.IntRange(min=2))
    ] = None,
    seconds: Annotated[
        float | None, Opt("--time SECONDS", "Maximum display time, in place of --frames.", ABOVE_0)
    ] = None,
    codes: Annotated[
        tuple[str, ...], Opt("--code NAME", f"Compare only such codes: a sequence; {_OWN}")
    ] = (),
    added: Annotated[tuple[str, ...], Opt("--add PATTERN", f"Also rank a sequence; {_OWN}")] = (),
    noise: Annotated[
        tuple[float, ...], Opt("--noise LEVELS", f"Rms noise, 8-bit levels; default 1{_SEVERAL}", AT_LEAST_0)
    ] = (),
    lag: Annotated[
        tuple[float, ...],
        Opt("--lag SHARE", f"Share of the preceding frame in each simulated frame{_SEVERAL}", SHARE),
    ] = (),
    gamma: Annotated[
        tuple[float, ...],
        Opt("--gamma G", f"Gamma of the display, unknown to the decoder{_SEVERAL}", ABOVE_0),
    ] = (),
    flicker: Annotated[
        tuple[float, ...],
        Opt("--flicker SHARE", f"Amplitude of the light at 100 Hz, in simulated frames{_SEVERAL}", SHARE),
    ] = (),
    blur: Annotated[
        tuple[float, ...], Opt("--blur CELLS", f"Rms blur in place of the scene's{_SEVERAL}", AT_LEAST_0)
    ] = (),
    refresh: Annotated[
        float, Rare("--refresh HZ", "Frames that the display shows per second.", ABOVE_0)
    ] = 60.0,
    exposure: Annotated[
        float, Rare("--exposure MS", "Exposure of a frame, rounded up to full refreshes.", AT_LEAST_0)
    ] = 0.0,
    failure: Annotated[
        float,
        Rare("--failure RATE", "Largest probability of a wrong order or code bit.", click.FloatRange(0, 1)),
    ] = 1e-3,
    verify: Annotated[
        int, Rare("--verify N", "Number of the best candidates to simulate.", click.IntRange(min=0))
    ] = 3,
    shown: Annotated[
        int, Rare("--rows N", "Rows of the table to print; the JSON file has all.", click.IntRange(min=1))
    ] = 12,
    renderer: Renderer = "auto",
    size: Size = None,
    out: Annotated[
        Path | None,
        Opt("--out FILE.toml", "Gets the best sequence, for --sequence.", OutputFile(".toml", bare=False)),
    ] = None,
    csv_path: Annotated[
        Path | None, Opt("--csv FILE.csv", "Gets a row per code and value of --code.", OutputFile(".csv"))
    ] = None,
    chart: Annotated[
        Path | None, Opt("--chart FILE.png", "Error against seconds, a line per --code.", OutputFile(".png"))
    ] = None,
    json_path: Json = None,
) -> None:
    """Rank codes for a scene by predicted error; simulate the best.

    The prediction runs the decoder on simulated images of the scene (of a large camera: on windows of its
    image), and then the solver. Codes that fail too often or lose pixels are listed last; codes of --add are
    always printed. +-: standard error of the prediction; measured: share of the pixels with a height.

    With --code: all of them are predicted and simulated, at every value of the one fault that is given
    several times. time: to display the frames, in their order; cpu: to decode and reconstruct.
    """
    from optolever.experiments import Faults
    from optolever.experiments.design import frame_rate

    rate, scene = frame_rate(refresh, exposure), load_scene(scene_name, size)
    given = {"noise": noise, "lag": lag, "gamma": gamma, "flicker": flicker, "blur": blur}
    axis, values = _axis(given, bool(codes))
    one: dict[str, float] = {name: each[0] for name, each in given.items() if each}
    level = one.pop("noise", 1.0)
    faults = Faults(**one)
    if codes:
        _compare(scene, dent, codes + added, axis, values, faults, level, rate, renderer, size is not None,
                 csv_path, chart, json_path)  # fmt: skip
        return
    for flag, path in (("--csv", csv_path), ("--chart", chart)):
        if path is not None:
            raise InputError(f"{flag} {path}: needs --code")
    _rank(faults.on(scene), dent, added, _budget(frames, seconds, rate), rate, level, failure, verify, shown,
          faults.lag, renderer, size is not None, out, json_path)  # fmt: skip


def _axis(given: dict[str, tuple[float, ...]], compared: bool) -> tuple[str, tuple[float, ...]]:
    """The fault that has several values; InputError for two of them, or without --code."""
    several = [name for name, values in given.items() if len(values) > 1]
    if len(several) > 1:
        raise InputError(f"--{several[0]} and --{several[1]}: one of them may be given several times")
    if several and not compared:
        raise InputError(f"--{several[0]}: several values need --code")
    name = several[0] if several else "noise"
    return name, given[name] or (1.0,)


def _codes(texts: tuple[str, ...], scene: "Scene", resized: bool) -> "list[Candidate | OwnCandidate]":
    from optolever.experiments.design import own_candidate, user_candidate

    cells = scene.pattern.rows, scene.pattern.cols
    return [
        (own_candidate if "@" in text else user_candidate)(text, *cells, resized=resized) for text in texts
    ]


def _compare(
    scene: "Scene", dent: str | None, texts: tuple[str, ...], axis: str, values: tuple[float, ...],
    faults: Any, noise: float, rate: float, renderer: str, resized: bool,
    csv_path: Path | None, chart: Path | None, json_path: Path | None,
) -> None:  # fmt: skip
    from dataclasses import asdict

    from optolever.experiments.design import compare_codes, draw_points, save_points
    from optolever.files import together

    codes = _codes(texts, scene, resized)
    with progress() as step:
        points = compare_codes(
            scene, codes, axis, values, dent=dent, faults=faults, noise=noise, refresh=rate,
            renderer=renderer, progress=step,
        )  # fmt: skip
    with together():
        if csv_path is not None:
            save_points(csv_path, axis, points)
        if chart is not None:
            draw_points(chart, axis, points)
        write_json(json_path, {"axis": axis, "points": [asdict(point) for point in points]})
    rows = [[number(point.value), *_cells(point.row)] for point in points]
    grid(f"Height error, rms in mm: {scene.name}", (axis, *HEADER), rows)


def _rank(
    scene: "Scene", dent: str | None, added: tuple[str, ...], budget: int, rate: float, noise: float,
    failure: float, verify: int, shown: int, lag: float, renderer: str, resized: bool,
    out: Path | None, json_path: Path | None,
) -> None:  # fmt: skip
    from optolever.experiments.design import Candidate, OwnCandidate, run_design
    from optolever.files import together

    codes = _codes(added, scene, resized)
    with progress() as step:
        design = run_design(
            scene,
            dent_of(scene, dent),
            frames=budget,
            refresh=rate,
            noise=noise,
            failure=failure,
            verify=verify,
            extra=[code for code in codes if isinstance(code, Candidate)],
            own=[code for code in codes if isinstance(code, OwnCandidate)],
            lag=lag,
            renderer=renderer,
            progress=step,
        )
    with together():
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
        number(row.cpu_seconds, "s") if math.isfinite(row.cpu_seconds) else "",
        number(row.predicted),
        f"{100 * row.spread:.0f} %" if math.isfinite(row.spread) else "",
        number(row.simulated) if math.isfinite(row.simulated) else "",
        f"{row.failure:.0e}" if math.isfinite(row.failure) else "",
        number(100 * row.share, "%"),
        row.why,
    ]
