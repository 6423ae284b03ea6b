"""Single-shot crossed fringe: displacement of one frame against the rest frame, for moving mirrors.

The frame is the mean of a fringe along u and one along v. Both are fitted at once within a Gaussian window
(window_fit.py) over the carriers that the map at rest predicts (the local-carrier form of Takeda, Ina,
Kobayashi 1982, doi:10.1364/JOSA.72.000156). The phase of the deformed frame over that of the rest frame,
unwrapped, is the displacement.

The window smooths: the first pass reduces a spatial frequency by its gain g. The next pass adds the phase of
the last one to its carrier and fits the remainder, which gives 1 - (1 - g)^k after k passes (van Cittert);
the change in the last pass counts as error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import distance_transform_edt

from optolever.decode import Displacement, Flag
from optolever.patterns import Sequence

from .prior import PatternMap, frame_pair, noise_of, overexposed, prior_map, seeing, window_width
from .window_fit import Fit, Window

__all__ = ["crossed", "displaced"]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]
#: Half amplitude over its noise below which a pixel is flagged: a phase of sigma 1/6 rad.
_LEAST = 6.0
_PASSES = 4
#: Factor of the passes on the noise: squared 2 (2 H(k) - H(2 k)), H(k) = 1 + 1/2 + ... + 1/k.
_GROWTH = math.sqrt(
    4 * sum(1 / k for k in range(1, _PASSES + 1)) - 2 * sum(1 / k for k in range(1, 2 * _PASSES + 1))
)
#: Maximum of the noise within a window's width, over its rms.
_LARGEST = 2.5
#: Change in the last pass, cycles, above which a pixel is flagged: a tenth of the 0.2 of half a jump.
_SETTLED = 0.02
#: Cycles over a window's rms width above which a pixel is flagged: a jump of one cycle looks like
#: 1 / sqrt(2 pi) = 0.4.
_STEEPEST = 0.3
#: Contrast over that at rest below which a pixel is flagged: exp(-phi^2 / 2) at an rms misfit phi of an
#: eighth of a cycle within the window.
_RESOLVED = math.exp(-0.5 * (math.pi / 4) ** 2)
#: Margin inside the pattern's outline, pattern pixels: a camera pixel's footprint may extend beyond it.
_MARGIN = 1.0


def crossed(
    frame: ArrayLike, rest: ArrayLike, sequence: Sequence, *, prior: PatternMap | None = None
) -> Displacement:
    """Displacement (pattern pixels, deformed minus rest) of one crossed-fringe frame.

    frame, rest  (H, W), or (N, H, W) as the sequence describes them
    prior        u and v at rest, to a fraction of a period across the fringe's width (a trace, a decoded
                 capture); default: the surface fills the frame

    Whole periods follow from continuity within each island, a connected part of pixels with a fringe at rest.
    One frame does not determine them otherwise: the median displacement of every island must be within half a
    period. Pixels without a connection to the largest good part of their island, and islands smaller than a
    window, are flagged. sigma includes noise, smoothing and borders. Flags: LOW_CONTRAST without a fringe, or
    below 8 % of the typical amplitude; ORDER_DOUBTFUL where the displacement may be a slope or a jump by a
    period, has not converged, reduces contrast or lacks a connection; OFF_PATTERN where it leaves the
    pattern.
    """
    fringe, now, still = frame_pair(frame, rest, sequence, "crossed")
    at_rest = prior_map(prior, sequence, still.shape)
    return displaced(now, still, at_rest, (sequence.rows, sequence.cols), fringe.period_px or 1.0)


def displaced(
    now: NDArray[Any],
    still: NDArray[Any],
    at_rest: tuple[F64, F64],
    pattern: tuple[int, int],
    period: float,
    settled: float = _SETTLED,
) -> Displacement:
    """Displacement between frames (H, W) of fringes, or lines, along u and v of a pattern (rows, cols).

    at_rest: u and v (H, W) of the frame at rest; settled: largest change in the last pass, cycles, of an
    unflagged pixel.
    """
    pair = _pair(now, still, at_rest, pattern, period)
    axes, level = _passes(pair)
    flags = _flags(pair, axes, settled)
    u, v = (period * axis.turn for axis in axes)
    sigma_u, sigma_v = (period * np.hypot(axis.random, axis.change) for axis in axes)
    amplitude = 2.0 * np.minimum(axes[0].height, axes[1].height)
    return Displacement(u, v, sigma_u, sigma_v, flags, amplitude, level.astype(np.float64))


@dataclass(frozen=True, slots=True)
class _Pair:
    """Both frames, their map at rest on a pattern (rows, cols), and the pixels with a fringe (H, W).

    noise: of a half amplitude within a window of rms `width`, of both frames, camera levels
    """

    now: F32
    still: F32
    at_rest: tuple[F64, F64]
    pattern: tuple[int, int]
    period: float
    width: float
    noise: tuple[float, float]
    clipped: Mask
    sees: Mask

    def inside(self, turns: list[F64] | None, margin: float) -> Mask:
        """Pixels whose place is farther than margin (pattern pixels) inside the pattern; None: at rest."""
        u, v = self.at_rest
        if turns is not None:
            u, v = (coord + self.period * turn for coord, turn in zip((u, v), turns, strict=True))
        return _inside(u, v, self.pattern, margin)


@dataclass(frozen=True, slots=True)
class _Axis:
    """Along one axis, (H, W): displacement, its noise, its change in the last pass (cycles); half amplitude;
    whether the fringe within the window deviates from its local line.
    """

    turn: F64
    random: F64
    change: F64
    height: F64
    unresolved: Mask


def _pair(
    now: NDArray[Any], still: NDArray[Any], at_rest: tuple[F64, F64], pattern: tuple[int, int], period: float
) -> _Pair:
    """Window, noise and pixels with a fringe, from the frame at rest."""
    images = now.astype(np.float32), still.astype(np.float32)
    known = _inside(*at_rest, pattern, _MARGIN)
    width = window_width(at_rest, known, period)
    clipped = overexposed(now, width) | overexposed(still, width)
    known &= ~clipped
    pilot = Window.over(known, width).fit(images[1], _carriers(at_rest, known, period), cut=False)
    sees = seeing(np.minimum(*pilot.height), known, width)
    width = window_width(at_rest, sees, period)
    # for white noise the window gives sigma / (2 sqrt(pi) width), 1 / sqrt(2) of it in each quadrature
    gain = 1 / (2 * math.sqrt(2 * math.pi) * width)
    noise = gain * noise_of(images[0], sees), gain * noise_of(images[1], sees)
    return _Pair(*images, at_rest, pattern, period, width, noise, clipped, sees)


def _passes(pair: _Pair) -> tuple[list[_Axis], F32]:
    """Displacement along u and v, and the mean level of the deformed frame."""
    window = Window.over(pair.sees, pair.width)
    carrier = _carriers(pair.at_rest, pair.sees, pair.period)
    before, after = (window.fit(image, carrier, cut=False) for image in (pair.still, pair.now))
    rested, pressed = _added(carrier, before), []
    for k in (0, 1):
        clear = pair.sees & _clear(pair, before, after, k)
        turn = _unwrapped(np.asarray(after.phase[k] - before.phase[k], np.float64) / (2 * np.pi), clear)
        pressed.append(rested[k] + 2 * np.pi * window.extended(turn))
    changes = []
    for _ in range(_PASSES - 1):
        lit = pair.sees & pair.inside(_turns(rested, pressed), _MARGIN)
        before = window.fit(pair.still, rested)
        after = Window.over(lit, pair.width).fit(pair.now, pressed)
        rested, pressed = _added(rested, before), _added(pressed, after)
        changes.append([_around(after.phase[k] - before.phase[k], pair) for k in (0, 1)])
    turns = _turns(rested, pressed)
    return [_axis(pair, before, after, k, turns[k], changes) for k in (0, 1)], after.level


def _axis(pair: _Pair, before: Fit, after: Fit, k: int, turn: F64, changes: list[list[F64]]) -> _Axis:
    height = np.asarray(np.minimum(before.height[k], after.height[k]), np.float64)
    # noise after one pass; pass i changes 1 / sqrt(i (2 i - 1)) of it
    noise = np.hypot(pair.noise[0] * after.growth[k], pair.noise[1] * before.growth[k])
    random = noise / np.maximum(height, 1e-9) / (2 * np.pi)
    last, change = (
        np.sqrt(np.maximum(changes[i - 2][k] ** 2 - (_LARGEST * random) ** 2 / (i * (2 * i - 1)), 0))
        for i in (_PASSES, _PASSES - 1)
    )
    # the sum of further changes, at least the last one: a geometric series
    ratio = np.minimum(last / np.maximum(change, 1e-9), 0.9)
    # a mirror that loses light reduces level and amplitude, a jump within a window the amplitude alone
    expected = before.height[k] * after.level / np.maximum(before.level, 1e-3)
    unresolved = after.height[k] < _RESOLVED * expected - 3 * max(pair.noise)
    return _Axis(
        turn, _GROWTH * random, last * np.maximum(1.0, ratio / (1.0 - ratio)), height, np.asarray(unresolved)
    )


def _flags(pair: _Pair, axes: list[_Axis], settled: float) -> NDArray[np.uint16]:
    """Flags of every pixel, first from its fit, then from its connection."""
    known = np.isfinite(pair.at_rest[0]) & np.isfinite(pair.at_rest[1])
    blind = pair.inside(None, _MARGIN) & ~pair.sees & ~pair.clipped
    beside = known & ~pair.inside([axis.turn for axis in axes], 0.0)
    flags = np.where(known, 0, int(Flag.INVALID)) | np.where(pair.clipped, int(Flag.SATURATED), 0)
    flags |= np.where(blind, int(Flag.LOW_CONTRAST), 0)
    islands = _islands_of(flags == 0)
    flags |= np.where(beside, int(Flag.OFF_PATTERN), 0)
    for axis in axes:
        lost = axis.height <= _LEAST * max(pair.noise)
        doubtful = (_steep(axis, pair) | (axis.change > settled)) & ~lost
        flags |= np.where(lost, int(Flag.LOW_CONTRAST), 0) | np.where(doubtful, int(Flag.ORDER_DOUBTFUL), 0)
    # area of the number of pixels that a window's weights are equivalent to
    connected = _largest_parts(flags == 0, islands, 4 * math.pi * pair.width**2)
    return (flags | np.where(connected, 0, int(Flag.ORDER_DOUBTFUL))).astype(np.uint16)


def _inside(u: F64, v: F64, pattern: tuple[int, int], margin: float) -> Mask:
    low, high = margin - 0.5, -margin - 0.5
    rows, cols = pattern
    return np.asarray((u > low) & (u < cols + high) & (v > low) & (v < rows + high))


def _carriers(at_rest: tuple[F64, F64], known: Mask, period: float) -> list[F64]:
    return [2 * np.pi / period * np.where(known, coord, 0.0) for coord in at_rest]


def _added(phases: list[F64], fit: Fit) -> list[F64]:
    return [phase + more for phase, more in zip(phases, fit.phase, strict=True)]


def _turns(rested: list[F64], pressed: list[F64]) -> list[F64]:
    return [(after - before) / (2 * np.pi) for before, after in zip(rested, pressed, strict=True)]


def _clear(pair: _Pair, before: Fit, after: Fit, k: int) -> Mask:
    return np.asarray(np.minimum(before.height[k], after.height[k]) > _LEAST * max(pair.noise))


def _around(change: F32, pair: _Pair) -> F64:
    """Largest change within a window's width, cycles, smoothed, because solvers weight by sigma."""
    size = 2 * math.ceil(pair.width) + 1
    own = np.where(pair.sees, np.abs(change) / np.float32(2 * np.pi), np.float32(0))
    largest = cv2.dilate(own, np.ones((size, size), np.uint8))
    return np.asarray(cv2.GaussianBlur(largest, (0, 0), pair.width), np.float64)


def _steep(axis: _Axis, pair: _Pair) -> Mask:
    """True where a window, or a neighbour's, does not distinguish a slope from a jump by a cycle."""
    slope = np.hypot(*np.gradient(np.where(pair.sees, axis.turn, np.nan)))
    steep = (slope * pair.width > _STEEPEST) | axis.unresolved
    size = 2 * math.ceil(pair.width / 2) + 1
    return np.asarray(cv2.dilate(steep.astype(np.uint8), np.ones((size, size), np.uint8)) > 0)


def _unwrapped(cycles: F64, usable: Mask) -> F64:
    """A phase (H, W) without jumps; the median of every connected usable part is within half a cycle of 0.

    Usable pixels by reliability (H. Lei et al., Optik 126, 1640, 2015), so that steep ones are crossed last;
    the others follow the nearest of these.
    """
    wrapped = cycles - np.rint(cycles)
    options = cv2.phase_unwrapping_HistogramPhaseUnwrapping_Params()  # type: ignore[attr-defined]
    options.height, options.width = wrapped.shape
    by_quality = cv2.phase_unwrapping.HistogramPhaseUnwrapping_create(options)  # type: ignore[attr-defined]
    turns = by_quality.unwrapPhaseMap(np.float32(2 * np.pi * wrapped), None, 255 * usable.astype(np.uint8))
    turns = wrapped + np.rint(turns / (2 * np.pi) - wrapped)
    for part, cut in _parts(usable):
        turns[cut] -= np.where(part, np.rint(np.median(turns[cut][part])), 0.0)
    if not usable.any():
        return wrapped
    near = distance_transform_edt(~usable, return_distances=False, return_indices=True)
    return np.asarray(wrapped + np.rint(turns[tuple(near)] - wrapped))


def _islands_of(lit: Mask) -> NDArray[np.int32]:
    """Labels (H, W) of the connected parts of lit, 0 elsewhere."""
    return np.asarray(cv2.connectedComponents(lit.astype(np.uint8), connectivity=4)[1])


def _largest_parts(good: Mask, islands: NDArray[np.int32], least: float) -> Mask:
    """Of every island the largest connected part of good pixels, if it has `least` pixels."""
    parts = _islands_of(good)
    area = np.bincount(parts.ravel())
    owner = np.zeros(len(area), np.int64)
    owner[parts[good]] = islands[good]
    ascending = np.lexsort((area, owner))
    last = np.flatnonzero(np.diff(owner[ascending], append=-1))
    keep = np.zeros(len(area), bool)
    keep[ascending[last]] = True
    keep &= (owner > 0) & (area >= least)
    return np.asarray(keep[parts])


def _parts(usable: Mask) -> list[tuple[Mask, tuple[slice, slice]]]:
    """Connected parts, each within its bounding box."""
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(usable.astype(np.uint8), connectivity=4)
    cuts = [(slice(y, y + h), slice(x, x + w)) for x, y, w, h, _ in boxes[1:count].tolist()]
    return [(np.asarray(labels[cut] == k), cut) for k, cut in enumerate(cuts, start=1)]
