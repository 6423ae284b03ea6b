"""Adaptive sensing: the next frames follow from what the last ones told, until the height is good enough.

Asked for: a share of the pixels that see the pattern whose height is within a goal. A pixel of sigma s is
within with erf(goal / (sqrt 2 s)), one without a height never. After every frame the decoder, run
on images of what was measured (place, light) as each possible next step would show it, tells what that step
would make of that share; the step that gains most per frame is taken.
"""

import itertools
import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from optolever.decode import Correspondence, Flag, decode
from optolever.errors import InputError
from optolever.patterns import Frame, Sequence
from optolever.projector import light_of
from optolever.reconstruct import HeightMap, reconstruct
from optolever.scene import Scene, dent

from .candidates import LEAST_STEPS, SPAN
from .fixed_search import fringe_codes, offers
from .on_demand import OnDemand
from .outlook import Outlook
from .prediction import BORDER, Prediction, predict
from .sensitivity import Lever
from .view import Floats, View, stride_for, thinned

__all__ = ["Adapted", "Goal", "Start", "Step", "adapt", "share_within", "starting"]

_UNSEEN = int(Flag.DARK | Flag.OFF_PATTERN | Flag.INVALID)
#: Finer periods that are tried next, as shares of the finest shown, and the finest of all.
FINER, FINEST = (0.6, 0.8), 3.0
#: Pixels along the shorter side of the camera by which the next frames are weighed up.
SIDE = 60
#: Gain of the share per frame under which nothing more is to be had.
LEAST_GAIN = 1e-5
#: Noise that the first frames are weighed up for, over the camera's.
SPARE = 1.5


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


def share_within(
    sigma: Floats,
    measured: NDArray[np.bool_],
    seen: NDArray[np.bool_],
    goal: float,
    bias: Floats | float = 0.0,
) -> float:
    """Expected share of the `seen` pixels that are measured and within the goal; bias: known errors."""
    with np.errstate(divide="ignore", invalid="ignore"):
        above, below = ((goal + sign * bias) / (math.sqrt(2) * sigma) for sign in (1, -1))
        each = np.where(measured, 0.5 * (erf(above) + erf(below)), 0.0)
    return float(np.nan_to_num(each)[seen].mean()) if seen.any() else 0.0


@dataclass(frozen=True)
class Start:
    """What is known before a dent is measured: the scene at rest, noise (rms of the camera, 8-bit levels),
    and the frames that are shown first."""

    scene: Scene
    lever: Lever
    noise: float
    frames: tuple[Frame, ...]


def starting(scene: Scene, noise: float, goal: Goal) -> Start:
    """The start of every adaptive measurement of a scene: the fewest frames that are predicted to meet the
    goal on the mirror at rest, of those the ones that stand most noise (dents cost contrast); if none are,
    two periods on each axis. InputError if the scene sees no pattern or the goal is none.
    """
    if not (goal.height > 0 and 0 < goal.share < 1):
        raise InputError(f"goal: {goal.height:g} mm at {goal.share:g} of the pixels, must be > 0 and in 0..1")
    rest = dent("flat", scene)
    lever = Lever(scene, rest)
    thin = Lever(scene, rest, stride=stride_for(scene, SIDE))
    outlook, worse = (
        Outlook.of(thin, goal.height, spare * noise, lever.sigma_factor) for spare in (1.0, SPARE)
    )
    found = _least(outlook)
    for offer in offers([outlook], goal.share, goal.frames):
        shown = [candidate.sequence for _, candidate in offer.best if _fringes_only(candidate.sequence)]
        if shown:
            found = max(shown, key=worse.share).frames
            break
    return Start(scene, lever, noise, found)


def _least(outlook: Outlook) -> tuple[Frame, ...]:
    """Three steps of two periods on each axis, of those that lose fewest pixels at rest the least error."""
    view = outlook.view
    frames: list[Frame] = []
    for axis in "uv":
        codes = fringe_codes(axis, view.extent(axis), 2 * LEAST_STEPS)
        predicted = [
            outlook.axis(axis, Sequence(code.frames, view.extent("v"), view.extent("u"))) for code in codes
        ]
        best = min(range(len(codes)), key=lambda k: (round(-predicted[k].share, 2), predicted[k].error))
        frames += codes[best].frames
    return tuple(frames)


def _fringes_only(sequence: Sequence) -> bool:
    return all(frame.kind == "phase" for frame in sequence.frames)


def adapt(source: OnDemand, start: Start, goal: Goal) -> Adapted:
    """Measure until the goal is met where it can be met."""
    scene, frames = start.scene, start.frames
    images = source.show(frames)
    steps: list[Step] = []
    shown = f"start: {_words(frames)}"
    while True:
        sequence = Sequence(frames, scene.pattern.rows, scene.pattern.cols, "adaptive")
        state = _State.of(images, sequence, start, goal)
        steps.append(Step(shown, len(frames), state.within))
        if state.within >= goal.share:
            return Adapted(sequence, state.decoded, state.height, steps, True, "")
        following = _best(state, frames, goal, start.noise)
        if following is None:
            why = "no further frame helps: the goal cannot be met on so many pixels"
            return Adapted(sequence, state.decoded, state.height, steps, False, why)
        if len(frames) + len(following) > goal.frames:
            return Adapted(sequence, state.decoded, state.height, steps, False, "the frames are used up")
        images = np.concatenate([images, source.show(following)])
        frames, shown = (*frames, *following), _words(following)


@dataclass(frozen=True)
class _State:
    """What is known after some frames: correspondence, height, share within; a thinned view made of
    measurements, and there the height's sigma (where there is none the usual one); gains: see Lever."""

    decoded: Correspondence
    height: HeightMap
    within: float
    view: View
    sigma: Floats
    gains: tuple[float, float]

    @classmethod
    def of(cls, images: NDArray[Any], sequence: Sequence, start: Start, goal: Goal) -> "_State":
        scene, lever = start.scene, start.lever
        decoded = decode(images, sequence)
        height = reconstruct(decoded, scene)
        view = _measured_view(decoded, images, sequence, lever)
        sees = view.visible & (view.lost < BORDER)
        bias = _systematic(decoded, predict(view, sequence, start.noise, pairs=2), height, scene)
        within = share_within(height.sigma * lever.sigma_factor, height.good, sees, goal.height, bias)
        step = max(1, min(sees.shape) // SIDE)
        thin = (slice(step // 2, None, step),) * 2
        good, sigma = (values[thin] for values in (height.good, height.sigma * lever.sigma_factor))
        usual = float(np.median(sigma[good])) if good.any() else math.inf
        every = _every(view, step)
        return cls(decoded, height, within, every, np.where(good, sigma, usual), lever.gains)


def _systematic(decoded: Correspondence, prediction: Prediction, height: HeightMap, scene: Scene) -> Floats:
    """Height error (mm, NaN without a height) from systematic errors of the decoder.

    Run on images of what was measured, it errs as it did on those of the mirror. Of its mean error that part
    counts which both pairs of draws have in common.
    """
    first, second = (
        np.where(prediction.passed == 1, prediction.error[k : k + 2].mean(axis=0), 0.0) for k in (0, 2)
    )
    mean = 0.5 * (first + second)
    size = float(np.mean(mean**2))
    if size == 0:
        return np.zeros(height.z.shape)
    bias = mean * float(np.clip(np.mean(first * second) / size, 0.0, 1.0))
    moved = replace(decoded, u=decoded.u + bias[0], v=decoded.v + bias[1])
    return np.asarray(reconstruct(moved, scene, start=height).z - height.z)


def _measured_view(decoded: Correspondence, images: NDArray[Any], sequence: Sequence, lever: Lever) -> View:
    """The whole view with the light that was measured, 0 where nothing is seen: mean level over the one that
    full light would give. Places are those that were decoded where they stand, those at rest elsewhere;
    footprints those at rest."""
    base = lever.full
    u = np.where(decoded.good, decoded.u, base.truth.u)
    v = np.where(decoded.good, decoded.v, base.truth.v)
    sees = ((np.asarray(decoded.flags) & _UNSEEN) == 0) & np.isfinite(u) & np.isfinite(v)
    lit = replace(base.image, u=u.ravel(), v=v.ravel(), light=sees.ravel().astype(np.float64))
    full = light_of(lit, sequence, base.scene.display, base.scene.pattern.blur_px).mean(axis=0)
    sensor, dark = base.sensor, base.sensor.levels(np.zeros(1))
    level = images.mean(axis=0).ravel() * 255 / (2**sensor.bits - 1) - dark
    with np.errstate(divide="ignore", invalid="ignore"):
        light = np.where(sees.ravel(), level / (sensor.levels(full) - dark), 0.0)
    truth = replace(base.truth, u=u, v=v, visible=sees)
    image, centre = (
        replace(lit, light=np.maximum(np.nan_to_num(light), 0.0)),
        np.stack([u.ravel(), v.ravel()]),
    )
    return replace(base, truth=truth, image=image, centre=centre)


def _every(view: View, step: int) -> View:
    """Every step-th pixel of a whole view."""
    if step == 1:
        return view
    thin = (slice(step // 2, None, step),) * 2
    truth = replace(view.truth, **{name: getattr(view.truth, name)[thin] for name in ("u", "v", "visible")})
    return thinned(view, view.scene, truth)


def _shifts(axis: str, period: float, shown: list[float], count: int) -> tuple[Frame, ...]:
    """The next `count` shifts of a period: even ones, or each amid the widest gap of those shown."""
    if not shown:
        return tuple(
            Frame("phase", axis, period_px=period, shift=2 * math.pi * k / count) for k in range(count)
        )
    shifts = sorted(shift % (2 * math.pi) for shift in shown)
    added = []
    for _ in range(count):
        gaps = np.diff([*shifts, shifts[0] + 2 * math.pi])
        widest = int(np.argmax(gaps > gaps.max() - 1e-9))
        added.append((shifts[widest] + 0.5 * float(gaps[widest])) % (2 * math.pi))
        shifts = sorted([*shifts, added[-1]])
    return tuple(Frame("phase", axis, period_px=period, shift=shift) for shift in added)


def _best(state: _State, frames: tuple[Frame, ...], goal: Goal, noise: float) -> tuple[Frame, ...] | None:
    """The next frames: the fewest that are predicted to meet the goal, or if none do, those of the largest
    gain of the share per frame; None if nothing gains."""
    pattern, view = state.view.scene.pattern, state.view
    now = Sequence(frames, pattern.rows, pattern.cols)
    outlook = Outlook(view, view.visible, state.gains, goal.height, noise, state.sigma, 1.0)
    outlook = replace(outlook, error=outlook.height_error(now))
    before = outlook.share(now)
    gains = [
        (outlook.share(replace(now, frames=(*frames, *following))) - before, following)
        for following in _options(frames, state)
    ]
    enough = [one for one in gains if state.within + one[0] >= goal.share]
    if enough:
        return min(enough, key=lambda one: (len(one[1]), -one[0]))[1]
    gain, following = max(gains, key=lambda one: one[0] / len(one[1]))
    return following if gain > LEAST_GAIN * len(following) else None


def _options(frames: tuple[Frame, ...], state: _State) -> list[tuple[Frame, ...]]:
    """One to three more shifts of a period that was shown; three of a finer one, of one that spans the
    surface, or of one between two that lie far apart."""
    options = []
    for axis in "uv":
        shown: dict[float, list[float]] = {}
        for frame in frames:
            if frame.axis == axis:
                shown.setdefault(frame.period_px or 1.0, []).append(frame.shift or 0.0)
        for period, shifts in shown.items():
            options += [_shifts(axis, period, shifts, more) for more in (1, 2, 3)]
        ladder = sorted(shown)
        new = [math.sqrt(fine * coarse) for fine, coarse in itertools.pairwise(ladder) if coarse > 3 * fine]
        new += [share * ladder[0] for share in FINER if share * ladder[0] >= FINEST]
        extent = state.view.extent(axis)
        if ladder[-1] < extent:
            new += [SPAN * extent, math.sqrt(SPAN * extent * ladder[-1])]
        options += [_shifts(axis, period, [], LEAST_STEPS) for period in new]
    return options


def _words(frames: tuple[Frame, ...]) -> str:
    """Frames in a few words: '3 of 8 px on u, ...'."""
    counts: dict[tuple[str, float], int] = {}
    for frame in frames:
        key = frame.axis or "", frame.period_px or 0.0
        counts[key] = counts.get(key, 0) + 1
    return ", ".join(f"{count} of {period:.4g} px on {axis}" for (axis, period), count in counts.items())
