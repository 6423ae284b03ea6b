"""Captures of calibration targets by a rig's camera, one after the other, each judged at once."""

import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import click

import optolever as ol
from optolever import InputError
from optolever.files import atomic_file

from .options import correspondence_of
from .rig_capture import capture_rig
from .rig_devices import devices_of
from .show import coverage_text

__all__ = ["SoFar", "capture_targets", "finish", "so_far"]

_FINISHED = "finished"  # file: the captures beside it led to a calibration
_MINUTE = "%Y-%m-%d %H:%M"
_HANDS = {
    "flat": "put the reference mirror in place, tilted by 3 to 8 degrees about another axis than before",
    "rest": "take everything off the mirror",
    "ball": "press the ball into the mirror, away from its edges",
    "plate": "press the flat plate against the mirror, in another pose than before",
}


@dataclass(frozen=True, eq=False)
class SoFar:
    """A calibration by the captures so far (None: none says where z = 0 is), missing captures, and the
    judgement of the last capture."""

    found: "ol.calibration.Calibration | None"
    few: str
    last: "ol.calibration.Judgement | None" = None

    def text(self) -> str:
        """The last capture's figures, and missing captures."""
        if self.last is None:
            return self.few
        heads, (row,) = ol.experiments.judged_table({self.last.name: self.last.to_dict()})
        parts = zip((head.partition(", ") for head in heads[1:]), row[1:], strict=True)
        judgement = ", ".join(f"{what} {cell} {unit}".rstrip() for (what, _, unit), cell in parts if cell)
        return f"{judgement}; {self.few}" if self.few else judgement

    def required(self) -> "ol.calibration.Calibration":
        """InputError without a calibration."""
        if self.found is None:
            raise InputError(f"calibration: {self.few}")
        return self.found


def so_far(
    scene: "ol.scene.Scene",
    used: Sequence["ol.calibration.Observation"],
    priors: Mapping[str, float],
    guess: bool,
) -> SoFar:
    """Calibrate by these captures; InputError of a wrong one."""
    found, few = ol.calibration.calibrate_so_far(scene, used, priors, guess=guess)
    last = (
        None
        if found is None
        else next(one for one in ol.calibration.judged(found) if one.name == used[-1].name)
    )
    return SoFar(found, few, last)


def capture_targets(
    rig: Path,
    scene: "ol.scene.Scene",
    plan: Sequence[tuple[str, "ol.calibration.Target"]],
    folder: Path,
    sequence: str,
    *,
    priors: Mapping[str, float],
    guess: bool,
    ask: bool,
    resume: bool,
) -> SoFar:
    """Take every target of a plan (text, target), and calibrate.

    ask: wait for the hands before every capture, and let them decide on a doubtful one; else doubtful ones
    are set aside. Captures stay in `folder` whatever ends the walk. resume: those of a walk that did not end
    in a calibration are used again; a terminal is asked. All others are set aside first, with their date.
    """
    devices, shown = (
        devices_of(rig),
        ol.patterns.sequence_from_text(sequence, scene.pattern.rows, scene.pattern.cols),
    )
    folder.mkdir(parents=True, exist_ok=True)
    _begin(folder, scene, resume, ask and sys.stdin.isatty())
    used, now = (
        list[ol.calibration.Observation](),
        SoFar(None, "no capture is left; at least one of Flat or Rest is needed"),
    )
    for number, (text, target) in enumerate(plan, 1):
        path = folder / f"{number}-{re.sub(r'[^a-z0-9.]+', '-', text)}"
        hands = f"{number} of {len(plan)}, {text}: {_HANDS[text.partition(':')[0]]}. Enter captures"
        doubtful: tuple[Path, ol.calibration.Observation, SoFar] | None = None
        while True:
            if not (path / "capture.toml").is_file():
                keeps = ", k keeps the last" if doubtful is not None else ""
                answer = _answer(f"{hands}{keeps}, s stops", folder) if ask else ""
                if answer == "s":
                    return now
                if answer == "k" and doubtful is not None:
                    kept, one, now = doubtful
                    kept.rename(path)
                    used = [*used, one]
                    break
                _aside(path.with_name(f"{path.name}.recording"))
                capture_rig(rig, devices, shown, path, keep=False)
            elif doubtful is None:
                click.echo(f"{path.name}: taken {_taken(path):{_MINUTE}}, used again")
            one, then = ol.calibration.Observation(path.name, target, correspondence_of(path)), None
            try:
                then = so_far(scene, [*used, one], priors, guess)
                mirror, decoded = ol.experiments.mirror_coverage(one.correspondence.flags)
                fault = ol.calibration.reason_to_repeat(decoded, then.last, now.last, not then.few)
                click.echo(f"{path.name}: {coverage_text(mirror, decoded)}; {then.text()}")
            except InputError as error:
                fault = str(error)
            if not fault and then is not None:
                used, now = [*used, one], then
                break
            click.echo(f"{path.name}: set aside: {fault}")
            aside = _aside(path)
            doubtful = None if then is None else (aside, one, then)
            if not ask:
                break
    return now


def finish(folder: Path) -> None:
    """Mark the captures of a folder as those of a calibration that ended."""
    with atomic_file(folder / _FINISHED) as beside:
        beside.write_text(datetime.now().isoformat(timespec="seconds") + "\n", encoding="utf-8")


def _begin(folder: Path, scene: "ol.scene.Scene", resume: bool, terminal: bool) -> None:
    """Set the captures of earlier walks aside, unless the last one did not end and is resumed."""
    earlier = [path for path in folder.iterdir() if re.match(r"\d+-[a-z]", path.name)]
    done = [path for path in earlier if (path / "capture.toml").is_file()]
    if not done:
        return
    first = min(map(_taken, done))
    calibrated = "" if scene.covariance is None else scene.covariance.date
    finished = (folder / _FINISHED).exists() or f"{max(map(_taken, done)):%Y-%m-%d}" < calibrated
    if not finished and terminal and not resume:
        question = f"captures of {first:{_MINUTE}}, calibration not finished: r resumes it, Enter begins anew"
        resume = _answer(question, folder) == "r"
    if resume and not finished:
        return
    aside = folder / f"{first:%Y-%m-%dT%H-%M-%S}"
    aside.mkdir()
    for path in (*earlier, folder / _FINISHED):
        if path.exists():
            path.rename(aside / path.name)
    ended = "finished" if finished else "unfinished"
    click.echo(f"captures of {first:{_MINUTE}} ({ended} calibration) are set aside: {aside}")


def _taken(path: Path) -> datetime:
    """Time of a capture."""
    return datetime.fromtimestamp((path / "capture.toml").stat().st_mtime)


def _answer(question: str, folder: Path) -> str:
    """A letter from the terminal or a pipe; at its end the program ends, and says where the captures are."""
    try:
        return str(click.prompt(question, default="", show_default=False)).strip().lower()[:1]
    except click.Abort:
        click.echo(
            f"captures so far are in {folder}; the same command with --resume goes on with them", err=True
        )
        raise


def _aside(path: Path) -> Path:
    """The new name of a rejected capture, or of the recording of an interrupted one, if there is one."""
    number = 1
    while (other := path.with_name(f"{path.name}.aside{number}")).exists():
        number += 1
    if path.exists():
        path.rename(other)
    return other
