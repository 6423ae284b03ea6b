"""Captures of calibration targets by a rig's camera, one after the other, each judged at once."""

import re
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path
from typing import TypeAlias

import click

import optolever as ol
from optolever import InputError

from ..options import correspondence_of
from ..printing import coverage_text
from .opened import sequence_of
from .recorded_capture import capture_rig

#: A calibration by the captures so far.
Calibrate: TypeAlias = "Callable[[Sequence[ol.calibration.Observation]], ol.calibration.SoFar]"

_MINUTE = "%Y-%m-%d %H:%M"
_HANDS = {
    "flat": "put the reference mirror in place, tilted by 3 to 8 degrees about another axis than before",
    "rest": "take everything off the mirror",
    "ball": "press the ball into the mirror, away from its edges",
    "plate": "press the flat plate against the mirror, in another pose than before",
}


def so_far_text(now: "ol.calibration.SoFar") -> str:
    """The last capture's figures, and missing captures."""
    if now.last is None:
        return now.few
    heads, (row,) = ol.report.judged_table({now.last.name: now.last.to_dict()})
    parts = zip((head.partition(", ") for head in heads[1:]), row[1:], strict=True)
    judgement = ", ".join(f"{what} {cell} {unit}".rstrip() for (what, _, unit), cell in parts if cell)
    return f"{judgement}; {now.few}" if now.few else judgement


def capture_targets(
    rig: Path,
    plan: "Sequence[tuple[str, ol.calibration.Target]]",
    folder: Path,
    sequence: str,
    calibrate: Calibrate,
    *,
    ask: Callable[[str], str] | None,
    resume: bool,
    say: Callable[[str], None] = click.echo,
) -> "ol.calibration.SoFar":
    """Take every target of a plan (text, target), and calibrate.

    ask: waits for the hands before every capture, and gets a letter; None: doubtful ones are set aside.
    say: gets every judgement. Captures stay in `folder` whatever ends the walk. resume: use captures of
    an earlier walk again; else they are set aside first, with their date.
    """
    devices, shown = ol.camera.devices_of(rig), sequence_of(rig, sequence)
    folder.mkdir(parents=True, exist_ok=True)
    if not resume:
        _begin_anew(folder)
    now, used = ol.calibration.SoFar(), list["ol.calibration.Observation"]()
    for number, (text, target) in enumerate(plan, 1):
        path = folder / f"{number}-{re.sub(r'[^a-z0-9.]+', '-', text)}"
        hands = f"{number} of {len(plan)}, {text}: {_HANDS[text.partition(':')[0]]}. Enter captures"
        doubtful: tuple[Path, ol.calibration.Observation, ol.calibration.SoFar] | None = None
        while True:
            if not (path / "capture.toml").is_file():
                keeps = ", k keeps the last" if doubtful is not None else ""
                answer = ask(f"{hands}{keeps}, s stops") if ask else ""
                if answer == "s":
                    return now
                if answer == "k" and doubtful is not None:
                    kept, one, now = doubtful
                    kept.rename(path)
                    used = [*used, one]
                    break
                ol.files.aside(path.with_name(f"{path.name}.recording"))
                capture_rig(rig, devices, shown, path, keep=False)
            elif doubtful is None:
                say(f"{path.name}: taken {_taken(path):{_MINUTE}}, used again")
            one, then = ol.calibration.Observation(path.name, target, correspondence_of(path, rig)), None
            try:
                then = calibrate([*used, one])
                mirror, decoded = ol.decode.mirror_coverage(one.correspondence.flags)
                fault = ol.calibration.reason_to_repeat(decoded, then.last, now.last, not then.few)
                say(f"{path.name}: {coverage_text(mirror, decoded)}; {so_far_text(then)}")
            except InputError as error:
                fault = str(error)
            if not fault and then is not None:
                used, now = [*used, one], then
                break
            say(f"{path.name}: set aside: {fault}")
            rejected = ol.files.aside(path)
            doubtful = None if then is None else (rejected, one, then)
            if not ask:
                break
    return now


def _begin_anew(folder: Path) -> None:
    """Set the captures of earlier walks aside, with the date of the first one."""
    earlier = [path for path in folder.iterdir() if re.match(r"\d+-[a-z]", path.name)]
    if done := [path for path in earlier if (path / "capture.toml").is_file()]:
        first = min(map(_taken, done))
        aside = folder / f"{first:%Y-%m-%dT%H-%M-%S}"
        aside.mkdir()
        for path in earlier:
            path.rename(aside / path.name)
        click.echo(f"captures of {first:{_MINUTE}} are set aside: {aside}")


def _taken(path: Path) -> datetime:
    """Time of a capture."""
    return datetime.fromtimestamp((path / "capture.toml").stat().st_mtime)


def answer_at(folder: Path, question: str) -> str:
    """A letter from the terminal or a pipe; at its end the program ends, and says where the captures are."""
    try:
        return str(click.prompt(question, default="", show_default=False)).strip().lower()[:1]
    except click.Abort:
        click.echo(
            f"captures so far are in {folder}; the same command with --resume goes on with them", err=True
        )
        raise
