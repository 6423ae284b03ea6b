"""Wrong captures of drawn rigs, and windows of right ones.

frames: every frame black, white, twice, missing, and a picture too many; descriptions: cells, phases, axes,
offsets; windows: random parts of right captures in ../shared, which must get no verdict.
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from optolever.decode import decode, explain
from optolever.patterns import Frame, Sequence
from optolever.projector import Capture

from .light import Shot, World, shoot
from .rigs import draw_rig

SHARED = Path(__file__).parents[3] / "shared"
CODES = ("gray+phase", "phase", "gray")
FAULTS = ("black", "white", "twice", "missing", "extra")
#: Share of the good pixels beyond 5 sigma up to which a capture is harmless.
HARMLESS = 5e-3
#: Right captures in ../shared/cases.
RIGHT = ("12/cap", "19/cap", "23/cap", "t5/calseq4_window")
#: Right by another description, refused by its own.
COMPLEMENTARY = SHARED / "cases/t5/period_cells_slviewer"
#: Parts of notices that say nothing about frames or their description.
WEAK = ("sigma is", "the mirror moved", "are ambiguous", "too weak", "neighbouring pixels contradict")


@dataclass(frozen=True)
class Outcome:
    """good: share of the lit pixels; wrong: share of the good beyond 5 sigma; told: notices."""

    name: str
    good: float
    wrong: float
    told: tuple[str, ...]

    @property
    def verdict(self) -> bool:
        """Whether a notice judges the frames."""
        return any(judges(text) for text in self.told)


def judges(text: str) -> bool:
    return not any(part in text for part in WEAK)


def right_window(shot: Capture, rng: np.random.Generator, side: int = 80) -> Outcome:
    """A random part of a right capture."""
    _, rows, cols = np.shape(shot.frames)
    y, x = rng.integers(0, max(rows - side, 0) + 1), rng.integers(0, max(cols - side, 0) + 1)
    found = decode(shot.frames[:, y : y + side, x : x + side], shot.sequence)
    return Outcome(f"{y}, {x}", float(found.good.mean()), 0.0, tuple(str(one) for one in found.notices))


def explained(frames: Any, sequence: Sequence, *numbers: float) -> bool:
    """Whether one of the mistakes' names holds one of the numbers; without numbers, whether there is one."""
    names = [one.name for one in explain(frames, sequence)]
    found = {float(one) for text in names for one in re.findall(r"\d*\.?\d+", text)}
    return bool(names) and (not numbers or any(abs(one - k) < 1e-6 for one in found for k in numbers))


def outcome(name: str, shot: Shot, frames: object, sequence: Sequence) -> Outcome:
    """Decoded, beside the truth."""
    found = decode(frames, sequence)  # type: ignore[arg-type]
    use = found.good & shot.lit
    off = np.zeros(use.shape, np.bool_)
    for place, sigma, axis in ((found.u, found.sigma_u, "u"), (found.v, found.sigma_v, "v")):
        off |= ~(np.abs(place - shot.truth[axis]) <= 5 * sigma)
    told = tuple(str(one) for one in found.notices)
    return Outcome(
        name, float(use.sum() / shot.lit.sum()), float(off[use].mean()) if use.any() else 0.0, told
    )


def broken(frames: np.ndarray, fault: str, k: int) -> np.ndarray:
    """Frames (N, H, W) with a fault at frame k; 'extra': a white scene, then all others but the last."""
    out, bright = frames.copy(), frames.max(axis=0)
    if fault == "black":
        out[k] = frames.min(axis=0)
    elif fault == "white":
        out[k] = bright
    elif fault == "twice":
        out[k + 1 :] = frames[k:-1]
    elif fault == "missing":
        out[k:-1] = frames[k + 1 :]
    else:
        out[k + 1 :], out[k] = frames[k:-1], bright
    return out


def frame_faults(
    rig: int, code: str, faults: tuple[str, ...] = FAULTS, every: int = 1
) -> Iterator[tuple[int, Outcome]]:
    """Number of the frame, and what is found of it."""
    shot = shoot(draw_rig(rig), code, World())
    count = len(shot.sequence)
    for fault in faults:
        places = range(0, count, every) if fault != "extra" else (0, count // 2, count - 1)
        for k in places:
            wrong = broken(shot.frames, fault, k)
            if not np.array_equal(wrong, shot.frames):
                frame = shot.sequence[k]
                label = f"{fault} {k} {frame.kind} {frame.axis or ''}{'' if frame.bit is None else frame.bit}"
                yield k, outcome(f"{code} {rig}: {label}", shot, wrong, shot.sequence)


def silent(found: Outcome) -> bool:
    """Wrong without a verdict."""
    return found.wrong > HARMLESS and found.good > HARMLESS and not found.verdict


def _changed(shown: Sequence, by: Callable[[Frame], Frame]) -> Sequence:
    return replace(shown, frames=tuple(map(by, shown.frames)))


def descriptions(shown: Sequence) -> Iterator[tuple[str, tuple[float, ...], Sequence]]:
    """Name, numbers one of which a notice must hold, and what is described, of gray+phase as shown."""
    cell = next(one.cell_px for one in shown.frames if one.bit is not None)
    top = max(one.bit for one in shown.frames if one.bit is not None and one.axis == "u")
    for by in (0.5, 0.75, 1.25, 1.5, 2.0):
        yield (
            f"cells x {by:g}",
            (cell,),
            _changed(shown, lambda one, by=by: _bit(one, cell_px=by * one.cell_px)),
        )
    for turn in (0.1, 0.25):
        yield f"phase + {turn:g}", (turn,), _changed(shown, lambda one, turn=turn: _shifted(one, turn))
    mirrored = _changed(
        shown, lambda one: _bit(one, inverted=not one.inverted) if (one.axis, one.bit) == ("u", top) else one
    )
    yield "bits of u mirrored", (), mirrored
    other = {"u": "v", "v": "u"}
    yield "u and v exchanged", (), _changed(shown, lambda one: replace(one, axis=other.get(one.axis or "")))
    yield "offset + 100", (), _changed(shown, lambda one: _bit(one, offset_px=(one.offset_px or 0.0) + 100))


def _bit(frame: Frame, **change: Any) -> Frame:
    return frame if frame.bit is None else replace(frame, **change)


def _shifted(frame: Frame, turn: float) -> Frame:
    return replace(frame, shift=(frame.shift or 0.0) + 2 * np.pi * turn) if frame.kind == "phase" else frame
