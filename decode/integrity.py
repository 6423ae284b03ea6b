"""Are the frames those that the sequence describes? Swapped, lost and torn ones, named where the code tells.

What a sequence shows obeys linear constraints, whatever the camera looks at: the fringe's N samples lie in a
space of three dimensions, a bit and its inverse add up to the same as any other pair, or as white and black.
They are tested on a sample of pixels, and where they are broken, every single fault is tried: the one that
mends them is named. Bits of Gray codes are tested by the map that they decode to (see code_jumps), swept
stripes and spots by how they follow each other (see sweep, raster_faults). Faults that break none stay
unseen: three steps alone, two whole pairs in each other's place, a fringe run backwards.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from optolever.blocks import on_cores
from optolever.errors import InputError
from optolever.patterns import Sequence

from .code_jumps import BitFault, bit_faults
from .correspondence import Correspondence
from .exposures import by_exposure, numbered
from .plan import AxisPlan, Plan
from .raster import raster_of
from .raster_faults import RasterFault, raster_faults
from .sample import Sample, quantile, sampled
from .sample_kernels import least_rough
from .sweep import sweep_faults

__all__ = ["Finding", "Integrity", "check", "examine", "rule_faults"]

F64 = NDArray[np.float64]
Floats = NDArray[np.floating[Any]]
_PIXELS = 2048
#: Pixels that tell anything.
_FEWEST = 64
#: Excess of the difference of two frames that are the same.
_ALIKE = 0.2
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
#: Pixels in a band that tells anything.
_FEWEST_OF_BAND = 32
#: Share of the bands on the torn side in which the tear shows.
_SHOWN = 0.6
#: Of the pixels, every so many serve the search for a fault.
_FEWER = 4


@dataclass(frozen=True, slots=True)
class Finding:
    """A fault: numbers of the frames, what kind, and a sentence; `spoilt` frames are not those described, in
    rows start..stop (None: all); span: axis and coordinates between which pixels saw them (None: everywhere).

    kind: swapped | lost | repeated | replaced (by its neighbour) | torn | foreign (a bit's picture is not
    that bit's) | inconsistent (something is wrong, and nothing tells with which frame: none is spoilt).
    """

    frames: tuple[int, ...]
    kind: str
    sentence: str
    spoilt: tuple[int, ...] = ()
    rows: tuple[int, int] | None = None
    span: tuple[str, float, float] | None = None


@dataclass(frozen=True, slots=True)
class Integrity:
    """findings: none, if nothing is wrong that the code can tell; constraints: how many it obeys."""

    findings: tuple[Finding, ...]
    constraints: int


@dataclass(frozen=True, slots=True)
class Lit:
    """Levels (N, K) of pixels that see the pattern, their rows (K,), and what is noise in them."""

    levels: Floats
    row: NDArray[np.int64]
    noise: float


def check(frames: ArrayLike, sequence: Sequence, found: Correspondence | None = None) -> Integrity:
    """Look for a frame that is not what the sequence describes.

    frames (N, H, W), frame i as sequence.frames[i] describes it; found: what decode made of them, without
    which bits that have no inverse are not tested; nor are they where a code was shown under several
    exposures, whose levels `found` mixes. Some 2000 pixels are looked at.
    """
    stack = np.asarray(frames)
    if stack.ndim != 3 or len(stack) != len(sequence):
        raise InputError(f"check: frames have shape {stack.shape}, sequence describes {len(sequence)} images")
    raster = raster_of(sequence)
    if raster is not None:
        fault = raster_faults(stack, raster.index, raster.half)
        return Integrity((_of_raster(fault),) if fault is not None else (), 0)
    parts = by_exposure(sequence)
    found = found if len(parts) == 1 else None
    plans = [numbered(part) for part in parts]
    each = [examine(stack, wanted, found, rule_faults(stack, sampled(stack), wanted)) for wanted in plans]
    return Integrity(
        tuple(dict.fromkeys(finding for one in each for finding in one.findings)),
        sum(one.constraints for one in each),
    )


def rule_faults(stack: NDArray[Any], sample: Sample, wanted: Plan) -> tuple[Finding, ...]:
    """What breaks the constraints of a plan, which takes no map; sample: of the stack."""
    rules = _constraints(wanted, len(stack))
    return _broken(rules, _sparse_constraints(wanted, len(stack)), stack, sample) if len(rules) else ()


def examine(
    stack: NDArray[Any], wanted: Plan, found: Correspondence | None, findings: tuple[Finding, ...]
) -> Integrity:
    """check for a plan; findings: rule_faults."""
    if not findings and found is not None and found.offset is not None:
        flags, offset = found.flags, found.offset
        coded = [axis for axis in wanted.axes if axis.code is not None]
        faults = on_cores(
            lambda axis: bit_faults(axis, stack, getattr(found, axis.axis), flags, offset), coded
        )
        findings = tuple(_foreign(fault) for own in faults for fault in own)
    if not findings:
        findings = tuple(_of_sweeps(stack, wanted))
    constraints = len(_constraints(wanted, len(stack)))
    return Integrity(tuple(_judged(finding, wanted) for finding in findings), constraints)


def _of_sweeps(stack: NDArray[Any], wanted: Plan) -> Iterator[Finding]:
    """The first sweep that is broken: what was lost in it puts later ones into wrong places, too."""
    clip = 255.0 if stack.dtype == np.uint8 else float("inf")
    for axis in sorted(wanted.axes, key=lambda axis: min(axis.stripes.index) if axis.stripes else 0):
        if axis.stripes is None:
            continue
        fault = sweep_faults(stack, clip, axis.stripes, axis.extent)
        if fault is not None:
            kind, frames = fault
            after = tuple(range(frames[0], len(stack))) if kind in ("lost", "repeated") else frames
            told = {"lost": "is missing", "repeated": "is the one before again", "replaced": "is another one"}
            sentence = f"stripe of frame {frames[0]} {told.get(kind, f'and {frames[-1]} are swapped')}"
            span = None if kind in ("lost", "repeated") else (axis.axis, *axis.stripes.around(frames))
            yield Finding(frames, kind, sentence, after, span=span)
            return


def _judged(finding: Finding, wanted: Plan) -> Finding:
    """Without the frames that spoil no pixel unflagged."""
    return replace(finding, spoilt=tuple(sorted(set(finding.spoilt) - _told(wanted, finding.kind))))


def _told(wanted: Plan, fault: str) -> set[int]:
    """Frames whose pixels tell by themselves that they are wrong.

    Bits with their inverses do by margin and sum, those of XOR-Gray not if they are in each other's place
    (all are near their edges at once); none do if all later frames are in wrong places.
    """
    told: set[int] = set()
    if fault in ("lost", "repeated", "foreign"):
        return told
    local = fault in ("replaced", "torn")
    for axis in wanted.axes:
        if axis.code is not None and (local or axis.code.kind != "xor-gray"):
            both = (axis.code.plain >= 0) & (axis.code.inverse >= 0)
            told.update(axis.code.plain[both].tolist(), axis.code.inverse[both].tolist())
    return told


def _broken(rules: F64, sparse: csr_array, stack: NDArray[Any], sample: Sample) -> tuple[Finding, ...]:
    lit = _lit(sample, rules)
    levels, noise = lit.levels, lit.noise
    if levels.shape[1] < _FEWEST:
        return ()
    each = _broken_by(sparse, levels, noise)
    excess = each.mean(axis=1)
    if excess.max(initial=0.0) < _BROKEN:
        return _torn(rules, each, lit, stack)
    findings = _replaced(rules, levels, noise) or _single_fault(rules, levels, noise, excess)
    findings = findings or _torn(rules, each, lit, stack)
    if findings:
        return findings
    used = tuple(int(i) for i in np.flatnonzero(np.abs(rules[excess >= _BROKEN]).max(axis=0) > 0))
    return (Finding(used, "inconsistent", f"frames {_list(used)} do not fit together"),)


def _of_raster(fault: RasterFault) -> Finding:
    first = fault.frames[0]
    told = {
        "lost": f"spot of frame {first} is missing, those after it come one too early",
        "repeated": f"spot of frame {first} is the one before again, those after it come one late",
        "replaced": f"spot of frame {first} is another one",
    }
    swapped = f"spots of frames {first} and {fault.frames[-1]} are swapped"
    return Finding(fault.frames, fault.kind, told.get(fault.kind, swapped), fault.frames)


def _foreign(fault: BitFault) -> Finding:
    told = f"frame {fault.frame} does not show its bit in rows {fault.start} to {fault.stop - 1}"
    return Finding((fault.frame,), "foreign", told, (fault.frame,), (fault.start, fault.stop))


@lru_cache(maxsize=16)
def _constraints(wanted: Plan, count: int) -> F64:
    """Rows (R, N) of unit length whose product with the levels of a pixel is 0."""
    rows: list[F64] = []
    for axis in wanted.axes:
        for fringe in axis.fringes:
            rows += [_row(count, list(fringe.index), contrast) for contrast in fringe.contrasts()]
        rows += _pairs(wanted, axis, count)
    return np.array(rows).reshape(-1, count)


def _pairs(wanted: Plan, axis: AxisPlan, count: int) -> list[F64]:
    """A bit's sum with its inverse is that of white and black, or that of another bit."""
    if axis.code is None:
        return []
    both = zip(axis.code.plain.tolist(), axis.code.inverse.tolist(), strict=True)
    pairs = [pair for pair in both if min(pair) >= 0]
    reference = [(wanted.white, wanted.black)] if min(wanted.white, wanted.black) >= 0 else []
    rows = []
    for k, pair in enumerate(pairs):
        # the next pair, and not all of them: a wrong frame must not break every rule
        others = reference or ([pairs[(k + 1) % len(pairs)]] if len(pairs) > 1 else [])
        if others:
            weights = [1.0, 1.0] + [-1.0 / len(others)] * (2 * len(others))
            rows.append(_row(count, [*pair, *(i for other in others for i in other)], np.array(weights)))
    return rows


@lru_cache(maxsize=16)
def _sparse_constraints(wanted: Plan, count: int) -> csr_array:
    """_constraints, each of which is about a few frames only."""
    return csr_array(_constraints(wanted, count).astype(np.float32))


def _row(count: int, index: list[int], weights: F64) -> F64:
    row = np.zeros(count)
    row[index] = weights / np.linalg.norm(weights)
    return row


def _lit(sample: Sample, rules: F64) -> Lit:
    """Pixels that see the pattern without clipping in the frames that the rules are about.

    Noise: from second differences within runs, the least of the frames, as what they show adds to it.
    """
    some = sample.runs[:, ::4].astype(np.float32)  # a quarter of the lines is enough for a median
    some = some.reshape(len(some), -1, some.shape[-1])
    noise = least_rough(some, np.empty(some[0].size, np.float32)) * 1.4826 / math.sqrt(6)
    levels = sample.levels
    highest, asked = levels.max(axis=0), np.abs(rules).max(axis=0) > 0
    span = highest - levels.min(axis=0)
    top = 255.0 if levels.dtype == np.uint8 else float("inf")
    brightest = highest if asked.all() else levels[asked].max(axis=0)
    bright = (span >= 0.5 * quantile(span, 0.9)) & (brightest < top)
    # by chance, as every so many pixels may be a fringe's period; sorted, as they are cut into bands
    order = _by_chance(len(bright))
    chosen = np.zeros(len(bright), np.bool_)
    chosen[order[bright[order]][:_PIXELS]] = True
    use = np.flatnonzero(chosen)
    contrast = quantile(span[use], 0.5) if len(use) else 0.0
    return Lit(
        levels.take(use, axis=1).astype(np.float32),
        sample.row[use],
        float(np.hypot(max(noise, _LEAST_NOISE), _UNEVEN * contrast)),
    )


@lru_cache(maxsize=4)
def _by_chance(count: int) -> NDArray[np.int64]:
    return np.random.default_rng(0).permutation(count)


def _broken_by(rules: F64 | csr_array, levels: Floats, noise: float) -> Floats:
    """By how much each pixel breaks each constraint (R, K), beyond the mean of noise."""
    return np.asarray(np.log1p(((rules @ levels) / noise) ** 2) - _OF_NOISE)


def _excess(rules: F64, levels: Floats, noise: float) -> Floats:
    """By how much each constraint is broken (R,): a mean that a few odd pixels do not move."""
    if levels.shape[1] == 0:
        return np.zeros(len(rules))
    return np.asarray(_broken_by(rules, levels, noise).mean(axis=1))


def _replaced(rules: F64, levels: Floats, noise: float) -> tuple[Finding, ...]:
    """A frame that is one of its neighbours again, all others in their places."""
    found = []
    for k in range(len(levels)):
        free = np.abs(rules[:, k]) < 1e-9
        if free.all() or _excess(rules[free], levels, noise).max(initial=0.0) >= _BROKEN:
            continue
        for other in (k - 1, k + 1):
            if 0 <= other < len(levels) and _apart(levels, k, other, noise) < _ALIKE:
                found.append((k, other))
    if not found:
        return ()
    frames = tuple(sorted({k for k, _ in found}))
    told = " or ".join(f"frame {k} is frame {other} again" for k, other in found[:4])
    return (Finding(frames, "replaced", told, frames),)


def _apart(levels: Floats, i: int, j: int, noise: float) -> float:
    """By how much two frames differ beyond their noise, as _excess."""
    return float(np.log1p(((levels[i] - levels[j]) / noise) ** 2 / 2).mean() - _OF_NOISE)


def _single_fault(rules: F64, levels: Floats, noise: float, excess: Floats) -> tuple[Finding, ...]:
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
    spoilt = tuple(sorted({i for finding in same for i in finding.spoilt}))
    return (Finding(frames, same[0].kind, " or ".join(finding.sentence for finding in same[:4]), spoilt),)


def _faults(count: int) -> Iterator[tuple[Finding, NDArray[np.int64]]]:
    """Every single fault, and which image is which frame under it (-1: none)."""
    for i in range(count):
        for j in range(i + 1, count):
            order = np.arange(count)
            order[[i, j]] = j, i
            yield Finding((i, j), "swapped", f"frames {i} and {j} are in each other's place", (i, j)), order
    for k in range(count - 1):
        order = np.concatenate([np.arange(k), [-1], np.arange(k, count - 1)])
        after = tuple(range(k, count))
        told = f"frame {k} is missing, those after it come one too early"
        yield Finding((k,), "lost", told, after), order
    for k in range(1, count - 1):
        order = np.concatenate([np.arange(k), np.arange(k + 1, count), [-1]])
        after = tuple(range(k + 1, count))
        told = f"frame {k} is there twice, those after it come one late"
        yield Finding((k,), "repeated", told, after), order


def _torn(rules: F64, each: Floats, lit: Lit, stack: NDArray[Any]) -> tuple[Finding, ...]:
    """A frame whose rows on one side of a line are those of its neighbour; each (R, K): see _broken_by."""
    levels, noise, rows = lit.levels, lit.noise, stack.shape[1]
    band = lit.row * _BANDS // rows
    pixels = np.bincount(band, minlength=_BANDS)
    seen = np.flatnonzero(pixels)
    total = np.add.reduceat(each, np.searchsorted(band, seen), axis=1)
    enough = pixels[seen] >= _FEWEST_OF_BAND
    present = seen[enough]
    bad = total[:, enough].max(axis=0, initial=0.0) >= _BROKEN * pixels[present]
    if not bad.any():
        return ()
    first, last = int(np.argmax(bad)), len(bad) - 1 - int(np.argmax(bad[::-1]))
    if (first == 0) == (last == len(bad) - 1) or bad[first : last + 1].mean() < _SHOWN:
        return ()
    spoilt = levels[:, np.isin(band, present[first : last + 1])]
    broken = rules[_excess(rules, spoilt, noise) >= _BROKEN]
    nearest: tuple[float, int, int] | None = None
    for i in np.flatnonzero(np.abs(broken).max(axis=0, initial=0.0) > 0):
        for j in (int(i) - 1, int(i) + 1):
            if 0 <= j < len(levels):
                apart = _apart(spoilt, int(i), j, noise)
                nearest = min(nearest or (apart, int(i), j), (apart, int(i), j))
    if nearest is None or nearest[0] > _BROKEN:
        return ()
    _, frame, other = nearest
    above = first == 0
    edge = _edge(broken, stack, noise, int(present[last + 1 if above else first] * rows / _BANDS), above)
    told = f"frame {frame} is torn: {'above' if above else 'below'} row {edge} it shows frame {other}"
    told = f"{told} (or {other} shows {frame})"
    return (Finding((frame, other), "torn", told, (frame, other), (0, edge) if above else (edge, rows)),)


def _edge(broken: F64, stack: NDArray[Any], noise: float, about: int, above: bool) -> int:
    """First row of the lower part, from the rows a band's height around."""
    _, rows, cols = stack.shape
    height = -(-rows // _BANDS)
    near = np.arange(max(about - height, 0), min(about + height, rows))
    levels = stack[:, near[0] : near[-1] + 1, :: max(1, cols // 256)].astype(np.float64)
    bad = [_excess(broken, levels[:, k], noise).max() >= _BROKEN for k in range(len(near))]
    # the row at which most rows lie on their own side
    score = np.cumsum([0, *(1 if wrong == above else -1 for wrong in bad)])
    return int(near[0] + np.argmax(score))


def _list(numbers: tuple[int, ...]) -> str:
    shown = ", ".join(str(number) for number in numbers[:8])
    return shown if len(numbers) <= 8 else f"{shown} and {len(numbers) - 8} more"
