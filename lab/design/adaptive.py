"""Adaptive sensing: the next frames follow from what the last ones told, until the height is good enough.

Asked for: a share of the pixels that see the pattern whose height is within a goal. A pixel of sigma s is
within with erf(goal / (sqrt 2 s)), one without a height never. After every frame the decoder, run on images
of what was measured (place, light) as each possible next step would show it, tells what that step would make
of that share; the step that gains most per frame is taken.
"""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from optolever.decode import Correspondence, Flag, decode
from optolever.errors import InputError
from optolever.experiments.arrays import Floats, Mask
from optolever.experiments.design import Lever, candidates, predict
from optolever.experiments.design.candidates import LEAST_STEPS, SPAN
from optolever.experiments.design.view import Prediction, View, stride_for, thinned
from optolever.patterns import Frame, Sequence
from optolever.projector import Footprints, light_of
from optolever.reconstruct import HeightMap, reconstruct
from optolever.scene import Scene, dent, mean_beside, movement

_UNSEEN = int(Flag.DARK | Flag.OFF_PATTERN | Flag.INVALID)
#: Finer periods that are tried next, as shares of the finest shown, and the finest of all.
FINER, FINEST = (0.6, 0.8), 3.0
#: Noise that the first frames are chosen for, over the camera's: dents cost contrast.
SPARE = 1.5
#: Pixels along the shorter side of the camera by which frames are weighed up.
SIDE = 60
#: Pixels (rms) over which places are averaged for images of what was measured.
SMOOTHED = 1.0


#: Shows frames that nobody knew before, and brings their images (n, H, W), in their order.
Show = Callable[[tuple[Frame, ...]], NDArray[Any]]


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


@dataclass(frozen=True)
class Start:
    """What is known before a dent is measured: the scene at rest, noise (rms of the camera, 8-bit levels),
    and the frames that are shown first."""

    scene: Scene
    lever: Lever
    noise: float
    frames: tuple[Frame, ...]


def starting(scene: Scene, noise: float, goal: Goal) -> Start:
    """The start of every adaptive measurement of a scene: two fringe periods on each axis in the fewest
    steps, of those the ones that bring most pixels of the mirror at rest within the goal. InputError if the
    scene sees no pattern or the goal is none.
    """
    if not (goal.height > 0 and 0 < goal.share < 1):
        raise InputError(f"goal: {goal.height:g} mm at {goal.share:g} of the pixels, must be > 0 and in 0..1")
    lever = Lever(scene, dent("flat", scene), stride=stride_for(scene, SIDE))
    shown = [one.sequence for one in candidates(scene.pattern.rows, scene.pattern.cols, 4 * LEAST_STEPS)]
    fringes = [one for one in shown if all(frame.kind == "phase" for frame in one.frames)]
    if not fringes:
        raise InputError(f"scene {scene.name!r}: its pattern is too small for two fringe periods")
    best = max(
        fringes, key=lambda one: expected_share(lever.view, lever.unit_sigma, one, SPARE * noise, goal)
    )
    return Start(scene, lever, noise, best.frames)


def adapt(show: Show, start: Start, goal: Goal) -> Adapted:
    """Measure until the goal is met where it can be met."""
    scene, frames = start.scene, start.frames
    images = show(frames)
    steps: list[Step] = []
    shown = f"start: {_words(frames)}"
    while True:
        sequence = Sequence(frames, scene.pattern.rows, scene.pattern.cols, "adaptive")
        decoded = decode(images, sequence)
        height = reconstruct(decoded, scene)
        whole = _measured_view(decoded, images, sequence, start.lever.full)
        bias = _systematic(decoded, predict(whole, sequence, start.noise, pairs=2), height, scene)
        within = share_within(height.sigma, height.good, whole.usable, goal.height, bias)
        steps.append(Step(shown, len(frames), within))
        if within >= goal.share:
            return Adapted(sequence, decoded, height, steps, True, "")
        view, sigma = _thin(whole, start.lever.view, height.sigma)
        following = _best(view, sigma, sequence, within, start.noise, goal)
        if following is None:
            why = "no further frame helps: the goal cannot be met on so many pixels"
            return Adapted(sequence, decoded, height, steps, False, why)
        if len(frames) + len(following) > goal.frames:
            return Adapted(sequence, decoded, height, steps, False, "the frames are used up")
        images = np.concatenate([images, show(following)])
        frames, shown = (*frames, *following), _words(following)


def _systematic(decoded: Correspondence, drawn: Prediction, height: HeightMap, scene: Scene) -> Floats:
    """Height error (mm, NaN without a height) from systematic errors of the decoder.

    Run on images of what was measured, it errs as it did on those of the mirror. Of its mean error that part
    counts which both pairs of draws have in common.
    """
    known = np.where(drawn.good.all(axis=0), drawn.error, 0.0)
    first, second = known[:2].mean(axis=0), known[2:].mean(axis=0)
    mean = 0.5 * (first + second)
    common = float(np.clip(np.sum(first * second) / max(float(np.sum(mean**2)), 1e-300), 0.0, 1.0))
    moved = replace(decoded, u=decoded.u + common * mean[0], v=decoded.v + common * mean[1])
    return np.asarray(reconstruct(moved, scene, start=height).z - height.z)


def share_within(sigma: Floats, measured: Mask, seen: Mask, goal: float, bias: Floats | float = 0.0) -> float:
    """Expected share of the `seen` pixels that are measured and within the goal; bias: known errors."""
    with np.errstate(divide="ignore", invalid="ignore"):
        above, below = ((goal + sign * bias) / (math.sqrt(2) * sigma) for sign in (1, -1))
        each = np.where(measured, 0.5 * (erf(above) + erf(below)), 0.0)
    return float(np.nan_to_num(each)[seen].mean()) if seen.any() else 0.0


def expected_share(view: View, unit: Floats, sequence: Sequence, noise: float, goal: Goal) -> float:
    """Share of a view's usable pixels whose height is expected within the goal; unit: rms errors of the
    height (mm) where those of the decoder are one cell, with which they grow."""
    try:
        drawn = predict(view, sequence, noise)
    except InputError:
        return 0.0
    return share_within(drawn.rms * unit, drawn.good[0], view.usable, goal.height)


def _measured_view(decoded: Correspondence, images: NDArray[Any], sequence: Sequence, base: View) -> View:
    """The whole view with the light that was measured, 0 where nothing is seen: mean level over the one that
    full light would give. Places of pixels' centres are those that were decoded, those of `base` far from
    any; what a pixel sees of the map and of the light beside follows from its neighbours'."""
    u, v = (_smooth(decoded, base, axis) for axis in "uv")
    sees = ((np.asarray(decoded.flags) & _UNSEEN) == 0) & np.isfinite(u) & np.isfinite(v)
    lit = replace(base.image, u=u.ravel(), v=v.ravel(), light=sees.ravel().astype(np.float64))
    full = light_of(lit, sequence, base.scene.display, base.scene.pattern.blur_px).mean(axis=0)
    sensor, dark = base.sensor, base.sensor.levels(np.zeros(1))
    level = images.mean(axis=0).ravel() * 255 / (2**sensor.bits - 1) - dark
    with np.errstate(divide="ignore", invalid="ignore"):
        light = np.where(sees.ravel(), level / (sensor.levels(full) - dark), 0.0)
    light = np.maximum(np.nan_to_num(light), 0.0)
    (mean_u, boxes_u), (mean_v, boxes_v) = (_footprint(at, light.reshape(at.shape)) for at in (u, v))
    image = Footprints(mean_u, mean_v, light, boxes_u, boxes_v)
    truth = replace(base.truth, u=u, v=v, visible=sees)
    return replace(base, truth=truth, image=image, centre=np.stack([u.ravel(), v.ravel()]))


def _smooth(decoded: Correspondence, base: View, axis: str) -> Floats:
    """Decoded places (H, W), their way from those of `base` weighed over SMOOTHED: noise from pixel to pixel
    is no shape, and a rough map is decoded otherwise."""
    rest, good = getattr(base.truth, axis), decoded.good
    weight = np.where(good, 1 / np.square(getattr(decoded, f"sigma_{axis}"), dtype=np.float64), 0.0)
    moved = np.where(good, getattr(decoded, axis) - rest, 0.0)
    sums = (cv2.GaussianBlur(part, (0, 0), SMOOTHED) for part in (weight * moved, weight))
    return np.asarray(rest + next(sums) / np.maximum(next(sums), 1e-12))


def _footprint(at: Floats, light: Floats) -> tuple[Floats, Floats]:
    """Of a map (H, W) of pixels' centres: its means (P,) over their light, and how far it moves (P, 2) along
    their columns and rows; both lines between neighbours."""
    ends = [(_edges(at, axis), _edges(light, axis)) for axis in (1, 0)]
    mean = at + sum(mean_beside(*each) for each in ends)
    return mean.ravel(), np.column_stack([movement(*each).ravel() for each, _ in ends])


def _edges(values: Floats, axis: int) -> tuple[Floats, Floats, Floats]:
    """Of pixels (H, W) along an axis: at one edge, in the middle, at the other edge."""
    wider = np.pad(values, [(int(k == axis),) * 2 for k in (0, 1)], mode="reflect", reflect_type="odd")
    between = np.delete(wider, -1, axis) + 0.5 * np.diff(wider, axis=axis)
    return np.delete(between, -1, axis), values, np.delete(between, 0, axis)


def _thin(whole: View, like: View, sigma: Floats) -> tuple[View, Floats]:
    """A whole view and error bars of its heights, thinned like another view of the same camera."""
    if like.stride == 1:
        return whole, sigma
    size = like.truth.u.shape[::-1]
    u, v, visible, bars = (
        np.asarray(cv2.resize(values.astype(np.float64), size, interpolation=cv2.INTER_LINEAR), np.float64)
        for values in (whole.truth.u, whole.truth.v, whole.truth.visible, sigma)
    )
    return thinned(whole, like.scene, replace(like.truth, u=u, v=v, visible=visible == 1)), bars


def _best(
    view: View, sigma: Floats, now: Sequence, within: float, noise: float, goal: Goal
) -> tuple[Frame, ...] | None:
    """The next frames: the fewest that are predicted to meet the goal, or if none do, those of the largest
    gain of the share per frame; None if nothing gains. sigma: error bars of the height (mm) by now."""
    unit = np.where(np.isfinite(sigma), sigma, np.nanmedian(sigma)) / predict(view, now, noise).rms

    def share(following: tuple[Frame, ...]) -> float:
        return expected_share(view, unit, replace(now, frames=(*now.frames, *following)), noise, goal)

    before = share(())
    gains = [(share(following) - before, following) for following in _options(now)]
    enough = [one for one in gains if within + one[0] >= goal.share]
    if enough:
        return min(enough, key=lambda one: (len(one[1]), -one[0]))[1]
    gain, following = max(gains, key=lambda one: one[0] / len(one[1]))
    return following if gain > 0 else None


def _options(now: Sequence) -> list[tuple[Frame, ...]]:
    """One to three more shifts of a period that was shown; three of a finer one, of one that spans the
    surface, or of one between two that lie far apart."""
    options = []
    for axis, extent in (("u", now.cols), ("v", now.rows)):
        shown: dict[float, list[float]] = {}
        for frame in now.frames:
            if frame.axis == axis:
                shown.setdefault(frame.period_px or 1.0, []).append(frame.shift or 0.0)
        for period, shifts in shown.items():
            options += [_shifts(axis, period, shifts, more) for more in (1, 2, 3)]
        ladder = sorted(shown)
        new = [math.sqrt(fine * coarse) for fine, coarse in itertools.pairwise(ladder) if coarse > 3 * fine]
        new += [share * ladder[0] for share in FINER if share * ladder[0] >= FINEST]
        if ladder[-1] < extent:
            new += [SPAN * extent, math.sqrt(SPAN * extent * ladder[-1])]
        options += [_shifts(axis, period, [], LEAST_STEPS) for period in new]
    return options


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


def _words(frames: tuple[Frame, ...]) -> str:
    """Frames in a few words: '3 of 8 px on u, ...'."""
    counts: dict[tuple[str, float], int] = {}
    for frame in frames:
        key = frame.axis or "", frame.period_px or 0.0
        counts[key] = counts.get(key, 0) + 1
    return ", ".join(f"{count} of {period:.4g} px on {axis}" for (axis, period), count in counts.items())
