"""Are the frames those that the sequence describes? Swapped, lost and torn ones, named where the code tells.

What a sequence shows obeys linear constraints, whatever the camera looks at: the fringe's N samples lie in a
space of three dimensions, a bit and its inverse add up to the same as any other pair, or as white and black.
They are tested on a sample of pixels, and where they are broken, every single fault is tried: the one that
mends them is named. Faults that break none stay unseen: three steps alone, bits without inverses, two whole
pairs in each other's place, a fringe run backwards.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optolever.errors import InputError
from optolever.patterns import Sequence

from .noise import spatial_noise
from .plan import AxisPlan, Plan, plan

__all__ = ["Finding", "Integrity", "check"]

F64 = NDArray[np.float64]
_PIXELS = 2048
#: Excess of a constraint's mean log(1 + z^2) over that of noise, above which it is broken.
_BROKEN = 0.4
#: Share of the broken constraints' excess that a fault may leave and still explain them.
_LEFT = 0.25
#: Mean of log(1 + z^2) of a normal z.
_OF_NOISE = 0.534
#: Noise below which rounding and the pattern's own grey values decide, levels.
_LEAST_NOISE = 1.0
#: Error of real displays that is no fault, share of the contrast: a bit and its inverse are not quite white.
_UNEVEN = 0.04
_BANDS = 16
#: Share of the bands on the torn side in which the tear shows.
_SIDE = 0.6
#: Of the pixels, every so many serve the search for a fault.
_FEWER = 4


@dataclass(frozen=True, slots=True)
class Finding:
    """A fault: numbers of the frames, swapped | lost | repeated | torn | inconsistent, and a sentence."""

    frames: tuple[int, ...]
    kind: str
    sentence: str


@dataclass(frozen=True, slots=True)
class Integrity:
    """findings: none, if nothing is wrong that the code can tell; constraints: how many it obeys."""

    findings: tuple[Finding, ...]
    constraints: int


def check(frames: ArrayLike, sequence: Sequence) -> Integrity:
    """Look for a frame that is not what the sequence describes.

    frames (N, H, W), frame i as sequence.frames[i] describes it. Some 2000 pixels are looked at.
    """
    stack = np.asarray(frames)
    if stack.ndim != 3 or len(stack) != len(sequence):
        raise InputError(f"check: frames have shape {stack.shape}, sequence describes {len(sequence)} images")
    rules = _constraints(plan(sequence), len(sequence))
    if len(rules) == 0:
        return Integrity((), 0)
    levels, row = _sample(stack)
    contrast = float(np.median(np.ptp(levels, axis=0))) if levels.size else 0.0
    noise = float(np.hypot(max(spatial_noise(stack), _LEAST_NOISE), _UNEVEN * contrast))
    excess = _excess(rules, levels, noise)
    if excess.max(initial=0.0) < _BROKEN:
        return Integrity(_torn(rules, levels, row, noise, stack.shape[1]), len(rules))
    findings = _single_fault(rules, levels, noise, excess) or _torn(rules, levels, row, noise, stack.shape[1])
    if not findings:
        used = tuple(int(i) for i in np.flatnonzero(np.abs(rules[excess >= _BROKEN]).max(axis=0) > 0))
        findings = (Finding(used, "inconsistent", f"frames {_list(used)} do not fit together"),)
    return Integrity(findings, len(rules))


def _constraints(wanted: Plan, count: int) -> F64:
    """Rows (R, N) of unit length whose product with the levels of a pixel is 0."""
    rows: list[F64] = []
    for axis in wanted.axes:
        for fringe in axis.fringes:
            for contrast in np.linalg.qr(fringe.design(), mode="complete")[0][:, 3:].T:
                rows.append(_row(count, list(fringe.index), contrast))
        rows += _pairs(wanted, axis, count)
    return np.array(rows).reshape(-1, count)


def _pairs(wanted: Plan, axis: AxisPlan, count: int) -> list[F64]:
    """A bit's sum with its inverse is that of white and black, or the mean of all the others."""
    if axis.code is None:
        return []
    both = zip(axis.code.plain.tolist(), axis.code.inverse.tolist(), strict=True)
    pairs = [pair for pair in both if min(pair) >= 0]
    reference = [(wanted.white, wanted.black)] if min(wanted.white, wanted.black) >= 0 else []
    rows = []
    for k, pair in enumerate(pairs):
        others = reference or pairs[:k] + pairs[k + 1 :]
        if others:
            weights = [1.0, 1.0] + [-1.0 / len(others)] * (2 * len(others))
            rows.append(_row(count, [*pair, *(i for other in others for i in other)], np.array(weights)))
    return rows


def _row(count: int, index: list[int], weights: F64) -> F64:
    row = np.zeros(count)
    row[index] = weights / np.linalg.norm(weights)
    return row


def _sample(stack: NDArray[Any]) -> tuple[F64, NDArray[np.int64]]:
    """Levels (N, K) of pixels that see the pattern without clipping, and their rows."""
    _, rows, cols = stack.shape
    side = np.sqrt(4 * _PIXELS)
    at = np.arange(0, rows, max(1, int(rows / side))), np.arange(0, cols, max(1, int(cols / side)))
    levels = stack[:, at[0][:, None], at[1]].reshape(len(stack), -1).astype(np.float64)
    row = np.repeat(at[0], len(at[1]))
    span = np.ptp(levels, axis=0)
    top = 255.0 if stack.dtype == np.uint8 else float("inf")
    use = np.flatnonzero((span >= 0.5 * np.percentile(span, 90)) & (levels.max(axis=0) < top))
    use = use[:: max(1, len(use) // _PIXELS)]
    return levels[:, use], row[use]


def _excess(rules: F64, levels: F64, noise: float) -> F64:
    """By how much each constraint is broken (R,): a mean that a few odd pixels do not move."""
    if levels.shape[1] == 0:
        return np.zeros(len(rules))
    return np.asarray(np.log1p((rules @ levels / noise) ** 2).mean(axis=1) - _OF_NOISE)


def _single_fault(rules: F64, levels: F64, noise: float, excess: F64) -> tuple[Finding, ...]:
    """Two frames in each other's place, or one lost: those that mend most, if they mend it."""
    broken = float(np.maximum(excess, 0).sum())
    tried: list[tuple[float, Finding]] = []
    levels = levels[:, ::_FEWER]
    for finding, order in _faults(len(levels)):
        # a frame that nobody has (-1) takes its constraints with it
        whole = (np.abs(rules[:, order < 0]) < 1e-9).all(axis=1)
        if not whole.any():
            continue
        left = float(np.maximum(_excess(rules[whole], levels[order], noise), 0).sum())
        known = float(np.maximum(excess[whole], 0).sum())
        if finding.kind == "swapped" or known > 2 * _BROKEN:
            tried.append((left / max(known, 1e-9), finding))
    best = min((share for share, _ in tried), default=1.0)
    if best > _LEFT or broken < _BROKEN:
        return ()
    same = [finding for share, finding in tried if share <= best + 0.02]
    if len(same) == 1:
        return (same[0],)
    same = [finding for finding in same if finding.kind == same[0].kind]
    frames = tuple(sorted({i for finding in same for i in finding.frames}))
    return (Finding(frames, same[0].kind, " or ".join(finding.sentence for finding in same[:4])),)


def _faults(count: int) -> Iterator[tuple[Finding, NDArray[np.int64]]]:
    """Every single fault, and which image is which frame under it (-1: none)."""
    for i in range(count):
        for j in range(i + 1, count):
            order = np.arange(count)
            order[[i, j]] = j, i
            yield Finding((i, j), "swapped", f"frames {i} and {j} are in each other's place"), order
    for k in range(count - 1):
        order = np.concatenate([np.arange(k), [-1], np.arange(k, count - 1)])
        yield Finding((k,), "lost", f"frame {k} is missing, those after it come one too early"), order
    for k in range(1, count - 1):
        order = np.concatenate([np.arange(k), np.arange(k + 1, count), [-1]])
        yield Finding((k,), "repeated", f"frame {k} is there twice, those after it come one late"), order


def _torn(rules: F64, levels: F64, row: NDArray[np.int64], noise: float, rows: int) -> tuple[Finding, ...]:
    """A frame whose rows on one side of a line are those of the frame before or after it."""
    band = row * _BANDS // rows
    present = [k for k in range(_BANDS) if np.count_nonzero(band == k) >= 32]
    bad = np.array([_excess(rules, levels[:, band == k], noise).max() >= _BROKEN for k in present], bool)
    if not bad.any():
        return ()
    first, last = int(np.argmax(bad)), len(bad) - 1 - int(np.argmax(bad[::-1]))
    if (first == 0) == (last == len(bad) - 1) or bad[first : last + 1].mean() < _SIDE:
        return ()
    spoilt = levels[:, np.isin(band, np.array(present)[first : last + 1])]
    used = np.abs(rules[_excess(rules, spoilt, noise) >= _BROKEN]).max(axis=0) > 0
    nearest: tuple[float, int, int] | None = None
    for i in np.flatnonzero(used):
        for j in (int(i) - 1, int(i) + 1):
            if 0 <= j < len(levels):
                apart = float(np.log1p(((spoilt[i] - spoilt[j]) / noise) ** 2 / 2).mean() - _OF_NOISE)
                nearest = min(nearest or (apart, int(i), j), (apart, int(i), j))
    if nearest is None or nearest[0] > _BROKEN:
        return ()
    _, frame, other = nearest
    edge = int(present[last + 1 if first == 0 else first] * rows / _BANDS)
    side = "above" if first == 0 else "below"
    told = f"frame {frame} is torn: {side} row {edge} or so it shows frame {other}"
    return (Finding((frame, other), "torn", f"{told} (or {other} shows {frame})"),)


def _list(numbers: tuple[int, ...]) -> str:
    shown = ", ".join(str(number) for number in numbers[:8])
    return shown if len(numbers) <= 8 else f"{shown} and {len(numbers) - 8} more"
