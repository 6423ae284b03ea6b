"""One frame of a crossed fringe against one of the mirror at rest: the displacement of every pixel.

Both frames are fitted by the model of picture.py, in cells of one pixel, with equally many steps. A step
reduces what is left of a spatial frequency by the window's gain g, k steps leave (1 - g)^k (van Cittert): the
change in the last step counts as error."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import distance_transform_edt

from optolever.decode import Correspondence, Displacement, Flag
from optolever.errors import InputError
from optolever.patterns import Sequence

from .arrays import Cells, Float, Frame, Mask
from .picture import Carriers, State, fit_step, window_mean
from .prepare import carriers_on
from .unwrap import unwrapped

__all__ = ["PatternMap", "crossed"]

_f4 = np.float32
_STEPS = 6
_HARMONIC, _TWICE = (sum(1 / k for k in range(1, count * _STEPS + 1)) for count in (1, 2))
_GROWTH = math.sqrt(2 * (2 * _HARMONIC - _TWICE))  # of the noise, by the steps
_LARGEST = 2.5  # maximum of the noise within a window, over its rms
_AMPLITUDE = 8.0  # minimum amplitude over its noise: a phase of sigma 1/8 rad
_GLASS = 0.08  # minimum amplitude over the typical one: twice the reflectance of glass
_SETTLED = 0.02  # periods: largest change in the last step
_STEEPEST = 0.3  # periods over a window's rms width: a jump by a period looks like 0.4
_RESOLVED = math.exp(-0.5 * (math.pi / 4) ** 2)  # contrast left by an rms misfit of an eighth of a period
_REMAINS = 0.05  # of what the window smooths of a bent displacement, after the steps, as in stream.py
_TRUNCATED = 0.4  # of what a slope adds to a truncated window's mean
_LEFT = 0.5  # periods, of the share of a window that has left the pattern
_MARGIN = 1.0  # pattern pixels: a camera pixel's footprint may extend beyond the pattern


@runtime_checkable
class PatternMap(Protocol):
    """u and v (H, W), pattern pixels, of camera pixels at rest: a Correspondence, a trace; NaN: unknown."""

    @property
    def u(self) -> NDArray[Any]: ...
    @property
    def v(self) -> NDArray[Any]: ...


@dataclass(frozen=True, slots=True, eq=False)
class _Fitted:
    """A state, the sizes of the last two changes of the displacement (2, 2, H, W), turns, and the noise of a
    pixel, levels; share (H, W): of the window that is lit and on the pattern."""

    state: State
    changes: Cells
    noise: float
    share: Cells


def crossed(
    frame: ArrayLike, rest: ArrayLike, sequence: Sequence, *, prior: PatternMap | None = None
) -> Displacement:
    """Displacement (pattern pixels, deformed minus rest) of one crossed-fringe frame.

    frame, rest: (H, W), or (N, H, W) as the sequence describes them; prior: u and v at rest, to a fraction of
    a period across the fringe's width; default: the surface fills the frame.

    Whole periods follow from continuity within each connected part of pixels with a fringe; its median
    displacement must be within half a period. sigma includes noise and smoothing. Flags: LOW_CONTRAST without
    a fringe; ORDER_DOUBTFUL where the displacement may be a jump by a period, has not converged, loses
    contrast or is not connected to the largest good part; OFF_PATTERN where it leaves the pattern.
    """
    period, now, still = _pair(frame, rest, sequence)
    at_rest = _map_at_rest(prior, sequence, still.shape)
    size = sequence.rows, sequence.cols
    known = _inside(*at_rest, size, _MARGIN)
    clipped = known & (_overexposed(now, period, at_rest) | _overexposed(still, period, at_rest))
    full = float(np.iinfo(now.dtype).max) if now.dtype.kind == "u" else math.inf

    def carriers_of(lit: Mask) -> Carriers:
        return carriers_on(at_rest, lit, size, period, 1, full)

    pilot = carriers_of(known & ~clipped)
    first = fit_step(pilot, still, _dark(still, pilot))[0]
    sees = _with_fringe(first.amplitudes.min(axis=0), pilot)
    carriers = carriers_of(sees)
    before = _fitted(carriers, still, _dark(still, carriers), None)
    after = _fitted(carriers, now, before.state.copy(), before.state)

    turn = after.state.displacement - before.state.displacement
    sigma = np.hypot(*(_noise(carriers, one) for one in (before, after)))
    u, v = (coord + period * one for coord, one in zip(at_rest, turn, strict=True))
    change = _remaining(after.changes - before.changes, sigma, carriers)
    light = after.state.level / np.maximum(before.state.level, _f4(1e-3))
    noise = 2 * math.pi * sigma * np.minimum(before.state.amplitudes, after.state.amplitudes)
    fringe = np.minimum(before.state.amplitudes, after.state.amplitudes)
    lost = (fringe < np.maximum(_AMPLITUDE * noise, _GLASS * before.state.amplitudes)).any(axis=0)
    faded = after.state.amplitudes < _RESOLVED * before.state.amplitudes * light - 3 * noise
    width = _rms_width(carriers.window)
    slope = np.hypot(*np.gradient(np.where(sees, turn, np.nan), axis=(1, 2)))
    edge, slope = np.isnan(slope).any(axis=0), np.nan_to_num(slope)
    steep = _grown(((slope * width > _STEEPEST) | faded).any(axis=0), width / 2) | (edge & sees)
    doubtful = (steep | (change > _SETTLED).any(axis=0)) & ~lost

    finite = np.isfinite(at_rest[0]) & np.isfinite(at_rest[1])
    flags = np.where(finite, 0, int(Flag.INVALID)) | np.where(clipped, int(Flag.SATURATED), 0)
    flags |= np.where((known & ~sees & ~clipped) | (lost & (flags == 0)), int(Flag.LOW_CONTRAST), 0)
    islands = cv2.connectedComponents(sees.astype(np.uint8), connectivity=4)[1]
    flags |= np.where(finite & ~_inside(u, v, size, 0.0), int(Flag.OFF_PATTERN), 0)
    flags |= np.where(doubtful, int(Flag.ORDER_DOUBTFUL), 0)
    loose = ~_largest_parts(flags == 0, islands, 4 * math.pi * width**2)
    flags |= np.where(loose & finite, int(Flag.ORDER_DOUBTFUL), 0)
    gone = window_mean((sees & ~_inside(u, v, size, _MARGIN)).astype(np.float32), carriers.window)
    left = np.where(sees, _smoothed(turn, slope, gone, carriers), 0)
    spread = period * np.hypot(_GROWTH * sigma, np.hypot(change, left))
    amplitude, offset = after.state.amplitudes.min(axis=0), after.state.level
    moved = (period * turn).astype(np.float64)
    return Displacement(moved[0], moved[1], spread[0], spread[1], flags.astype(np.uint16), amplitude, offset)


def _pair(frame: ArrayLike, rest: ArrayLike, sequence: Sequence) -> tuple[float, Frame, Frame]:
    """The fringe's period and both images (H, W)."""
    number = next((i for i, one in enumerate(sequence.frames) if one.kind == "crossed"), None)
    if number is None:
        raise InputError(f"crossed: sequence {sequence.name} has no frame of kind 'crossed'")
    images = []
    for name, stack in (("frame", frame), ("rest", rest)):
        image = np.asarray(stack)
        if image.ndim == 3:
            if len(image) != len(sequence):
                raise InputError(
                    f"crossed: {name} has {len(image)} images, sequence describes {len(sequence)}"
                )
            image = image[number]
        if image.ndim != 2 or min(image.shape) < 16:
            raise InputError(f"crossed: {name} has shape {image.shape}, must be (H, W), at least 16 x 16")
        if not np.isfinite(image).all():
            raise InputError(f"crossed: {name} holds values that are not finite")
        images.append(image)
    now, still = images
    if now.shape != still.shape:
        raise InputError(f"crossed: frame is {now.shape}, rest is {still.shape}, must be equal")
    return float(sequence.frames[number].period_px or 1.0), now, still


def _map_at_rest(prior: PatternMap | None, sequence: Sequence, shape: tuple[int, ...]) -> tuple[Float, Float]:
    """u and v at rest (H, W), NaN where unknown or flagged; without a prior the surface fills the frame."""
    if prior is None:
        row, col = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
        return (col + 0.5) * sequence.cols / shape[1] - 0.5, (row + 0.5) * sequence.rows / shape[0] - 0.5
    u, v = np.asarray(prior.u, np.float64), np.asarray(prior.v, np.float64)
    if u.shape != tuple(shape) or v.shape != tuple(shape):
        raise InputError(f"{sequence.name}: prior is {u.shape}, rest is {tuple(shape)}, must be equal")
    good = prior.good if isinstance(prior, Correspondence) else True
    return np.where(good, u, np.nan), np.where(good, v, np.nan)


def _inside(u: Float, v: Float, size: tuple[int, int], margin: float) -> Mask:
    low, high = margin - 0.5, -margin - 0.5
    rows, cols = size
    return np.asarray((u > low) & (u < cols + high) & (v > low) & (v < rows + high))


def _overexposed(image: Frame, period: float, at_rest: tuple[Float, Float]) -> Mask:
    """Where an integer image is at its maximum over half a period both ways: no fringe is bright that far."""
    if image.dtype.kind not in "ui":
        return np.zeros(image.shape, np.bool_)
    slope = max(float(np.nanmedian(np.hypot(*np.gradient(coord)))) for coord in at_rest)
    size = math.ceil(0.5 * period / max(slope, 1e-3))
    top = (image == np.iinfo(image.dtype).max).astype(np.uint8)
    return np.asarray(cv2.morphologyEx(top, cv2.MORPH_OPEN, np.ones((size, size), np.uint8)) > 0)


def _dark(image: Frame, carriers: Carriers) -> State:
    """The start of a fit: the mean level, no fringe."""
    planes = np.zeros((5, *image.shape), np.float32)
    planes[2] = image[carriers.lit > 0].mean()
    return State(planes)


def _with_fringe(amplitude: Cells, carriers: Carriers) -> Mask:
    """Pixels with a fringe. A border is where the amplitude falls to half of its maximum around; half a width
    along it is left out, as a step of brightness has amplitude, too. The typical amplitude weights pixels by
    its square, so that many faint ones do not count."""
    known, width = carriers.lit > 0, _rms_width(carriers.window)
    lit = np.where(known & (carriers.share > 0.02), amplitude, _f4(0))
    size = 2 * math.ceil(2 * width) + 1
    power = np.square(lit, dtype=np.float64)
    typical = float((power * lit).sum() / max(power.sum(), 1e-9))
    least = np.maximum(0.5 * cv2.dilate(lit, np.ones((size, size), np.uint8)), _GLASS * typical)
    return np.asarray(known & ~_grown(known & (lit < least), width / 2))


def _fitted(carriers: Carriers, image: Frame, state: State, rest: State | None) -> _Fitted:
    """rest: of the frame at rest, for the unwrapping of the first step's displacement."""
    changes = []
    lit = carriers.lit > 0
    for step in range(_STEPS):
        state, fit = fit_step(carriers, image, state)
        changes.append(fit.change)
        if rest is not None and step == 0:
            _unwrap(state, rest, lit & (state.amplitudes.min(axis=0) > 0.2 * rest.amplitudes.min(axis=0)))
    noise = math.sqrt(max(float(np.median(fit.residual[lit])), 1 / 12)) if lit.any() else 1.0
    return _Fitted(state, np.stack(changes[-2:]), noise, fit.share)


def _unwrap(state: State, rest: State, good: Mask) -> None:
    """Unwrap the displacement from rest, each connected part for itself; the other pixels take that of the
    nearest one."""
    offset = np.asarray(state.displacement - rest.displacement)
    count, labels = cv2.connectedComponents(good.astype(np.uint8), connectivity=4)
    reached = np.zeros(good.shape, np.bool_)
    for label in range(1, count):
        part = labels == label
        offset, found = unwrapped(offset, part, part)
        reached |= found
    if not reached.any():
        return
    near = distance_transform_edt(~reached, return_distances=False, return_indices=True)
    state.displacement[:] = rest.displacement + offset[:, near[0], near[1]]


def _noise(carriers: Carriers, fitted: _Fitted) -> Cells:
    """Standard deviation of the displacement after one step (2, H, W), turns."""
    squares = window_mean(carriers.lit, np.square(carriers.window))
    squares = squares / (np.maximum(fitted.share, 0.02) * np.maximum(carriers.share, 0.02))
    amplitudes = np.maximum(fitted.state.amplitudes, _f4(1e-6))
    return np.asarray(fitted.noise * np.sqrt(2 * squares) / amplitudes / (2 * math.pi), np.float32)


def _remaining(changes: Cells, sigma: Cells, carriers: Carriers) -> Cells:
    """Sum of all further changes (2, H, W), turns: a geometric series. Step i changes 1 / sqrt(i (2 i - 1))
    of the noise."""
    width = _rms_width(carriers.window)
    size = np.ones((2 * math.ceil(width) + 1,) * 2, np.uint8)
    around = np.empty_like(changes)
    for i, step in enumerate((_STEPS - 1, _STEPS)):
        for axis in range(2):
            largest = cv2.dilate(np.where(carriers.lit > 0, np.abs(changes[i, axis]), _f4(0)), size)
            smooth = cv2.GaussianBlur(largest, (0, 0), width)  # as solvers weight by sigma
            noise = np.square(_LARGEST * sigma[axis]) / (step * (2 * step - 1))
            around[i, axis] = np.sqrt(np.maximum(np.square(smooth) - noise, 0))
    ratio = np.minimum(around[1] / np.maximum(around[0], 1e-9), 0.9)
    return np.asarray(around[1] * np.maximum(1.0, ratio / (1 - ratio)))


def _smoothed(turn: Cells, slope: Cells, lost: Cells, carriers: Carriers) -> Cells:
    """What remains of the window's smoothing of a displacement (2, H, W), turns; lost (H, W): share of the
    window that has left the pattern."""
    bends = [
        sum(np.abs(cv2.Sobel(one, cv2.CV_32F, *order, ksize=1)) for order in ((2, 0), (0, 2))) for one in turn
    ]
    width = _rms_width(carriers.window)
    border = _TRUNCATED * width * (1 - carriers.share) * slope + _LEFT * lost
    return np.asarray(_REMAINS * width**2 / 2 * np.stack(bends) + border)


def _rms_width(window: Cells) -> float:
    place = np.arange(window.size) - window.size // 2
    return float(np.sqrt(np.square(place) @ window / window.sum()))


def _grown(mask: Mask, reach: float) -> Mask:
    size = 2 * math.ceil(reach) + 1
    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((size, size), np.uint8)) > 0)


def _largest_parts(good: Mask, islands: NDArray[Any], least: float) -> Mask:
    """Of every island the largest connected part of good pixels, if it has `least` pixels."""
    parts = cv2.connectedComponents(good.astype(np.uint8), connectivity=4)[1]
    kept = np.zeros(good.shape, np.bool_)
    for island in range(1, int(islands.max()) + 1):
        sizes = np.bincount(parts[good & (islands == island)])
        if sizes.size and sizes.max() >= least:
            kept |= parts == sizes.argmax()
    return kept
