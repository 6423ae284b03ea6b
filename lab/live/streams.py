"""Drawn streams of a tactile sensor: presses, slides, rolls, fast hits, two fingers, nothing; half with a
fault."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optolever.decode import decode
from optolever.live import Live, Prepared, Reading, prepare
from optolever.patterns import Sequence, sequence
from optolever.scene import Scene

from .world import BALL, GAUSS, World, expose, world_of

__all__ = ["FAULTS", "Stream", "StreamRig", "Tally", "drawn_stream", "play", "stream_rig"]

Frame = NDArray[np.uint8]
Dents = tuple[tuple[float, float, float, float, float], ...]
NOISE = 1.5
_SHALLOW = 0.02  # mm: of a dent that is less the error counts as of this
#: What may be wrong with a run of frames; the frame at fault from the good one and the one before.
FAULTS: dict[str, Callable[[Frame, Frame], Frame]] = {
    "black": lambda now, before: np.zeros_like(now),
    "white": lambda now, before: np.full_like(now, 255),
    "torn": lambda now, before: _halves(now, np.roll(before, 9, 1)),
    "covered": lambda now, before: _covered(now),
    "bumped": lambda now, before: np.roll(now, 3, 1),
    "rolled": lambda now, before: np.roll(now, 2 * now.shape[0] // 7, 0),
    "saturated": lambda now, before: np.clip(now.astype(np.float64) * 3, 0, 255).astype(np.uint8),
    "light": lambda now, before: (now * 0.5).astype(np.uint8),
}
_ACTS = ("press", "slide", "roll", "hit", "two", "nothing")


@dataclass(frozen=True)
class StreamRig:
    """A rig at rest, prepared, with its renderer."""

    scene: Scene
    world: World
    fringe: Sequence
    prepared: Prepared

    def light(self, dents: Dents, side: int = 3) -> NDArray[np.float32]:
        """(H, W), 1: all of a lit cell's."""
        found: NDArray[np.float32] = self.world.lights(dents, self.fringe, side)[0]
        return found

    def truth(self, dents: Dents) -> NDArray[np.float64]:
        """Height in the middle of the cells, mm, (R, C)."""
        cell, (rows, cols) = self.prepared.rig.carriers.cell, self.prepared.rig.carriers.shape
        z = self.world.truth(dents)[2][: rows * cell, : cols * cell]
        return np.asarray(z.reshape(rows, cell, cols, cell).mean((1, 3)))


@dataclass(frozen=True)
class Stream:
    """act: what happens; fault: its name, or empty; from frame `first` to before `last`; dents of every
    frame."""

    act: str
    fault: str
    first: int
    last: int
    dents: tuple[Dents, ...]


@dataclass
class Tally:
    """Counted over streams. wrong: trusted frames with more than 0.1 % of the heights beyond five sigma;
    silent: of these the ones without a notice; gross: those whose rms error is above 1 % of the depth; told:
    faults that were told within two frames; recovered: within ten frames of their end; refused: good frames
    that were not trusted."""

    frames: int = 0
    good: int = 0
    wrong: int = 0
    silent: int = 0
    gross: int = 0
    refused: int = 0
    faults: int = 0
    told: int = 0
    recovered: int = 0


def stream_rig(scene: Scene, cell: int = 2, seed: int = 1) -> StreamRig:
    """Prepared from a decoded capture and eight frames at rest."""
    world, rng = world_of(scene), np.random.default_rng(seed)
    full = sequence("gray+phase", scene.pattern.rows, scene.pattern.cols)
    rest_map = decode(expose(world.lights((), full), rng, NOISE), full)
    fringe = sequence("crossed", scene.pattern.rows, scene.pattern.cols, period=10.0)
    rest = np.repeat(world.lights((), fringe), 8, 0)
    return StreamRig(
        scene, world, fringe, prepare(scene, expose(rest, rng, NOISE), rest_map, fringe, cell=cell)
    )


def drawn_stream(rng: np.random.Generator, frames: int, faulty: bool) -> Stream:
    """On a mirror of 60 x 45 mm."""
    act = str(rng.choice(_ACTS))
    at = np.linspace(0, 1, frames)
    x, y = rng.uniform(22, 38), rng.uniform(15, 30)
    size, peak = rng.uniform(4, 8), rng.uniform(0.05, 0.15)
    angle = rng.uniform(0, 2 * np.pi)
    moved = (8 * at[:, None] - 4) * np.array([np.cos(angle), np.sin(angle)])
    ball = rng.uniform(0.03, 0.06)
    dents: list[Dents] = []
    for k in range(frames):
        rise = min(1.0, 2 * at[k])
        if act == "press":
            dents.append(((GAUSS, x, y, size, peak * rise),))
        elif act == "slide":
            dents.append(((GAUSS, x + moved[k, 0], y + moved[k, 1], size, peak),))
        elif act == "roll":
            dents.append(((BALL, x + moved[k, 0], y + moved[k, 1], 4.0, ball),))
        elif act == "hit":
            dents.append(((GAUSS, x, y, size, peak),) if k % 6 in (3, 4) else ())
        elif act == "two":
            dents.append(((GAUSS, x - 8, y - 4, 4.0, 0.05), (GAUSS, x + 8, y + 4, 5.0, 0.08 * rise)))
        else:
            dents.append(())
    fault = str(rng.choice(list(FAULTS))) if faulty else ""
    first = int(rng.integers(frames // 4, frames // 2))
    return Stream(act, fault, first, min(first + 4, frames - 3), tuple(dents))


def play(rig: StreamRig, stream: Stream, rng: np.random.Generator, tally: Tally) -> Iterator[Reading]:
    """Readings of a stream; counts them."""
    live, before = Live(rig.prepared), None
    told = recovered = False
    for k, dents in enumerate(stream.dents):
        good = expose(rig.light(dents), rng, NOISE)
        bad = bool(stream.fault) and stream.first <= k < stream.last
        frame = FAULTS[stream.fault](good, good if before is None else before) if bad else good
        before = good
        reading = live.update(frame, k / 60)
        tally.frames += 1
        true = rig.truth(dents)
        beyond = (np.abs(reading.z - true) > 5 * reading.sigma)[reading.good]
        wrong = reading.trusted and bool(beyond.mean() > 1e-3)
        tally.wrong += wrong
        silent = wrong and not reading.notices
        tally.silent += silent
        error = float((reading.z - true)[reading.good].std()) if reading.good.any() else 0.0
        tally.gross += silent and error > 0.01 * max(float(true.max()), _SHALLOW)
        if bad and k < stream.first + 2:
            told |= not reading.trusted or bool(reading.notices)
        if not bad:
            tally.good += 1
            tally.refused += not reading.trusted
        if stream.fault and stream.last <= k < stream.last + 10:
            recovered |= reading.trusted
        yield reading
    if stream.fault:
        tally.faults += 1
        tally.told += told
        tally.recovered += recovered


def _halves(upper: Frame, lower: Frame) -> Frame:
    torn = upper.copy()
    torn[len(torn) // 2 :] = lower[len(torn) // 2 :]
    return torn


def _covered(frame: Frame) -> Frame:
    covered = frame.copy()
    covered[:, frame.shape[1] // 2 :] = 25
    return covered
