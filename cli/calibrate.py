"""`optolever calibrate`: captures of simple targets to a scene with covariance.

$ optolever calibrate --scene monitor-mirror --out rig.toml \\
      flat=p0.npz flat=p1.npz flat=p2.npz
...
$ optolever calibrate --scene prism48 --out rig.toml \\
      rest=rest.npz ball:30,0.003=b.npz --leave-one-out
...
$ optolever calibrate --rig rig.toml rest ball:30,0.003
1 of 2, rest: take everything off the mirror. Enter captures, s stops:
"""

import re
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import click

import optolever as ol
from optolever import InputError
from optolever.numbers import listed, parsed
from optolever.quantities import quantity, two_digits

from .arguments import Arg, Opt, Rare, program
from .options import Json, RigFile, Size, correspondence_of, load_scene, name_unused, preset
from .outputs import OutputFile
from .printing import grid, number, print_notices, progress, table, write_json
from .rig.target_captures import Calibrate, answer_at, capture_targets, so_far_text

#: Sections of a rig's file that stay as they are, and the reason.
_UNUSED = {
    "profile": "each capture is decoded with an estimate of its own noise",
    "rest": "the map was solved with the rig before; run optolever reconstruct --keep-rest again",
}


GIVEN, MADE = RigFile(".calibration.npz"), OutputFile(".toml", beside=(".calibration.npz",))
RIG = Opt("--rig RIG.toml", "Take the captures now, by the camera and the display of this rig.", GIVEN)
OUT = Opt("--out RIG.toml", "Scene with covariance, to write; default: that of --rig.", MADE)
SEQUENCE = Rare("--sequence NAME[:KEY=VALUE,...]", "Of --rig.")
RESUME = Opt("--resume", "Of --rig: go on with the captures of an unfinished calibration.")
YES = Rare("--yes", "Of --rig: ask nothing; doubtful captures are set aside.")
PRIOR = Opt("--prior NUMBER=SIGMA", "Prior sigma of a parameter; 0: fixed, inf: free.")
WITHOUT = Opt("--without NAME", "Leave a capture out, by its file's stem.")
WEIGHT = Rare(
    "--weight NEWTON[,SIGMA]=H.npz",
    "In place of captures: heights less rest under a known weight, for the modulus of the scene's [layer].",
)
LEFT_OUT = Rare("--leave-one-out", "Also print the leave-one-out chi of each capture.")
ACCEPT = Opt("--accept", "Write the rig even if a parameter ends beyond 5 prior sigma.")
FOLLOW = Rare("--follow", "Wait for each capture, and print its contribution as soon as it exists.")
PAGE = Opt("--report FILE.html", "Also write a page about the calibration.", OutputFile(".html"))


@program("calibrate", __doc__)
def command(
    captures: Annotated[tuple[str, ...], Arg("TARGET[=CAPTURE[@MASK.png]]...", required=False)],
    scene_name: Annotated[str | None, preset()] = None,
    rig: Annotated[Path | None, RIG] = None,
    out: Annotated[Path | None, OUT] = None,
    priors: Annotated[tuple[str, ...], PRIOR] = (),
    without: Annotated[tuple[str, ...], WITHOUT] = (),
    accept: Annotated[bool, ACCEPT] = False,
    resume: Annotated[bool, RESUME] = False,
    page: Annotated[Path | None, PAGE] = None,
    size: Size = None,
    sequence: Annotated[str, SEQUENCE] = "gray+phase",
    yes: Annotated[bool, YES] = False,
    weights: Annotated[tuple[str, ...], WEIGHT] = (),
    leave_one_out: Annotated[bool, LEFT_OUT] = False,
    follow: Annotated[bool, FOLLOW] = False,
    json_path: Json = None,
) -> None:
    """Measure the rig: adjust a scene to captures of targets.

    A capture is an .npz of decode or a folder of frames. TARGET is flat[:FLATNESS] (a reference mirror in any
    pose, mm), rest[:ORDER[,SIGMA]] (the sensor's undeformed surface), ball:RADIUS,SIGMA (its contact only,
    detected, or white in MASK.png) or plate. reconstruct reads RIG.toml and propagates its errors to the
    heights. With --weight RIG.toml is the scene with the modulus of its layer, for forces (live).

    With --rig no CAPTURE is given: the command says for each TARGET (default in open air: five flats) what to
    put in place, captures, judges, and repeats or goes on. Earlier captures are set aside with their date.
    """
    if (name := rig or scene_name) is None or (out := out or rig) is None:
        raise click.UsageError("Missing option '--scene' and '--out' (captures), or '--rig' (a camera).")
    of_captures = {"--scene": scene_name, "--without": without, "--follow": follow, "--pixels": size}
    of_captures["--weight"] = weights
    of_rig = {"--resume": resume, "--yes": yes}
    cure = "is of captures that exist, --rig takes them" if rig else "needs --rig"
    for option, value in (of_captures if rig else of_rig).items():
        if value:
            raise InputError(f"{option}: {cure}")
    scene = load_scene(str(name), size)
    chosen = {
        key: parsed(f"--prior {key}", text)
        for key, text in _pairs("--prior", priors, "NUMBER=SIGMA, such as pattern.z=0.5")
    }
    if rig is None and bool(captures) == bool(weights):
        raise InputError("TARGET=CAPTURE or --weight NEWTON=H.npz: one of both must be given")
    if weights:
        _weigh(scene, str(name), weights, out, json_path)
        return
    given = _given(captures, without) if rig is None else []
    found, start = None, time.perf_counter()
    calibrate = partial(ol.calibration.calibrate_so_far, scene, priors=chosen)
    if rig is not None:  # asks at the terminal: no progress bar over it
        plan, folder = _plan(captures, scene), rig.with_suffix(".captures")
        ask = None if yes else partial(answer_at, folder)
        found = capture_targets(rig, plan, folder, sequence, calibrate, ask=ask, resume=resume).required()
    with progress() as step:
        if follow:
            found = _followed(given, name, calibrate).required()
        elif found is None:
            step("read captures")
            used = [each.observed(name) for each in given]
            step("adjust")
            start = time.perf_counter()
            found = ol.calibration.calibrate(scene, used, chosen)
        if found.implausible and not accept:
            raise InputError(f"{out}: not written; {found.implausible[0]}; --accept writes it all the same")
        numbers = found.to_dict() | {"seconds": time.perf_counter() - start}
        step("judge captures")
        numbers["judged"] = {each.name: each.to_dict() for each in ol.calibration.judged(found)}
        if leave_one_out:
            step("leave one out")
            names = [each.name for each in found.observations]
            numbers["left_out"] = {name: ol.calibration.left_out(found, name) for name in names}
        step("write")
        with ol.files.together():
            found.scene.save(out, keep=name)
            if page is not None:
                ol.report.write_rig_report(scene, found, numbers["judged"], page)
            write_json(json_path, numbers)
    print_notices(found.notices)
    print_notices(ol.calibration.unused_accuracy(scene))
    name_unused(name, "calibrate", **_UNUSED)
    _print(found, numbers)
    rest = {"chi": number(numbers["chi"]), "start": numbers["start"], "time": number(numbers["seconds"], "s")}
    table(f"Rig in {out}", rest)


def _print(found: "ol.calibration.Calibration", numbers: dict[str, Any]) -> None:
    """Parameters and captures."""
    rows = [
        (each["name"], quantity(each["value"], "", each["sigma"]), two_digits(each["prior_sigma"]))
        for each in found.parameters
    ]
    grid("Parameters (mm, rad, px)", ("name", "value ± sigma", "prior sigma"), rows)
    chis = numbers.get("left_out", {})
    judged = {
        name: each | ({"left_out": chis[name]} if chis else {}) for name, each in numbers["judged"].items()
    }
    title = "Captures: sigma of a height and of a dent's depth, cumulative and leave-one-out"
    grid(title, *ol.report.judged_table(judged))


@dataclass(frozen=True)
class _Given:
    """TARGET=CAPTURE[@MASK.png]."""

    target: "ol.calibration.Target"
    path: Path
    mask: Path | None

    def observed(self, rig: Path | str) -> "ol.calibration.Observation":
        from optolever.pictures import read_mask

        seen = correspondence_of(self.path, rig)
        mask = None if self.mask is None else read_mask(self.mask, seen.u.shape, str(self.path))
        return ol.calibration.Observation(self.path.stem, self.target, seen, mask)


def _given(captures: Sequence[str], without: Sequence[str]) -> list[_Given]:
    """Captures without those named by --without."""
    given = []
    for text in captures:
        match = re.fullmatch(r"(?P<target>[a-z]+(:[^=]*)?)=(?P<capture>.+)", text)
        if match is None:
            form = "TARGET=CAPTURE, such as flat=pose.npz or ball:30,0.003=b.npz"
            raise InputError(f"capture {text!r}: must be {form}")
        target = ol.calibration.target_from_text(match["target"])
        given.append(_Given(target, *_path_and_mask(match["capture"])))
    names = [each.path.stem for each in given]
    for name in without:
        if name not in names:
            raise InputError(f"--without {name}: no such capture, must be one of {', '.join(names)}")
    return [each for each in given if each.path.stem not in without]


def _path_and_mask(text: str) -> tuple[Path, Path | None]:
    """Both sides of the @ before a picture; paths may hold an @, too."""
    from optolever.pictures import PICTURES

    places = [found.start() for found in re.finditer("@", text)] if text.lower().endswith(PICTURES) else []
    there = [at for at in places if Path(text[at + 1 :]).is_file()] or places[-1:]
    return (Path(text[: there[0]]), Path(text[there[0] + 1 :])) if there else (Path(text), None)


def _plan(texts: Sequence[str], scene: "ol.scene.Scene") -> list[tuple[str, "ol.calibration.Target"]]:
    """Targets to capture, by their texts; five flats in open air if none are given."""
    if not texts and scene.medium is not None:
        raise InputError("targets of a prism are missing, must be given, such as rest ball:30,0.003")
    for text in texts:
        if "=" in text:
            cure = "--rig takes the captures itself, must be a target such as rest"
            raise InputError(f"capture {text!r}: {cure}")
    return [(text, ol.calibration.target_from_text(text)) for text in texts or ("flat",) * 5]


def _followed(given: Sequence[_Given], rig: Path | str, calibrate: Calibrate) -> "ol.calibration.SoFar":
    """Calibration by every capture as it arrives, with a line about it."""
    now, used = ol.calibration.SoFar(), list["ol.calibration.Observation"]()
    for each in given:
        while not (each.path.is_file() or (each.path / "capture.toml").is_file()):
            time.sleep(0.2)
        used.append(each.observed(rig))
        now = calibrate(used)
        click.echo(f"{each.path.stem}: {so_far_text(now)}")
    return now


def _weigh(
    scene: "ol.scene.Scene", name: str, weights: tuple[str, ...], out: Path, json_path: Path | None
) -> None:
    """The modulus of the layer by --weight, into a scene."""
    if scene.layer is None:
        raise InputError(f"--weight: {name} has no [layer], must have one; any youngs_modulus_mpa will do")
    given = []
    for numbers, path in _pairs("--weight", weights, "NEWTON[,SIGMA]=H.npz, such as 0.5,0.005=h.npz"):
        values = listed("--weight", numbers, "NEWTON[,SIGMA], numbers")[:2]
        given.append(ol.calibration.Weight(ol.reconstruct.HeightMap.load(path), *values))
    found = ol.calibration.weighed(scene.layer, given)
    layer, each = found.layer, list(zip(weights, found.moduli, found.sigmas, strict=True))
    modulus = layer.youngs_modulus_mpa, layer.youngs_modulus_mpa * layer.relative_sigma
    names = "youngs_modulus_mpa", "youngs_modulus_sigma_mpa"
    with ol.files.together():
        replace(scene, layer=layer).save(out, keep=name)
        write_json(json_path, dict(zip(names, modulus, strict=True)) | {"chi": found.chi, "weights": each})
    rows = {text: quantity(value, "N/mm²", sigma) for text, value, sigma in each}
    rows |= {"modulus": quantity(modulus[0], "N/mm²", modulus[1])}
    table(f"Layer in {out}", rows | ({"chi": number(found.chi)} if len(each) > 1 else {}))


def _pairs(option: str, texts: Sequence[str], form: str) -> list[tuple[str, str]]:
    """Both sides of the = in the values of an option."""
    pairs = [text.partition("=")[::2] for text in texts]
    for text, (_, value) in zip(texts, pairs, strict=True):
        if not value:
            raise InputError(f"{option} {text}: must be {form}")
    return pairs
