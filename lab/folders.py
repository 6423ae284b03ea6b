"""Folders of pictures as other programs write them, with one fault or none, decoded by `optolever decode DIR
--sequence ... --display ...` and compared with the rays that drew them."""

import os
import re
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from optolever.calibration import RigResponse, store_response
from optolever.cli.app import run
from optolever.decode import Correspondence, Response
from optolever.patterns import Frame, Sequence, sequence_from_text
from optolever.projector import AreaTrace, trace_area
from optolever.reconstruct import HeightMap

from .hard.found import found_area, silent_mask
from .hard.rigs import KINDS as RIGS
from .hard.rigs import draw_rig
from .pairs.drawn import CODES, SHARES, SIZE
from .pairs.effects import Effect, Frames, drawn_camera, light_of_effects, read
from .pairs.structural import KINDS, Structural

__all__ = ["FAULTS", "SILENT", "Folder", "Judged", "drawn_folder", "judged"]

#: Faults: of KINDS, and others; what else than there the sentence of a true cause may hold.
FAULTS: tuple[str, ...] = (
    "order reversed",
    "lost",
    "doubled",
    "number of pictures",
    "axes exchanged",
    "period 2 % off",
)
FAULTS += ("inverted polarity", "white and black exchanged", "binary for Gray", "another display")
FAULTS += ("response of another rig", "bits reversed")
_WORDS = {
    "number of pictures": ("1 lost", "1 too many", "the same as the picture before"),
    "axes exchanged": ("u and v are exchanged",),
    "inverted polarity": ("negative",),
    "another display": ("--display",),
    "response of another rig": ("stated response",),
}
#: Share of the lit pixels that are good and beyond 5 sigma from which on a folder is silently wrong.
SILENT = 0.01
_OTHERS = ("axes exchanged", "period 2 % off", "inverted polarity", "binary for Gray")  # odd ones differ
_SCENES = ("axes exchanged", "another display")  # told by a scene where frames cannot
_CAUSE = re.compile(
    r"frames? \d|(is|are) (shown|missing|exchanged)|reverse order|each other's|has \d+ frames|same as|stated"
)
_GAMMAS = ((1.0, 2.2), (2.2, 1.0), (1.8, 2.4), (2.2, 1.4), (1.0, 1.3))  # of the display, of the response
_SEED, _LIT, _RAYS, _COUNTER = 6200, 0.15, 4, 9999  # a camera's counter goes on with 1
_NAMES = (
    "img_{n}",
    "DSC_{w:04}",
    "IMG_20261128_{s}",
    "{i}",
    "Frame {i:06} (left)",
    "2026-11-28T{s}Z",
    "c2-{a}",
)


@dataclass(frozen=True, slots=True, eq=False)
class Folder:
    """fault: of FAULTS, or none; code, described: what the user states; area: the truth; pictures: by the
    names of their files; gamma: of the response that is stated (0: none); beside: 1 other files, 2 a picture
    as well."""

    number: int
    fault: str
    code: str
    described: Sequence
    area: AreaTrace
    pictures: dict[str, NDArray[Any]]
    gamma: float = 0.0
    beside: int = 0

    def write(self, target: Path) -> None:
        """Files whose times are in no order."""
        target.mkdir()
        for i, (name, picture) in reversed(list(enumerate(self.pictures.items()))):
            if name.endswith(".npy"):
                np.save(target / name, picture)
            elif len(self.pictures) == 1:
                cv2.imwritemulti(str(target / name), list(picture))
            else:
                cv2.imwrite(str(target / name), picture)
            os.utime(target / name, (1e9 - i % 7, 1e9 - i % 7))
        for name in (".DS_Store", "Thumbs.db", "notes.txt", f"._{next(iter(self.pictures))}")[
            : 4 * self.beside
        ]:
            (target / name).write_bytes(b"no picture")
        if self.beside > 1 and len(self.pictures) > 1:
            cv2.imwrite(str(target / "preview.jpg"), np.zeros((60, 80, 3), np.uint8))


@dataclass(frozen=True, slots=True)
class Judged:
    """good, silent: shares of the lit pixels that are good, and good and off by more than 5 sigma; named:
    'rightly' or 'falsely' (a cause), or ''; refused: by an error; told: names of the notices, the error,
    sentences of a cause first."""

    number: int
    fault: str
    code: str
    good: float
    silent: float
    named: str
    refused: bool
    told: tuple[str, ...]

    @property
    def verdict(self) -> str:
        """In words."""
        if not self.fault and (self.named or self.refused):
            return "false alarm"
        if self.named == "rightly" or (self.silent <= SILENT and self.named):
            return f"named {self.named}"
        if self.silent > SILENT:
            return "silently wrong"
        return "refused" if self.refused else "flagged" if self.good < 0.5 else "within 5 sigma"


def drawn_folder(number: int, fault: str = "") -> Folder:
    """A number's folder is always the same, whatever else is drawn."""
    rng, lit = np.random.default_rng([_SEED, number, *fault.encode()]), 0.0
    while lit < _LIT:
        rig = draw_rig(rng, RIGS[number % len(RIGS)], SIZE)
        lit = rig.lit
    other, rows, cols = number % 2 and fault in _OTHERS, rig.scene.pattern.rows, rig.scene.pattern.cols
    code = str(rng.choice(KINDS.get(fault, KINDS["lost"])[0]) if fault else rng.choice(CODES, p=SHARES))
    code = "binary" if other and fault == "binary for Gray" else code
    sizes = (cols, rows), (2 * rows, 2 * cols), (1080, 1920), (rows - rows // 20, cols), (rows, cols * 3 // 2)
    typed = sizes[number % len(sizes)] if fault == "another display" else (rows, cols)
    shown, described = (sequence_from_text(code, *size) for size in ((rows, cols), typed))
    at, case = int(rng.integers(2, len(shown) - 2)), number % 4 if fault == "number of pictures" else -1
    change = Structural("" if other else fault, at, at - 1)
    shown = _otherwise(rng, shown, fault) if other else change.shown(shown)
    gamma, stated = _GAMMAS[number % len(_GAMMAS)] if "response" in fault else (1.0, 0.0)
    area = trace_area(rig.scene, rig.surface, _RAYS)
    light = light_of_effects(area, rig, shown, (Effect("gamma", gamma),), rng)
    frames = change.spoil(read(light, drawn_camera(rng), (), rng), described)
    if other and fault == "inverted polarity":
        frames = 255 - frames
    if case == 0:  # missed by the camera
        frames = np.delete(frames, at, axis=0)
    elif case > 1:  # saved twice, taken twice
        frames = np.insert(frames, at, frames[at] ^ np.uint8(case == 3), axis=0)
    pictures = _named(frames, "img_{n}") if fault else _as_cameras_write(frames, number)
    if case == 1:
        del pictures[f"img_{at + 1}.png"]
    return Folder(number, fault, code, described, area, pictures, stated, 0 if fault else number % 3)


def _otherwise(rng: np.random.Generator, shown: Sequence, fault: str) -> Sequence:
    """All of the axes exchanged, a period 5 to 35 % off, or Gray bits."""
    finest = min((one.period_px for one in shown.frames if one.period_px is not None), default=0.0)
    scale = float(np.exp(rng.choice((-1, 1)) * rng.uniform(0.05, 0.3)))

    def change(frame: Frame) -> Frame:
        if fault == "axes exchanged" and frame.axis is not None:
            return replace(frame, axis="v" if frame.axis == "u" else "u")
        if fault == "period 2 % off" and frame.period_px == finest:
            return replace(frame, period_px=scale * finest)
        return replace(frame, kind="gray") if frame.kind == "binary" else frame

    return replace(shown, frames=tuple(map(change, shown.frames)))


def _named(pictures: NDArray[Any], name: str, suffix: str = ".png") -> dict[str, NDArray[Any]]:
    """By the names of files, which count as `name` says."""
    found = {}
    for i, picture in enumerate(pictures):
        wrapped = (_COUNTER - len(pictures) // 2 + i) % _COUNTER + 1
        seconds, letters = f"10{15 + i // 8}{7 * (i % 8):02}", chr(97 + i // 26) + chr(97 + i % 26)
        found[name.format(i=i, n=i + 1, w=wrapped, s=seconds, a=letters) + suffix] = picture
    return found


def _as_cameras_write(frames: Frames, number: int) -> dict[str, NDArray[Any]]:
    """Names and formats; no two of the first 84 numbers are alike."""
    colours = np.stack([frames * share for share in (0.7, 1.0, 0.85, 0.0)], axis=-1).round().astype(np.uint8)
    suffix, pictures = (
        (".png", frames),
        (".bmp", frames),
        (".PGM", frames),
        (".tif", frames),
        (".png", frames.astype(np.uint16) * 257),
        (".tiff", frames.astype(np.uint16) << 4),
        (".tif", frames.astype(np.float32) / 255),
        (".bmp", np.stack([frames] * 3, axis=-1)),
        (".PNG", colours + np.array([0, 0, 0, 255], np.uint8)),
        (".JPG", frames),
        (".npy", frames[None]),
        (".tif", frames.astype(np.uint16)[None]),
    )[number % 12]
    return _named(pictures, _NAMES[number % len(_NAMES)], suffix)


def judged(folder: Folder, place: Path) -> Judged:
    """Write a folder into the empty folder `place`, decode it, reconstruct it where only a scene tells the
    fault, and compare."""
    rig, out, heights, shown = place / "rig.toml", place / "c.npz", place / "h.npz", folder.described
    folder.write(place / "pictures")
    folder.area.scene.save(rig)
    options = ["--sequence", folder.code, "--display", f"{shown.cols}x{shown.rows}", "--out", str(out)]
    if folder.gamma:
        response = replace(Response.from_gamma(folder.gamma), blur=0.5)
        store_response(rig, RigResponse(response, 0.05, np.full(folder.area.visible.shape, 150.0)))
        options += ["--response", str(rig)]
    error, found, told = _error("decode", str(place / "pictures"), *options), (0.0, 0.0), list[str]()
    if not error:
        seen, lit = Correspondence.load(out), folder.area.visible
        wrong = silent_mask(found_area(seen, folder.area, shown))
        found = float(seen.good[lit].mean()), float(wrong[lit].mean())
        told = [one.name for one in seen.notices]
        if folder.fault in _SCENES and not _cause(folder, told):
            error = _error("reconstruct", str(out), "--scene", str(rig), "--out", str(heights))
            told += [] if error else [one.name for one in HeightMap.load(heights).notices]
    told += [error.replace(str(place / "pictures"), "DIR")] * bool(error)
    told.sort(key=lambda one: _CAUSE.search(one) is None)
    cause = _cause(folder, told)
    return Judged(folder.number, folder.fault, folder.code, *found, cause, bool(error), (*told,))


def _error(*args: str) -> str:
    """Last line of a command that fails; empty: it does not."""
    with redirect_stdout(StringIO()), redirect_stderr(StringIO()) as said:
        failed = run(args)
    return said.getvalue().strip().splitlines()[-1] if failed else ""


def _cause(folder: Folder, told: list[str]) -> str:
    causes = [one for one in told if _CAUSE.search(one)]
    words = *_WORDS.get(folder.fault, ()), *KINDS.get(folder.fault, ((), ()))[1]
    right = any(word in one for one in causes for word in words)
    return "rightly" if right else "falsely" if causes else ""
