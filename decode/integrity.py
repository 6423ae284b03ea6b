"""Are the frames those that the sequence describes? Swapped, lost, repeated, replaced and torn ones, named.

Some hundred pixels that see the pattern, each with a neighbour on either side, are explained by every axis
on its own (see sample_fit). A wrong frame shows in what stays unexplained, where the code is redundant, and
in places that jump or fold along the picture that was shown instead, where it is not. Depth edges, shadows
and gloss do both, too, at pixels that no single fault mends. So every single fault is tried in turn, and
the one is named that mends many of these pixels and breaks hardly any other. Faults that are another
scene's perfect picture stay unseen, and so do those of spots.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import bdtrc

from optolever.errors import InputError
from optolever.patterns import Sequence

from .correspondence import Correspondence, Flag
from .exposures import by_exposure, numbered
from .frames import Light, light_of, sample_levels
from .noise import Sample, estimate_noise, sampled
from .plan import Plan, constraints
from .sample_fit import AxisTable, axis_tables, bends, misfit_at, places
from .spoilt import Finding, left_out, spoilt_pixels

__all__ = ["Finding", "Integrity", "check", "examine", "spoilt_pixels"]

F32 = NDArray[np.float32]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]
#: Pixels that are looked at, with four neighbours each; of them at first; fewest that tell anything.
_PIXELS, _FIRST, _FEWEST = 600, 200, 32
#: One in so many of the costlier half of the pixels tells which faults to try on all; how many.
_THIN, _SECOND = 3, 16
#: Distance of neighbours: share of the image's width, px at least and at most.
_APART, _NEAR, _FAR = 1 / 40, 3, 8
#: Of a pixel's contrast, what its neighbours have at least.
_ALIKE = 0.3
#: Cost above which nothing is worse: log(1 + z^2) at z = 3.
_MOST = 2.3
#: Misfit (sum of squares over B^2) that has no cost to speak of: JPEG, weak finest bits; least, most.
_MISFIT = (0.2, 1.0)
#: Bend of the place that has no cost to speak of, cells; share of it that comes of whole ones, one on a
#: smooth map.
_BEND, _STEP = 1.5, 1 / 1.5
#: Cost of an axis above which a pixel is odd; by which it is mended, or broken; fewest pixels that are.
_ODD, _MENDED, _LEAST = 1.0, 0.7, 8
#: Difference of two frames that show the same, share of the contrast; share of the pixels where they do.
_SAME, _MOSTLY = 0.35, 0.95
#: Probability by chance, of all faults tried, above which nothing is named.
_CHANCE = 0.01
#: Share of the pixels around which a frame changes, from which on its picture is like no other.
_STRUCTURED = 0.25
#: Share of the pixels that a fault by which less is known may mend at depth edges by chance.
_USUAL = 0.025
#: Frames up to which any two may be swapped; of more (sweeps) only those next to each other.
_ALL_PAIRS = 64
#: Faults after which all frames are in wrong places; share of the best margin that others need to be it, too.
_SHIFTED, _TIED = ("lost", "repeated"), 0.9


@dataclass(frozen=True, slots=True)
class Integrity:
    """findings: none, if nothing is wrong that the code can tell; constraints: how many it obeys."""

    findings: tuple[Finding, ...]
    constraints: int


def check(frames: ArrayLike, sequence: Sequence, found: Correspondence | None = None) -> Integrity:
    """Look for a frame that is not what the sequence describes.

    frames (N, H, W), frame i as sequence.frames[i] describes it; found: what decode made of them, whose
    INVALID pixels are not looked at. Some 3000 are.
    """
    stack = np.asarray(frames)
    if stack.ndim != 3 or len(stack) != len(sequence):
        raise InputError(f"check: frames have shape {stack.shape}, sequence describes {len(sequence)} images")
    if any(frame.kind == "stripe" and frame.axis == "uv" for frame in sequence.frames):
        return Integrity((), 0)  # of spots, nothing is told
    light = light_of(stack, sequence)
    mask = None if found is None else np.asarray(found.flags & Flag.INVALID == 0)
    findings: list[Finding] = []
    count = 0
    for part in by_exposure(sequence):
        plan = numbered(part)
        findings += examine(light, plan, estimate_noise(light, plan, mask)[1])
        count += sum(len(group) for group in constraints(plan, len(stack))[-1:])
    return Integrity(tuple(dict.fromkeys(findings)), count)


def examine(light: Light, plan: Plan, lit: Sample) -> tuple[Finding, ...]:
    """The fault that explains what single pixels and their neighbours say; none, if there is none.

    lit: pixels that see the pattern.
    """
    if not axis_tables(plan):
        return ()
    few = _crosses(light, plan, lit, _FIRST)
    if few is not None and not (few.own > _ODD).any():
        return ()
    crosses = _crosses(light, plan, lit, _PIXELS)
    if crosses is None or np.count_nonzero(crosses.own > _ODD, axis=1).max() < _LEAST:
        return ()
    finding = _single_fault(crosses, plan, light.raw.shape[1])
    return () if finding is None else (replace(finding, leave_out=left_out(finding, plan)),)


@dataclass(frozen=True, slots=True, eq=False)
class _Crosses:
    """Levels (N, 5, T) of pixels and of their neighbours to the left, right, above and below, by rows (T,);
    half of what a pixel's levels span (T,); tables of the axes, the misfit and bend of each that have no cost
    to speak of, and the cost (axes, T) of images in their own places."""

    levels: F32
    row: Ints
    contrast: F32
    tables: tuple[AxisTable, ...]
    scales: tuple[tuple[float, float], ...]
    own: F32

    def cost(self, order: Ints, keep: Any = slice(None)) -> F32:
        """Cost (T,) of all axes, of the pixels to keep, where frame i is image order[i] (-1: none)."""
        costs = [
            own[keep]
            if np.array_equal(order[table.frames], table.frames)
            else _cost(*_measures(self.levels[:, :, keep], table, order), *scale)
            for table, scale, own in zip(self.tables, self.scales, self.own, strict=True)
        ]
        return np.asarray(np.sum(costs, axis=0), np.float32)


def _crosses(light: Light, plan: Plan, lit: Sample, most: int) -> _Crosses | None:
    """Of so many pixels at most; None: too few see the pattern."""
    _, height, width = light.raw.shape
    apart = min(max(round(width * _APART), _NEAR), _FAR)
    around = np.array([[0, 0], [0, -apart], [0, apart], [-apart, 0], [apart, 0]])
    seen = lit.places
    if len(seen) < most:  # a wrong frame may look like noise that hides the pattern
        sample = sampled(light, None, 256)
        span = np.ptp(sample.levels, axis=0)
        seen = sample.places[span > _ALIKE * np.quantile(span, 0.99)]
    # by chance, as every so many may be a fringe's period
    chosen = np.sort(np.random.default_rng(0).permutation(len(seen))[:most])
    at = seen[chosen] + around[:, None]
    at = at[:, ((at >= 0) & (at < (height, width))).all(axis=(0, 2))]
    at = at[:, np.argsort(at[0, :, 0], kind="stable")]
    levels = sample_levels(light, at.reshape(-1, 2)).reshape(len(light.raw), 5, -1)
    contrast = np.ptp(levels[_used(plan)], axis=0) / 2
    whole = (contrast > _ALIKE * contrast[0]).all(axis=0)  # not where a sample is NaN
    if np.count_nonzero(whole) < _FEWEST:
        return None
    levels, tables = levels[:, :, whole], axis_tables(plan)
    measured = [_measures(levels, table, np.arange(len(levels))) for table in tables]
    scales = tuple(_scale(table, *both) for table, both in zip(tables, measured, strict=True))
    own = np.stack([_cost(*both, *scale) for both, scale in zip(measured, scales, strict=True)])
    return _Crosses(levels, at[0, whole, 0], contrast[0, whole], tables, scales, own)


def _scale(table: AxisTable, misfit: F32, bend: F32) -> tuple[float, float]:
    """Misfit and bend that have no cost to speak of. Bits alone are weak at their finest anyway."""
    code = table.axis.code
    if not (np.isfinite(misfit).any() and np.isfinite(bend).any()):  # no pixel sees the pattern
        return 1.0, _BEND
    odd = 1.0 if code and not table.axis.fringes else float(np.clip(np.nanmedian(misfit), *_MISFIT))
    return odd, max(_BEND * max(code.cell if code else 1.0, 1.0), 3 * float(np.nanquantile(bend, 0.3)))


def _measures(levels: F32, table: AxisTable, order: Ints) -> tuple[F32, F32]:
    """Misfit (P, T) and bends (2, T) of an axis, whose frame f is image order[f] (-1: none). Where it has no
    bits it is looked up from all frames at once, and no neighbour tells more."""
    source = order[table.frames]
    free = int(table.frames[np.argmin(source)]) if source.min() < 0 else -1
    pixels = 5 if table.axis.code is not None else 1
    some = levels[np.maximum(source, 0), :pixels].reshape(len(source), -1) / table.exposure[:, None]
    place = places(table, some, free)
    misfits = np.stack([misfit_at(table, some, one, free) for one in place])
    misfit = misfits.min(axis=0).reshape(pixels, -1)
    if pixels == 1:
        return misfit, np.zeros((2, misfit.shape[1]), np.float32)
    if table.axis.fringes:  # which tell what a bit must be
        place = np.take_along_axis(place, misfits.argmin(axis=0)[None], axis=0)
    return misfit, bends(place.reshape(len(place), 5, -1))


def _cost(misfit: F32, bend: F32, odd: float, rough: float) -> F32:
    """Cost (T,) of misfits (P, T) and bends (2, T)."""
    beyond = np.maximum(bend / rough - _STEP, 0)
    both = (
        np.minimum(np.log1p(misfit / odd), _MOST).mean(axis=0),
        np.minimum(np.log1p(beyond**2), _MOST).sum(axis=0),
    )
    return np.asarray(both[0] + both[1], np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    """A fault that was tried: pixels that it mends, by how much it lowers the cost of all together, and
    probability that it mends so many by chance."""

    finding: Finding
    mended: int
    margin: float
    chance: float


def _trial(finding: Finding, gain: F32, tried: int, usual: int = 0) -> _Trial:
    """Of a fault that lowers the cost of pixels (T,) by `gain`: a sign test of those mended against those
    broken, or against `usual`, so many as are mended where there is no fault; tried: number of faults."""
    mended, broken = (int(np.count_nonzero(sign * gain > _MENDED)) for sign in (1, -1))
    lost, chance = max(broken, usual), 1.0
    if mended >= max(_LEAST, 2 * lost):
        chance = min(1.0, tried * float(bdtrc(mended - 1, mended + lost, 0.5)))
    return _Trial(finding, mended, float(gain.sum()), chance)


def _single_fault(crosses: _Crosses, plan: Plan, rows: int) -> Finding | None:
    """The fault of all that mends most, with those that do nearly as well."""
    trials = [trial for trial in _trials(crosses, plan, rows) if trial.chance < _CHANCE]
    if not trials:
        return None
    best = max(trials, key=lambda trial: trial.margin * (_TIED if trial.finding.kind in _SHIFTED else 1))
    alike = [t for t in trials if t.margin >= _TIED * best.margin and t.finding.kind == best.finding.kind]
    return replace(
        best.finding,
        frames=tuple(sorted({i for t in alike for i in t.finding.frames})),
        spoilt=tuple(sorted({i for t in alike for i in t.finding.spoilt})),
        sentence=" or ".join(list(dict.fromkeys(t.finding.sentence for t in alike))[:4]),
        confidence=1 - best.chance,
        share=best.mended / len(crosses.row),
    )


def _trials(crosses: _Crosses, plan: Plan, rows: int) -> list[_Trial]:
    count, total = len(crosses.levels), crosses.own.sum(axis=0)
    without = np.tile(np.arange(count), (count, 1))
    np.fill_diagonal(without, -1)
    less = np.stack([total - crosses.cost(order) for order in without])
    some = np.argsort(total)[len(total) // 2 :: _THIN]
    faults = sorted(_faults(count, _used(plan)), key=lambda fault: float(crosses.cost(fault[1], some).sum()))
    swept = any(axis.stripes is not None for axis in plan.axes)
    trials = []
    for finding, order in faults[:_SECOND]:
        gain, usual = total - crosses.cost(order), 0
        if order.min() < 0 and not swept:  # what it is worth to know less is no gain of the fault
            gain = gain - max(np.zeros_like(gain), less[np.argmin(order)], less[-1], key=np.sum)
            usual = int(_USUAL * len(gain))
        trials.append(_trial(finding, gain, len(faults), usual))
    return trials + list(_replacements(crosses, less, rows))


def _used(plan: Plan) -> list[int]:
    """Numbers of the frames that a plan looks at, ascending."""
    return sorted({i for table in axis_tables(plan) for i in table.frames.tolist()})


def _faults(count: int, used: list[int]) -> Iterator[tuple[Finding, Ints]]:
    """Every fault that leaves all images whole, and which image is which frame under it (-1: none); swaps are
    of frames that are used."""
    for k, i in enumerate(used):
        for j in used[k + 1 : None if len(used) <= _ALL_PAIRS else k + 3]:
            order = np.arange(count)
            order[[i, j]] = j, i
            yield Finding((i, j), "swapped", f"frames {i} and {j} are in each other's place", (i, j)), order
    for k in range(count - 1):
        order = np.concatenate([np.arange(k), [-1], np.arange(k, count - 1)])
        told = f"frame {k} is missing, those after it come one too early"
        yield Finding((k,), "lost", told, tuple(range(k, count))), order
    for k in range(1, count - 1):
        order = np.concatenate([np.arange(k), np.arange(k + 1, count), [-1]])
        told = f"frame {k - 1} is there twice, those after it come one late"
        yield Finding((k,), "repeated", told, tuple(range(k, count))), order


def _replacements(crosses: _Crosses, less: F32, rows: int) -> Iterator[_Trial]:
    """Frames that show another one instead, in all rows or beyond a tear; less (N, T): gain without each."""
    mended = np.count_nonzero(less > _MENDED, axis=1)
    usual = int(_USUAL * len(crosses.row))
    centre = crosses.levels[:, 0]
    structured = np.ptp(crosses.levels, axis=1) > crosses.contrast
    for i in np.flatnonzero(mended >= _LEAST).tolist():
        same = np.abs(centre[i] - centre) < _SAME * crosses.contrast
        same[i] = False
        for j in np.flatnonzero(same.any(axis=1)).tolist():
            for start, stop in _parts(same[j]):
                finding = Finding((i,), "replaced", f"frame {i} is frame {j} again", (i,))
                if (start, stop) != (0, len(crosses.row)):
                    first = int(crosses.row[start]) if start else 0
                    last = int(crosses.row[stop]) if stop < len(crosses.row) else rows
                    told = f"frame {i} is torn: in rows {first} to {last - 1} it shows frame {j}"
                    finding = Finding((i,), "torn", told, (i,), (first, last))
                # no two frames with structure everywhere are the same in any scene
                alone = structured[j, start:stop].mean() > _STRUCTURED
                tried = len(less) * (4 if finding.rows else 1)  # either side, and the row
                yield _trial(finding, less[i, start:stop], tried, 0 if alone else usual)


def _parts(same: Mask) -> list[tuple[int, int]]:
    """Ranges from the first or to the last of pixels in which two frames are the same."""
    count = len(same)
    if same.mean() >= _MOSTLY:
        return [(0, count)]
    score = np.cumsum(np.append(0.0, same - _MOSTLY))
    ranges = (0, int(score.argmax())), (int(score.argmin()), count)
    return [(start, stop) for start, stop in ranges if stop - start >= _LEAST]
