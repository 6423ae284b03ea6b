"""The steps of `start`: each asks, measures, and writes its part of the rig's TOML."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import optolever as ol
from optolever import InputError
from optolever.toml import read_toml, toml_text

from ..options import decoded_by_response, response_of
from .expose import chosen_exposure
from .new import draw_rig, visible_share
from .opened import has_colours, image_size, levels_of, opened, sequence_of
from .questions import BALL, KINDS, QUESTIONS, SIMULATED_VIEW, VIEW_60, questions_of, scene_of, typed_rig
from .recorded_capture import capture_now, capture_rest, capture_rig
from .start_page import GoTo, Interviewer
from .sync import synchronised
from .target_captures import capture_targets
from .views import preview_on, views_of

__all__ = ["STEPS", "Begun", "require_devices", "rest"]

_SIMULATED = "virtual"
_KEPT = (
    "devices",
    "sync",
    "response",
    "colour",
    "start",
)  # sections that other numbers of the rig leave as they are
_RESTS = 8  # frames of the fringe at rest
_FLATS = 5
_LEAST = 0.1  # share of the picture that sees the display: below it `prepare` refuses
_BENT = 0.3  # of a gamma from 1
_CHI = 3.0  # of the fit of a flat mirror: 0.5 to 1.3 over rigs drawn from the accuracy of typed numbers


@dataclass
class Begun:
    """A rig's file, and what `start` keeps in it: [start] has the step and the answers as typed."""

    rig: Path
    table: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def load(cls, rig: Path) -> "Begun":
        """Of a file, or of none."""
        return cls(rig, read_toml(rig) if rig.exists() else {})

    @property
    def answers(self) -> dict[str, Any]:
        """[start]."""
        return dict(self.table.get("start", {}))

    @property
    def kind(self) -> str:
        """Of the rig."""
        return str(self.answers.get("kind", KINDS[0]))

    @property
    def devices(self) -> dict[str, Any]:
        """[devices]."""
        return dict(self.table.get("devices", {}))

    @property
    def simulated(self) -> bool:
        """Whether the camera is the virtual sensor."""
        return self.devices.get("camera") == _SIMULATED

    def defaults(self, kind: str) -> dict[str, str]:
        """Answers as typed, else of a rig of that kind."""
        others = SIMULATED_VIEW if self.simulated else {}
        before = {"view_width": others.get(kind)} | self.answers
        return {each.name: str(before.get(each.name) or each.default(kind)) for each in QUESTIONS}

    def values(self, **changes: Any) -> dict[str, Any]:
        """Answers, converted."""
        texts = self.defaults(self.kind) | changes
        return {
            each.name: each.kind.convert(texts[each.name], None, None)
            for each in QUESTIONS
            if each.only in ("", self.kind) and texts[each.name] != ""
        }

    def write(self, sections: Mapping[str, Mapping[str, Any]] | None = None, **answers: Any) -> None:
        """Keep answers and sections; all else in the file stays."""
        if self.rig.exists():
            self.table = read_toml(self.rig)
        self.table |= {name: dict(part) for name, part in (sections or {}).items()}
        self.table["start"] = self.answers | {key: value for key, value in answers.items() if value != ""}
        with ol.files.atomic_file(self.rig) as temporary:
            temporary.write_text(toml_text(self.table), encoding="utf-8")


def kind(begun: Begun, front: Interviewer) -> None:
    """Monitor or prism."""
    words = (
        "A mirror in open air, in front of a monitor",
        "A silicone prism: a display on one face, the camera at another",
    )
    begun.write(kind=KINDS[front.pick(QUESTIONS[0].text, words, KINDS.index(begun.kind))])


def camera(begun: Begun, front: Interviewer) -> None:
    """One of those connected; its image's size by its driver."""
    from optolever.camera.cameras import find_cameras

    front.busy("looking for cameras")
    found, silent = find_cameras()
    for reason in () if found else silent.values():
        front.say(reason)
    addresses = [one.address for one in found] + [_SIMULATED]
    words = [" ".join(filter(None, (one.model, one.address, one.note))) for one in found]
    before = begun.devices.get("camera")
    default = addresses.index(before) if before in addresses else 0
    chosen = addresses[front.pick("Camera", [*words, "none: a simulated one, to try this out"], default)]
    devices = {key: value for key, value in begun.devices.items() if key not in ("camera", "exposure_ms")}
    if chosen == _SIMULATED:
        image = _typed(begun, front, "image")["image"]
    else:
        front.busy("taking a picture")
        image = image_size(chosen)
        front.say(f"The camera's image has {image} pixels.")
    begun.write({"devices": {"camera": chosen, **devices}}, image=image)


def display(begun: Begun, front: Interviewer) -> None:
    """One of those connected; its pixels, and its size where EDID has it."""
    devices, names = begun.devices, ["display", "diagonal"]
    if not begun.simulated:
        found = ol.projector.monitors()
        words, addresses = [*map(str, found), "a window, for a try"], [one.address for one in found]
        before = devices.get("display")
        default = addresses.index(before) if before in addresses else len(found) - 1
        chosen = front.pick("Display in front of the mirror", words, default)
        devices["display"] = [*addresses, "window"][chosen]
        for one in found[chosen : chosen + 1]:
            for fault in one.faults():
                front.say(fault, fault=True)
            inches = (one.rows_mm**2 + one.cols_mm**2) ** 0.5 / 25.4 if one.model else 0.0  # by EDID
            known = {"display": f"{one.cols}x{one.rows}"} | ({"diagonal": f"{inches:.4g}"} if inches else {})
            names = ["diagonal"] if not inches else []
            begun.write({}, **known)
            front.say(f"{one.cols} x {one.rows} pixels" + (f", {inches:.3g} inches" if inches else ""))
    begun.write({"devices": devices}, **(_typed(begun, front, *names) if names else {}))


def mirror(begun: Begun, front: Interviewer) -> None:
    """Sizes, angles and distances."""
    names = [each.name for each in questions_of(begun.kind)]
    first = [name for name in names if name not in ("kind", "display", "diagonal", "image", "across")]
    answers = _typed(begun, front, *(name for name in first if not name.startswith("view_")))
    begun.write(**answers)
    if begun.kind == "prism":
        if "across" not in begun.answers:
            begun.write(across=f"{typed_rig(begun.values()).offset_across:.7g}")
        begun.write(**_typed(begun, front, "across"))


def view(begun: Begun, front: Interviewer) -> None:
    """The focal length, by the width of the view; the scene is complete."""
    begun.write(**_typed(begun, front, "view_distance", "view_width"))
    typed = typed_rig(begun.values())
    if begun.rig.exists():
        begun.table = read_toml(begun.rig)
    kept = {name: part for name, part in begun.table.items() if name in _KEPT}
    with ol.files.together():
        with ol.files.atomic_file(begun.rig) as temporary:
            text = ol.scene.rig_toml(begun.rig.stem, typed)
            temporary.write_text(f"{text}\n{toml_text(kept)}", encoding="utf-8")
            scene = ol.scene.load(temporary)
        with ol.files.atomic_file(begun.rig.with_suffix(".png")) as temporary:
            draw_rig(scene, temporary)
        if begun.simulated:
            scene.save(begun.rig.with_suffix(ol.camera.VIRTUAL))
    begun.write(calibrated=False)
    share = visible_share(scene)
    if typed.focal_accuracy == VIEW_60:
        front.say("60 degrees are assumed: heights have an error of 10 % by that alone.")
    text = f"By these numbers {100 * share:.0f} % of the pixels see the display in the mirror"
    if share < _LEAST:
        cure = "move the camera nearer, take a longer lens, or correct the numbers"
        raise InputError(f"{text}, must be {100 * _LEAST:.0f} % at least: {cure} (go back a step)")
    front.say(f"{text} ({begun.rig.with_suffix('.png')}).")


def aim(begun: Begun, front: Interviewer) -> None:
    """The preview, until the user goes on."""
    scene = ol.scene.load(begun.rig)
    devices = ol.camera.devices_of(begun.rig)
    while True:
        with opened(begun.rig, devices, levels_of(begun.rig, "black", "white")) as now:
            now.require_size(scene)
            sheet = preview_on(now.display, scene, devices.display)
            last = front.look(views_of(now, sheet))
            if sheet is not None and sheet.key == "escape":
                raise GoTo
        if last is None:
            raise InputError("camera: no picture came; is it connected? (optolever doctor)")
        seen = last.aim.seen
        fault = ol.calibration.aim_fault(seen, visible_share(scene))
        if seen == 0:
            fault = f"{last.aim.advice(last.best)} Is {devices.display!r} the display in front of the mirror?"
        if not fault:
            return
        front.say(fault, fault=True)
        if front.go("Look again?", {"": "look again", "k": "keep it so"}) == "k":
            return


def expose(begun: Begun, front: Interviewer) -> None:
    """As `camera expose`."""
    front.busy("finding the longest exposure that saturates nothing")
    chosen, seen = chosen_exposure(begun.rig, ol.camera.devices_of(begun.rig))
    ol.scene.write_sections(begun.rig, {"devices": chosen.table()})
    front.say(f"{chosen.exposure_ms:.4g} ms: white less black is {100 * seen.swing:.0f} % of full scale.")
    if seen.swing < 0.2:
        front.say("That is little: open the lens, darken the room, or brighten the display.", fault=True)


def sync(begun: Begun, front: Interviewer) -> None:
    """As `camera sync`; without it every pattern waits half a second."""
    if begun.simulated:
        front.say("A simulated camera sees its patterns at once.")
        return
    front.busy("flipping the display for some seconds")
    try:
        kept, timing = synchronised(begun.rig, ol.camera.devices_of(begun.rig))
    except InputError as error:
        front.say(str(error), fault=True)
        if front.go("Measure the delay again?", {"": "again", "k": "wait half a second always"}) == "":
            raise GoTo("sync") from error
        return
    ol.scene.write_sections(begun.rig, {"devices": kept.table(), "sync": timing.to_table()})
    front.say(f"A pattern is settled {1e3 * timing.ready_s():.0f} ms after its swap.")
    for notice in ol.camera.sync_notices(timing):
        front.say(str(notice))


def response(begun: Begun, front: Interviewer) -> None:
    """The display's gamma, by grey levels: what decodes with it has no gamma any more."""
    front.busy("showing grey levels")
    found = ol.calibration.measure_response(capture_now(begun.rig, sequence_of(begun.rig, "ramp")))
    ol.calibration.store_response(begun.rig, found)
    gamma, misfit = found.gamma
    front.say(f"Gamma {gamma:.2f}, which decoding corrects; {100 * misfit:.1f} % of white differ from it.")
    if abs(gamma - 1) > _BENT:
        cure = "set the display, or the camera, so that both together are linear, and go back to this step"
        front.say(f"The live view does not take it off, and distrusts steep dents: {cure}.", fault=True)
    if misfit > 0.03:
        spoilt = "no power law: switch off night light, dynamic contrast and the camera's own gamma or HDR"
        front.say(f"The levels follow {spoilt}. They are taken off as measured.", fault=True)


def colour(begun: Begun, front: Interviewer) -> None:
    """As `response --colour`, where the camera has colours; may be left out."""
    if not has_colours(str(begun.devices["camera"])):
        return
    text = "Three patterns in each picture? It takes a display and a camera in colour."
    if front.go(text, {"": "leave it out", "c": "measure their colours"}) == "":
        return
    front.busy("showing the colours")
    chosen = ol.camera.devices_of(begun.rig)
    if not begun.simulated:
        chosen, _ = chosen_exposure(begun.rig, chosen, colour=True)
    with TemporaryDirectory() as folder:
        ramp = sequence_of(begun.rig, "ramp", "none")
        taken = capture_rig(begun.rig, chosen, ramp, Path(folder) / "ramp", keep=False).capture
    assert isinstance(taken, ol.projector.ColourCapture)
    found = ol.calibration.measure_colours(taken, taken.raw)
    ol.scene.write_sections(begun.rig, {"devices": chosen.table()})
    ol.calibration.store_colours(begun.rig, found)
    stripes = found.stripes or "unknown"
    front.say(f"Stripes {stripes}: optolever camera measure --rig {begun.rig} --colour {stripes} uses them.")


def rest(begun: Begun, front: Interviewer) -> None:
    """The mirror at rest: checked against the numbers, kept for heights and for the live view."""
    front.go("Take everything off the mirror, and hold still.", {"": "measure it"})
    front.busy("showing the patterns")
    scene = ol.scene.load(begun.rig)
    size = scene.pattern.rows, scene.pattern.cols
    fringe = ol.patterns.sequence("crossed", *size, period=ol.live.fringe_period(scene))
    capture, fringes = capture_rest(begun.rig, fringe, _RESTS)
    front.busy("decoding them")
    found = decoded_by_response(capture, response_of(begun.rig))
    mirror_share, good = ol.decode.mirror_coverage(found.flags)
    if good < 0.5:
        refused = any(test.fails for test in found.tests)
        mistakes = ol.decode.explain(capture.frames, capture.sequence) if refused else ()
        said = (*map(str, found.notices), *(f"most likely {one.name}" for one in mistakes[:1]))
        text = f"{100 * good:.0f} % of the mirror decoded: is it in focus, and dark around?"
        raise InputError(f"{text} ({'; '.join(said) or 'no notice'})")
    for notice in found.notices:
        front.say(str(notice))
    if fault := ol.calibration.rest_fault(found, scene):
        raise InputError(fault)
    if not begun.answers.get("calibrated"):
        front.busy("taking the errors of the numbers off, as far as the mirror at rest says them")
        scene = _adjusted(begun, front, found)
    height = ol.reconstruct.reconstruct(found, scene, anchor="middle")
    for one in ol.reconstruct.contacts(height)[:1]:
        place = f"at x = {one.x:.0f}, y = {one.y:.0f} mm, {1e3 * one.depth:.0f} µm deep"
        raise InputError(f"Something touches the mirror {place}: take it off, and wait a little.")
    scene.save(begun.rig, keep=begun.rig)
    ol.calibration.store_rest(begun.rig, found)
    prepared = ol.live.prepare(scene, fringes, found, fringe, bits=capture.bits)
    prepared.save(ol.live.kept_rest(begun.rig))
    fills = f"The mirror fills {100 * mirror_share:.0f} % of the picture, {100 * good:.0f} % of it decoded."
    front.say(f"{fills} The rig's numbers leave {100 * (prepared.error or 0.0):.1f} % of a height.")


def _adjusted(begun: Begun, front: Interviewer, found: "ol.decode.Correspondence") -> "ol.scene.Scene":
    """The typed rig, adjusted to its flat mirror within the accuracy of its numbers; as typed where the user
    keeps a mirror that is none."""
    typed = scene_of(begun.values())
    target, priors = ol.calibration.target_from_text("rest"), ol.scene.typed_sigmas(typed, typed.accuracy)
    try:
        fitted = ol.calibration.calibrate(typed, [ol.calibration.Observation("rest", target, found)], priors)
        chi = fitted.adjustment.chi
        why = f"chi {chi:.2g}, at most {_CHI:g} is normal" if chi > _CHI else ""
        why = why or "".join(map(str, fitted.implausible[:1]))
        if not why:
            return fitted.scene
    except InputError as error:
        why = str(error)
    touched = "Something touches the mirror, or it moved or is not flat, or a number is wrong"
    front.say(f"{touched} ({why}).", fault=True)
    if front.go("Measure it again?", {"": "again", "k": "keep it so, by the numbers as typed"}) == "":
        raise GoTo("rest")
    return typed


def targets(begun: Begun, front: Interviewer) -> None:
    """Captures of targets, as `calibrate --rig`; may be left out."""
    if begun.answers.get("calibrated"):
        front.say("Calibrated.")
        return
    word = f"{_FLATS} poses of a flat mirror" if begun.kind == "monitor" else "a ball of known radius"
    text = "Calibrate? Without it heights have the errors of the typed numbers, some per cent."
    if front.go(text, {"": "leave it out", "c": f"calibrate by {word}"}) == "":
        return
    scene, texts = scene_of(begun.values()), ["flat"] * _FLATS
    if begun.kind == "prism":
        radius = front.ask([BALL], {"radius": BALL.default(begun.kind)})["radius"]
        texts = ["rest", f"ball:{radius:g},0.003"]
    plan = [(each, ol.calibration.target_from_text(each)) for each in texts]
    calibrate = partial(ol.calibration.calibrate_so_far, scene, priors={})

    def wait(question: str) -> str:
        keys = {"": "capture", "s": "stop"} | ({"k": "keep the last"} if "k keeps" in question else {})
        return front.go(question.partition(". Enter")[0], keys)

    folder, shown = begun.rig.with_suffix(".captures"), "gray+phase"
    taken = capture_targets(begun.rig, plan, folder, shown, calibrate, ask=wait, resume=True, say=front.say)
    found = taken.required()
    if found.implausible:
        raise InputError(f"{found.implausible[0]}: measure the numbers again, or put the targets anew")
    found.scene.save(begun.rig, keep=begun.rig)
    begun.write(calibrated=True)
    front.say(f"Calibrated by {len(found.observations)} captures, chi {found.adjustment.chi:.2f}.")
    raise GoTo("rest")


def _typed(begun: Begun, front: Interviewer, *names: str) -> dict[str, Any]:
    """Answers as text, by name; the rig is drawn as they are typed."""
    questions, texts = questions_of(begun.kind, *names), begun.defaults(begun.kind)

    def draw(answers: Mapping[str, str], out: Path) -> None:
        draw_rig(scene_of(begun.values(**answers)), out)

    values = front.ask(questions, texts, draw)
    return {each.name: each.typed(values[each.name]) for each in questions}


def require_devices(begun: Begun) -> str:
    """STEP: REASON to go back to where camera, display or a size differ from before; empty: they do not."""
    if begun.simulated or "camera" not in begun.devices:
        return ""
    step, name, sizes = "camera", begun.devices.get("display", "window"), dict[str, str]()
    try:
        sizes["camera"] = image_size(str(begun.devices["camera"]))
        step = "display"
        if name != "window":
            monitor = ol.projector.choose_monitor(ol.projector.monitors(), name)
            sizes["display"] = f"{monitor.cols}x{monitor.rows}"
    except InputError as error:
        return f"{step}: {error}"
    for step, size in sizes.items():
        before = begun.answers.get({"camera": "image"}.get(step, step), size)
        if size != before:
            return f"{step}: it has {size} pixels, before it had {before}"
    return ""


#: Name -> title, and its action in words.
STEPS: dict[str, tuple[str, Callable[[Begun, Interviewer], None]]] = {
    "kind": ("What do you build?", kind),
    "camera": ("Camera", camera),
    "display": ("Display", display),
    "mirror": ("Sizes and places", mirror),
    "view": ("The camera's view", view),
    "aim": ("Aim and focus", aim),
    "expose": ("Exposure", expose),
    "sync": ("Delay of the display", sync),
    "response": ("Gamma of the display", response),
    "colour": ("Colours", colour),
    "rest": ("The mirror at rest", rest),
    "targets": ("Calibration", targets),
}
