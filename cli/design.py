"""`optolever design`: sequences for a scene, ranked by predicted height error.

$ optolever design --scene prism48 --pixels 128x96 --frames 14 --out best.toml
Height error, rms in mm: prism48, at most 14 frames
code                                   frames     acquire    CPU        predicted  simulated  +-  ...
phase:steps=3,periods=5.56364/5.32174  12         0.2 s      0.125 s    0.0001864  0.000165   1.9e-06
phase:steps=3,periods=6.8/6.44211      12         0.2 s      0.0494 s   0.0002002  0.0001719  5e-06
ladder: 2 to 5 px, steps 3/4           14         0.233 s    0.0491 s   0.0002068  0.0001866  1.6e-06
...
Choice
  sequence    phase:steps=3,periods=5.56364/5.32174
  candidates  18
  time        predict 33.26, simulate 6.842, total 40.1 s
  written to  best.toml
"""

import math
from dataclasses import asdict, fields, replace
from itertools import product
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import click

import optolever as ol
from optolever import InputError
from optolever.numbers import parsed, written

from .arguments import ABOVE_0, AT_LEAST_0, Opt, program
from .options import Colour, Dent, Json, SceneName, Size, colours_of, sections
from .outputs import OutputFile
from .printing import number, progress, table, write_json

FRAMES = Opt("--frames N", "Maximum number of frames.", click.IntRange(min=2))
REFRESH = Opt("--refresh HZ", "Frames that the display shows per second.", ABOVE_0)
CODES = Opt(
    "--code PATTERN[@DECODER]",
    "Compare these codes, each as in --add, in place of a ranking; --noise and --fault are then axes: each "
    "may be given several times.",
)
NOISE = Opt(
    "--noise LEVELS",
    "Noise of a frame beside the sensor's, 8-bit levels; default 1, 0 for a rig with [profile].",
    AT_LEAST_0,
)
FAULT = Opt(
    "--fault NAME=VALUE",
    "In place of the rig's: lag, the share of the preceding frame in each simulated frame (not predicted), "
    "gamma of the display (unknown to the decoder), flicker, the amplitude of the light at 100 Hz, blur "
    "(rms, cells).",
)
EXPOSURE = Opt("--exposure MS", "Exposure of a frame, rounded up to full refreshes.", AT_LEAST_0)
ADD = Opt(
    "--add PATTERN",
    "Also rank a sequence (a .toml of more cells than --pixels leaves is cropped); a folder of "
    "images with a coordinates.toml ([[frames]] file, axis) or "
    "MODULE:FUNCTION, where FUNCTION(rows, cols) returns a patterns.Sequence or images; @MODULE:FUNCTION "
    "after it: a decoder of yours (simulated only).",
)
VERIFY = Opt("--verify N", "Number of the best candidates to simulate.", click.IntRange(min=0))
_ROWS = 12  # of the table that is printed; the JSON file has all
SEEDS = Opt("--seeds N", "Draws of noise of each simulation.", click.IntRange(min=1))
OUT = Opt(
    "--out FILE.toml|png",
    "Gets the best sequence, for show --sequence; with --code a chart (.png) of the error over both times.",
    OutputFile(".toml", ".png", bare=False),
)

RANGE = Opt("--range", "Print the measuring range and sensitivity of the scene instead.")


@program("design", __doc__)
def command(
    scene_name: SceneName,
    dent: Dent = None,
    frames: Annotated[int, FRAMES] = 24,
    refresh: Annotated[float, REFRESH] = 60.0,
    codes: Annotated[tuple[str, ...], CODES] = (),
    noises: Annotated[tuple[float, ...], NOISE] = (),
    given: Annotated[tuple[str, ...], FAULT] = (),
    exposure: Annotated[float, EXPOSURE] = 0.0,
    added: Annotated[tuple[str, ...], ADD] = (),
    colour: Colour = None,
    verify: Annotated[int, VERIFY] = 3,
    seeds: Annotated[int, SEEDS] = 3,
    size: Size = None,
    measuring: Annotated[bool, RANGE] = False,
    out: Annotated[Path | None, OUT] = None,
    json_path: Json = None,
) -> None:
    """Rank codes for a scene by predicted error; simulate the best.

    The prediction runs the decoder on simulated images of the scene (of a large camera: on windows of its
    image), and then the solver. Codes that fail too often or lose pixels are listed last; codes of --add are
    always printed. +-: standard deviation of the simulated error over the seeds; measured: share of the
    pixels with a height. Noise ([profile]), response, crosstalk ([colour]) and lag of a rig's TOML are used.
    --colour: also codes in colour; frames are pictures then.

    With --code: predicted and simulated error of the named codes beside CPU seconds and seconds of
    acquisition, for every combination of noise and faults; --json FILE.csv gets a row each.

    With --range: slopes, total reflection, lever, free mode, error bars, medians over the mirror at rest on a
    thinned camera (error bars: of the full one). Balls: how deep they may press before `live` loses cells.
    """
    from optolever import design

    rate = design.frame_rate(refresh, exposure)
    rig = _of_rig(scene_name)
    faults, noises = _faults(given, rig.lag), noises or (rig.noise,)
    scene, resized = rig.scene if size is None else ol.scene.resize(rig.scene, *size), size is not None
    if measuring:
        _print_range(scene, (*codes, "gray+phase")[0], noises[0], json_path)
        return
    if out is not None and bool(codes) == (out.suffix.lower() == ".toml"):
        raise InputError(f"--out {out}: must be .png, a chart, with --code, and .toml, a sequence, without")
    if codes:
        rows = list[design.Tradeoff]()
        title = f"{scene.name}, {scene.camera.cols} x {scene.camera.rows}, {seeds} draws{rig.known}"
        try:
            with progress() as step:
                for row in design.compare_codes(
                    scene, dent or scene.dent or "flat", codes,
                    faults=faults, noises=noises, rate=rate, seeds=range(seeds),
                    calibrated=rig.calibrated, resized=resized, colour=colour, progress=step,
                ):  # fmt: skip
                    rows.append(row)
                    with step.aside():
                        _print_row(row, len(rows) == 1, max(map(len, codes)), title)
        finally:  # Ctrl-C keeps what there is
            if rows:
                with ol.files.together():
                    if out is not None:
                        design.write_tradeoff_chart(out, design.condition_panels(rows), title)
                    if json_path is not None and json_path.suffix.lower() == ".csv":
                        design.write_tradeoff_csv(json_path, rows)
                    else:
                        write_json(json_path, {"rows": [asdict(row) for row in rows]})
        return
    if len(faults) * len(noises) > 1:
        raise InputError("--code: missing; several noises or faults compare named codes")
    (fault,), (noise,) = faults, noises
    cells = scene.pattern.rows, scene.pattern.cols
    extra = [design.user_candidate(text, *cells, resized=resized) for text in added]
    with progress() as step:
        found = design.run_design(
            fault.on(scene), dent or scene.dent or "flat",
            frames=frames, refresh=rate, noise=noise, verify=verify, seeds=seeds,
            extra=extra, lag=fault.lag, calibrated=rig.calibrated and fault.gamma is None,
            colour=colour, progress=step,
        )  # fmt: skip
    chosen = found.chosen
    with ol.files.together():
        if out is not None and chosen is not None:
            chosen.sequence.save(out)
        write_json(json_path, found.to_dict())
    best = found.rows[:_ROWS] + [row for row in found.rows[_ROWS:] if row.code in added]
    width = max(len(row.code) for row in best)
    for row in best:
        _print_row(row, row is best[0], width, f"{scene.name}, at most {frames} frames{rig.known}")
    _print_choice(found, out)


def _faults(given: tuple[str, ...], lag: float) -> "list[ol.samples.Faults]":
    """Every combination of --fault; lag: of the rig."""
    axes: dict[str, list[Any]] = {each.name: [] for each in fields(ol.samples.Faults)}
    for text in given:
        for name, value in written("--fault", text, f"NAME=VALUE of {', '.join(axes)}", axes).items():
            axes[name].append(parsed(f"--fault {name}", value))
    axes["lag"] = axes["lag"] or [lag]
    return [ol.samples.Faults(*each) for each in product(*(values or [None] for values in axes.values()))]


def _print_choice(found: "ol.design.Design", out: Path | None) -> None:
    """The sequence that was chosen, and its file."""
    chosen = found.chosen
    choice = {
        "sequence": "none: no candidate meets the limits" if chosen is None else chosen.text,
        "candidates": str(len(found.rows)),
        "time": ", ".join(f"{name} {number(value)}" for name, value in found.seconds.items()) + " s",
    }
    table("Choice", choice | ({"written to": str(out)} if out is not None and chosen is not None else {}))


def _print_range(scene: "ol.scene.Scene", code: str, noise: float, json_path: Path | None) -> None:
    """--range."""
    numbers = ol.design.sensor_maps(scene, code, noise).numbers()
    write_json(json_path, {"numbers": numbers, "settings": {"code": code, "noise": noise}})
    table(f"Sensor {scene.name}", {key: number(value) for key, value in numbers.items()})


class _Rig(NamedTuple):
    """scene: with the noise and response that its file holds; noise: of a frame beside the sensor's, levels;
    lag; calibrated: the decoder knows the response; known: what the file holds, in words."""

    scene: "ol.scene.Scene"
    noise: float = 1.0
    lag: float = 0.0
    calibrated: bool = False
    known: str = ""


def _of_rig(name: str) -> _Rig:
    """A preset, or a rig's file with its sections [profile], [response] and [sync]."""
    scene = ol.scene.load(name)
    held, rig, known = sections(name), _Rig(scene), list[str]()
    if "response" in held:
        found = ol.calibration.load_response(name)
        blur = found.response.blur
        soft = scene.pattern if blur is None or math.isnan(blur) else replace(scene.pattern, blur_px=blur)
        scene = replace(scene, display=ol.scene.Display(found.gamma[0], found.black), pattern=soft)
        rig, known = rig._replace(scene=scene, calibrated=True), [f"response of gamma {found.gamma[0]:.3g}"]
    if "profile" in held:
        profile = ol.decode.RigProfile.load(name)
        noise, unit = profile.estimates.noise, 255 / (profile.clip if profile.dtype == "uint16" else 255)
        read = unit * math.sqrt(max(noise.read2 - 1 / 12, 0.0))
        electrons = 1 / (unit * noise.gain) if noise.gain > 0 else 0.0
        sensor = replace(scene.sensor or ol.projector.NOMINAL_SENSOR, noise=read, gain_e=electrons)
        lags = [effect.value for effect in profile.effects() if effect.name == "lag"]
        scene = replace(scene, sensor=sensor)
        rig = rig._replace(scene=scene, noise=0.0, lag=sum(lags))
        known.append(f"noise of {read:.2g} levels and {electrons:.2g} electrons a level")
    if (colours := colours_of(name)) is not None:
        mix = colours.mix.clip(0) / colours.mix.sum(axis=1).max()
        sensor = replace(scene.sensor or ol.projector.NOMINAL_SENSOR, mix=mix)
        rig = rig._replace(scene=replace(scene, sensor=sensor))
        known.append("crosstalk")
    timing = ol.camera.timing_of(Path(name)) if "sync" in held else None
    if timing is not None and not rig.lag:
        rig = rig._replace(lag=timing.lag(timing.ready_s()))
    known += [f"lag {rig.lag:.2g}"] if rig.lag else []
    return rig._replace(known="".join(f"; {each}" for each in known))


def _known(value: float, form: str = ".4g", unit: str = "") -> str:
    """A cell of a table: blank where the number is unknown."""
    return f"{value:{form}}{unit}" if math.isfinite(value) else ""


def _print_row(row: "ol.design.Tradeoff", first: bool, width: int, title: str) -> None:
    """A line of the table of codes, under its header."""
    names = ("frames", "acquire", "CPU", "predicted", "simulated", "+-", "err/sigma", "measured")
    if first:
        click.secho(f"Height error, rms in mm: {title}", bold=True)
        click.echo(f"{'code':<{width}}  " + "".join(f"{name:<11}" for name in names) + "condition")
    values = [row.acquisition_seconds, row.cpu_seconds, row.predicted, row.simulated, row.spread, row.ratio]
    forms, units = [".3g", ".3g", ".4g", ".4g", ".2g", ".2f", ".4g"], [" s", " s", "", "", "", "", " %"]
    cells = [str(row.frames), *map(_known, [*values, 100 * row.share], forms, units)]
    line = f"{row.code:<{width}}  " + "".join(f"{cell:<11}" for cell in cells) + row.condition
    click.echo(f"{line}  {row.why}".rstrip())
