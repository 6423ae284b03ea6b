"""Adaptive sensing: the next frames follow from what the last ones told, until the height is good enough.

Asked for: a share of the pixels that see the pattern whose height is within a goal. A pixel of sigma s is
within with erf(goal / (sqrt 2 s)), one without a height never. After every frame the closed forms of
`prediction`, fed with the contrast, place, footprint and noise that were measured, tell what each
possible next step would make of that share; the step that gains most per frame is taken.
"""

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from optolever.decode import Correspondence, Flag, decode
from optolever.errors import InputError
from optolever.patterns import Frame, Sequence
from optolever.reconstruct import HeightMap, reconstruct
from optolever.scene import Scene, dent

from .candidates import SPAN
from .fringes import contrast
from .on_demand import OnDemand
from .prediction import Prediction, predict
from .sensitivity import Lever, rms_where
from .view import Floats, View

__all__ = ["Adapted", "Goal", "Step", "adapt", "share_within"]

_UNSEEN = int(Flag.DARK | Flag.OFF_PATTERN | Flag.INVALID)
FIRST_PERIODS = (4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 24.0, 32.0)
#: Gain of the share per frame under which nothing more is to be had.
LEAST_GAIN = 1e-5
#: Probability of a wrong order that the first frames may have at rest.
SAFE = 1e-4


@dataclass(frozen=True, slots=True)
class Goal:
    """height: mm that the error may have; share: of the pixels that see the pattern, which must be within;
    frames: most to show."""

    height: float
    share: float = 0.95
    frames: int = 80


@dataclass(frozen=True, slots=True)
class Step:
    """What was shown next and where that led: frames in all, share estimated to be within the goal."""

    shown: str
    frames: int
    within: float


@dataclass(frozen=True)
class Adapted:
    """The end of an adaptive measurement: met, or why not; all frames in their order, height, steps."""

    sequence: Sequence
    correspondence: Correspondence
    height: HeightMap
    steps: list[Step]
    met: bool
    why: str


def share_within(sigma: Floats, measured: NDArray[np.bool_], seen: NDArray[np.bool_], goal: float) -> float:
    """Expected share of the `seen` pixels that are measured and within the goal."""
    with np.errstate(divide="ignore", invalid="ignore"):
        each = np.where(measured, erf(goal / (math.sqrt(2) * sigma)), 0.0)
    return float(np.nan_to_num(each)[seen].mean()) if seen.any() else 0.0


def adapt(source: OnDemand, scene: Scene, goal: Goal, *, noise: float) -> Adapted:
    """Measure until the goal is met where it can be met.

    noise: rms of the camera, 8-bit levels, for what is shown first; later ones go by the decoder's sigma.
    InputError if the goal is no positive height or the scene sees no pattern.
    """
    if not (goal.height > 0 and 0 < goal.share < 1):
        raise InputError(f"goal: {goal.height:g} mm at {goal.share:g} of the pixels, must be > 0 and in 0..1")
    lever = Lever(scene, dent("flat", scene))
    frames = _first(lever, noise)
    images = source.show(frames)
    steps: list[Step] = []
    shown = f"start: {_words(frames)}"
    while True:
        sequence = Sequence(frames, scene.pattern.rows, scene.pattern.cols, "adaptive")
        state = _State.of(images, sequence, scene, lever, goal)
        steps.append(Step(shown, len(frames), state.within))
        if state.within >= goal.share:
            return Adapted(sequence, state.seen, state.height, steps, True, "")
        following = _best(state, frames, goal, noise)
        if following is None:
            why = "no further frame helps: the goal cannot be met on so many pixels"
            return Adapted(sequence, state.seen, state.height, steps, False, why)
        if len(frames) + len(following) > goal.frames:
            return Adapted(sequence, state.seen, state.height, steps, False, "the frames are used up")
        images = np.concatenate([images, source.show(following)])
        frames, shown = (*frames, *following), _words(following)


@dataclass(frozen=True)
class _State:
    """What is known after some frames: correspondence, height, a view made of measurements, share within."""

    seen: Correspondence
    height: HeightMap
    view: View
    lever: Lever
    within: float

    @classmethod
    def of(
        cls, images: NDArray[np.uint8], sequence: Sequence, scene: Scene, lever: Lever, goal: Goal
    ) -> "_State":
        seen = decode(images, sequence)
        height = reconstruct(seen, scene)
        sees = (np.asarray(seen.flags) & _UNSEEN) == 0
        view = _measured_view(seen, sequence, lever)
        within = share_within(height.sigma, height.good, sees, goal.height)
        return cls(seen, height, replace(view, light=np.where(sees, view.light, 0.0)), lever, within)


def _measured_view(seen: Correspondence, sequence: Sequence, lever: Lever) -> View:
    """The full view with the light that was measured: amplitude over what optics leave of the finest fringe.

    Places and footprints are those that were decoded where they stand, those at rest elsewhere.
    """
    base = lever.full
    good = seen.good
    u, v = (np.where(good, mine, rest) for mine, rest in ((seen.u, base.truth.u), (seen.v, base.truth.v)))
    finest = min(frame.period_px or math.inf for frame in sequence.frames if frame.kind == "phase")
    blur = base.scene.pattern.blur_px
    left = np.minimum(*(contrast(finest, base.widths[axis], blur) for axis in "uv"))
    nominal = 2 * base.levels(1.0).half / np.maximum(base.light, 1e-9)
    amplitude = np.asarray(seen.amplitude, np.float64)
    light = 2 * amplitude / np.maximum(left * nominal, 1e-9)
    truth = replace(base.truth, u=u, v=v)
    return replace(base, truth=truth, light=np.where(np.isfinite(light), light, 0.0))


def _first(lever: Lever, noise: float) -> tuple[Frame, ...]:
    """Three steps of a coarse and of a fine fringe on both axes; the fine one the best that is safe at
    rest.
    """
    best, chosen = math.inf, None
    pattern = lever.scene.pattern
    for period in FIRST_PERIODS:
        if period * 2 >= min(pattern.rows, pattern.cols):
            continue
        frames = tuple(
            frame
            for axis, extent in (("u", pattern.cols), ("v", pattern.rows))
            for frame in (*_shifts(axis, SPAN * extent, 0, 3), *_shifts(axis, period, 0, 3))
        )
        there = predict(lever.view, Sequence(frames, pattern.rows, pattern.cols), noise)
        biases = [rms_where(axis.bias, there.usable) for axis in (there.u, there.v)]
        size = math.hypot(lever.quick(there), max(lever.gains) * max(biases))
        if there.failure < SAFE and there.measured_share > 1 - 10 * SAFE and size < best:
            best, chosen = size, frames
        fallback = frames
    return chosen or fallback


def _shifts(axis: str, period: float, shown: int, count: int) -> tuple[Frame, ...]:
    """The next `count` shifts of a period: thirds of a turn, then those half way between, and so on."""
    return tuple(Frame("phase", axis, period_px=period, shift=_shift(k)) for k in range(shown, shown + count))


def _shift(k: int) -> float:
    """Thirds, each set of three turned by the next number of van der Corput's sequence (of a third)."""
    turn, fraction, rest = 0.0, 0.5, k // 3
    while rest:
        turn, fraction, rest = turn + fraction * (rest & 1), fraction / 2, rest >> 1
    return 2 * math.pi * (k % 3 + turn) / 3


def _best(state: _State, frames: tuple[Frame, ...], goal: Goal, noise: float) -> tuple[Frame, ...] | None:
    """The next frames: largest gain of the predicted share per frame; None if nothing gains."""
    now, there = _outlook(state, frames, goal, noise, None)
    gains = []
    for following in _options(frames, state):
        then, _ = _outlook(state, (*frames, *following), goal, noise, there)
        gains.append(((then - now) / len(following), following))
    gain, following = max(gains, key=lambda pair: pair[0])
    return following if gain > LEAST_GAIN else None


def _options(frames: tuple[Frame, ...], state: _State) -> list[tuple[Frame, ...]]:
    """One or three more shifts of a period that was shown; three of one between the coarsest and the
    finest.
    """
    options = []
    for axis in "uv":
        counts: dict[float, int] = {}
        for frame in frames:
            if frame.axis == axis:
                counts[frame.period_px or 1.0] = counts.get(frame.period_px or 1.0, 0) + 1
        for period, count in counts.items():
            options += [_shifts(axis, period, count, more) for more in (1, 3)]
        ladder = sorted(counts)
        for fine, coarse in itertools.pairwise(ladder):
            if coarse > 3 * fine:
                options.append(_shifts(axis, math.sqrt(fine * coarse), 0, 3))
    return options


def _outlook(
    state: _State, frames: tuple[Frame, ...], goal: Goal, noise: float, now: Prediction | None
) -> tuple[float, Prediction]:
    """(share predicted to be within the goal with these frames, the prediction); now: of what was shown."""
    pattern = state.lever.scene.pattern
    there = predict(state.view, Sequence(frames, pattern.rows, pattern.cols), noise)
    before = there if now is None else now
    good = state.height.good
    sizes = [
        state.lever.gains[0] * rms_where(p.u.noise, good)
        + 1j * state.lever.gains[1] * rms_where(p.v.noise, good)
        for p in (there, before)
    ]
    scale = abs(sizes[0]) / abs(sizes[1]) if abs(sizes[1]) > 0 else 1.0
    known = np.isfinite(state.height.sigma) & good
    middle = float(np.median(state.height.sigma[known])) if known.any() else math.inf
    sigma = scale * np.where(known, state.height.sigma, middle)
    passed = (1 - there.u.refused) * (1 - there.v.refused)
    with np.errstate(divide="ignore", invalid="ignore"):
        each = passed * erf(goal.height / (math.sqrt(2) * sigma))
    seen = state.view.light > 0
    return float(np.nan_to_num(each)[seen].mean()), there


def _words(frames: tuple[Frame, ...]) -> str:
    """Frames in a few words: '3 of 8 px on u, ...'."""
    counts: dict[tuple[str, float], int] = {}
    for frame in frames:
        key = frame.axis or "", frame.period_px or 0.0
        counts[key] = counts.get(key, 0) + 1
    return ", ".join(f"{count} of {period:.4g} px on {axis}" for (axis, period), count in counts.items())
