"""Streams of a tactile sensor's frames of all kinds, counted; faults of frames."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from optolever.decode import decode
from optolever.live import Live, Prepared, prepare
from optolever.patterns import Sequence, sequence
from optolever.scene import Scene

from .world import BALL, GAUSS, LAYERED, PUNCH, World, expose, photons, world_of

__all__ = ["FAULTS", "KINDS", "Moment", "StreamRig", "Tally", "played", "stream_rig"]

Frame = NDArray[np.uint8]
Dents = tuple[tuple[float, float, float, float, float], ...]
NOISE = 1.5
_PRESSES = 3  # of a stream, each at another place


def _upper(frame: Frame) -> NDArray[np.bool_]:
    """Half of the rows, (H, 1)."""
    return np.arange(len(frame))[:, None] < len(frame) // 2


#: What may be wrong with a run of frames; the frame at fault from the good one and the one before.
FAULTS: dict[str, Callable[[Frame, Frame], Frame]] = {
    "black": lambda now, before: np.zeros_like(now),
    "white": lambda now, before: np.full_like(now, 255),
    "torn": lambda now, before: np.where(_upper(now), now, np.roll(before, 9, 1)),
    "covered": lambda now, before: np.where(_upper(now.T).T, now, np.uint8(25)),
    "bumped": lambda now, before: np.roll(now, 3, 1),
    "rolled": lambda now, before: np.roll(now, 2 * now.shape[0] // 7, 0),
    "saturated": lambda now, before: np.clip(now.astype(np.float64) * 3, 0, 255).astype(np.uint8),
    "light": lambda now, before: (now * 0.5).astype(np.uint8),
}


@dataclass(frozen=True)
class Moment:
    """What a frame shows. fading: see World; creep: of the camera along columns and rows, pixels; lamp:
    levels that it adds at the far end of the columns; blur: of the lens, rms pixels; dark: radius, mm, of the
    disc around the first dent where an object that wets the silicone ends total reflection; contacts: how
    many the dents are, None: each is one."""

    dents: Dents = ()
    fading: bool = True
    creep: tuple[float, float] = (0.0, 0.0)
    lamp: float = 0.0
    blur: float = 0.0
    dark: float = 0.0
    contacts: int | None = None


Kind = Callable[[float, float, float, float], Moment]


def _pressed(kind: int, size: float, peak: float, fading: bool = True) -> Kind:
    return lambda x, y, rise, at: Moment(((kind, x, y, size, peak * rise),), fading)


def _at(x: float | None, y: float | None) -> Kind:
    """A ball of 4 mm beside an end of the mirror."""
    return lambda across, along, rise, at: Moment(
        ((BALL, across if x is None else x, along if y is None else y, 4.0, 0.05 * rise),), False
    )


def _rounded(x: float, y: float, radius: float, depth: float) -> Dents:
    """A punch whose rim is rounded over .3 mm, as the sum of flat ones: pressures and deflections add."""
    return tuple((PUNCH, x, y, radius - 0.3 * (k + 0.5) / 16, depth / 16) for k in range(16))


def _line(x: float, y: float, along: tuple[float, float], depth: float) -> Dents:
    """Balls of 2 mm, .6 mm apart over 8 mm from a place in a direction."""
    return tuple((BALL, x + 0.6 * k * along[0], y + 0.6 * k * along[1], 2.0, depth) for k in range(14))


def _beside(change: Callable[[float], Moment]) -> Kind:
    """A smooth press, and what changes slowly."""
    return lambda x, y, rise, at: replace(change(at), dents=((GAUSS, x, y, 6.0, 0.1 * rise),))


#: From the place of a press (mm), its share of the depth and the share of the stream that is over.
KINDS: dict[str, Kind] = {
    "smooth press": _pressed(GAUSS, 6.0, 0.15),
    "two slide": lambda x, y, rise, at: Moment(
        ((GAUSS, x - 9, y + 3 * rise, 4.0, 0.06), (GAUSS, x + 7, y - 3 * rise, 5.0, 0.08))
    ),
    "ball 3 mm, half-space": _pressed(BALL, 3.0, 0.12, fading=False),
    "ball 4 mm rolls": lambda x, y, rise, at: Moment(((BALL, x - 4 + 8 * rise, y, 4.0, 0.08),), False),
    "ball 5 mm, half-space": _pressed(BALL, 5.0, 0.25, fading=False),
    "deep 2 mm": _pressed(GAUSS, 2.0, 0.3),
    "deep 3 mm": _pressed(GAUSS, 3.0, 0.35),
    "creep along columns": _beside(lambda at: Moment(creep=(0.2 * at, 0.0))),
    "creep along rows": _beside(lambda at: Moment(creep=(0.0, 0.2 * at))),
    "lamp": _beside(lambda at: Moment(lamp=25 * at)),
    "blur": _beside(lambda at: Moment(blur=1.5 * at)),
    "dark": lambda x, y, rise, at: Moment(((BALL, x, y, 4.0, 0.05 * rise),), False, dark=3.6),
    "cut at x = 0": _at(4.0, None),
    "cut at x = L0": _at(57.0, None),
    "cut at y = 0": _at(None, 2.0),
    "cut at y = W": _at(None, 43.0),
    "narrow, 1 mm": _pressed(BALL, 1.0, 0.015, fading=False),
    "sharp punch": _pressed(PUNCH, 4.0, 0.03, fading=False),
    "rounded punch": lambda x, y, rise, at: Moment(_rounded(x, y, 4.0, 0.03 * rise), False, contacts=1),
    "line": lambda x, y, rise, at: Moment(_line(x - 4, y, (1.0, 0.0), 0.008 * rise), False, contacts=1),
    "L": lambda x, y, rise, at: Moment(
        _line(x - 4, y, (1.0, 0.0), 0.006 * rise) + _line(x - 4, y, (0.0, 1.0), 0.006 * rise),
        False,
        contacts=1,
    ),
    "ball 4 mm, layer": _pressed(LAYERED, 4.0, 0.05, fading=False),
}


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

    def shown(self, moment: Moment) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
        """Light (H, W) and true height (R, C) of a moment."""
        here = replace(self, world=replace(self.world.moved(*moment.creep), fading=moment.fading))
        light = gaussian_filter(here.light(moment.dents), moment.blur)
        if moment.dark:
            x, y = here.world.truth(())[3:]
            wet = np.hypot(x - moment.dents[0][1], y - moment.dents[0][2]) < moment.dark
            light *= 1 - np.float32(0.97) * gaussian_filter(wet.astype(np.float32), 0.7)
        light += np.linspace(0, moment.lamp / 216, light.shape[1], dtype=np.float32)
        return light, here.truth(moment.dents)


@dataclass(frozen=True)
class Tally:
    """Counts of a stream's frames. noticed: trusted, with a notice; wrong: trusted, with more than 0.1 % of
    the heights beyond five sigma; silent: of these the ones without a notice; contacts: trusted, beyond 10 um
    of depth, that show as many contacts as there are; off: of these the ones whose deepest is beyond five
    sigma, above it where it says "at least"; ratio: error over sigma, rms over the trusted frames."""

    frames: int
    trusted: int
    noticed: int
    wrong: int
    silent: int
    contacts: int
    off: int
    ratio: float


def stream_rig(scene: Scene, cell: int = 2, seed: int = 1) -> StreamRig:
    """Prepared from a decoded capture and eight frames at rest."""
    world, rng = world_of(scene), np.random.default_rng(seed)
    full = sequence("gray+phase", scene.pattern.rows, scene.pattern.cols)
    rest_map = decode(expose(world.lights((), full), rng, NOISE), full)
    fringe = sequence("crossed", scene.pattern.rows, scene.pattern.cols, period=10.0)
    rest = np.repeat(world.lights((), fringe), 8, 0)
    made = prepare(scene, expose(rest, rng, NOISE), rest_map, fringe, cell=cell)
    return StreamRig(scene, world, fringe, replace(made, error=0.0))  # its numbers are exact


def played(rig: StreamRig, kind: Kind, frames: int, rng: np.random.Generator) -> Tally:
    """A stream of three presses at drawn places of a mirror of 60 x 45 mm, by frames with photon noise."""
    live, ratios = Live(rig.prepared), []
    counts: Counter[str] = Counter()
    places = rng.uniform((26, 18), (34, 27), (_PRESSES, 2))
    for k in range(frames):
        press, within = divmod(_PRESSES * k / frames, 1)
        x, y = places[int(press)]
        moment = kind(x, y, 1 - abs(2 * within - 1), k / frames)
        light, true = rig.shown(moment)
        reading = live.update(photons(light, rng), k / 60)
        if not reading.trusted:
            continue
        ratio = ((reading.z - true) / reading.sigma)[reading.good]
        wrong = float(np.mean(np.abs(ratio) > 5)) > 1e-3
        deepest = float(true.max())
        count = len(moment.dents) if moment.contacts is None else moment.contacts
        same = deepest > 0.01 and len(reading.touches) == count
        counts["noticed"] += bool(reading.notices)
        counts["wrong"] += wrong
        counts["silent"] += wrong and not reading.notices
        counts["contacts"] += same
        if same:
            touch = reading.touches[0]
            above = touch.depth - deepest
            counts["off"] += (above if touch.hole else abs(above)) > 5 * touch.depth_sigma
        ratios.append(float(np.mean(np.square(ratio))))
    return Tally(
        frames=frames, trusted=len(ratios), noticed=counts["noticed"], wrong=counts["wrong"],
        silent=counts["silent"], contacts=counts["contacts"], off=counts["off"],
        ratio=float(np.sqrt(np.mean(ratios))),
    )  # fmt: skip
