"""Tests whether frames match the sequence: swapped, lost, repeated, replaced and torn frames are named.

Some hundred illuminated pixels, each with four neighbours, are fitted by every axis separately (see
sample_fit). A wrong frame raises the residuals where the code is redundant, and otherwise makes places jump
or fold along the picture of the wrong frame. Depth edges, shadows and gloss do both, too, at pixels that no
single fault repairs. So every single fault is tried, and the one is named that repairs many of these pixels
and breaks hardly any other. Faults that give another scene's perfect picture are not detected, nor are faults
of spots.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from math import erfc, sqrt
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from optolever.errors import InputError
from optolever.patterns import Sequence

from ..codes.bit_levels import coarser, nested
from ..codes.gray import unresolved_count
from ..exposures import by_exposure
from ..frames import Light, light_of, sample_levels
from ..plan import AxisPlan, Plan, constraints, plan
from ..profile.noise import Noise, Sample, estimate_noise, sampled
from .contradictions import Contradictions, contradictions, mistuned, other_descriptions
from .sample_fit import AxisTable, axis_tables, bends, misfit_at, places
from .spoilt import Finding, left_out, spoilt_pixels

__all__ = ["Finding", "Integrity", "check", "examine", "spoilt_pixels"]

F32 = NDArray[np.float32]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]
#: Pixels of the sample, with four neighbours each; fewest pixels for a test.
_PIXELS, _FEWEST = 600, 32
#: Pixels of the search's first round, and faults of its second.
_FIRST, _SECOND = 100, 16
#: Distance of neighbours: share of the image's width, px at least and at most.
_APART, _NEAR, _FAR = 1 / 40, 3, 8
#: Least contrast of the neighbours, share of the pixel's.
_ALIKE = 0.3
#: Largest cost: log(1 + z^2) at z = 3.
_MOST = 2.3
#: Misfit (sum of squares over B^2) of negligible cost: JPEG, weak finest bits; least, most.
_MISFIT = (0.2, 1.0)
#: Second difference of the place with negligible cost, cells.
_BEND = 1.5
#: Share of it by rounding to cells: one cell on a smooth map.
_STEP = 1 / _BEND
#: Cost of an axis above which a pixel is odd.
_ODD = 1.0
#: Misfit of a strange pixel, in units of the negligible one.
_STRANGE = 4.0
#: Difference of the places of neighbours that is a jump, in units of the median.
_JUMP = 4.0
#: Share of strange pixels beyond edges of a scene; their nearest neighbours, and the share of strange ones
#: among these if they form one part of the picture.
_PART, _NEAREST, _GATHERED = 0.05, 4, 0.5
#: Contrast over the median below which a pixel is dim.
_DIM = 0.5
#: Change of cost by which a pixel is repaired, or broken.
_MENDED = 0.7
#: Largest difference of equal frames, share of the contrast; share of the pixels where they are equal.
_SAME, _MOSTLY = 0.35, 0.95
#: False-alarm probability over all tried faults, above which none is named.
_CHANCE = 0.01
#: Share of the pixels around which a frame varies by its contrast, beyond which it resembles no other frame.
_STRUCTURED = 0.25
#: Faults that displace all later frames, and the share of the pixels that such a fault repairs by chance.
_SHIFTED, _ALL_LATER = ("lost", "repeated"), 0.075
#: Frames up to which any two may be swapped; of more (sweeps) only those next to each other.
_ALL_PAIRS = 64
#: Sentence for a capture that no other description explains.
_NOT_THOSE = "codes contradict each other nearly everywhere: frames are not those described"
#: Share of contradicting pixels beyond which a capture is rejected; beyond which other descriptions are
#: tried; and the remaining part of it under a description that explains them.
_MOST_OF, _SOME, _EXPLAINED = 0.5, 0.25, 0.5
#: Share of the odd pixels that a swap must repair to exchange both frames.
_PUT_BACK = 0.8
#: Share of odd pixels by depth edges of a scene (tests' drawn scenes: 0.08).
_EDGES = 0.08
#: Fewest repaired pixels; share of the best margin beyond which faults tie.
_LEAST, _TIED = 8, 0.9


@dataclass(frozen=True, slots=True)
class Integrity:
    """findings: empty if the code's redundancy reveals no fault; constraints: their number."""

    findings: tuple[Finding, ...]
    constraints: int


def check(frames: ArrayLike, sequence: Sequence) -> Integrity:
    """Test whether frames match the sequence.

    frames (N, H, W), frame i as sequence.frames[i] describes it. The test uses some 2000 pixels.
    """
    stack = np.asarray(frames)
    if stack.ndim != 3 or len(stack) != len(sequence):
        raise InputError(f"check: frames have shape {stack.shape}, sequence describes {len(sequence)} images")
    if any(frame.kind == "stripe" and frame.axis == "uv" for frame in sequence.frames):
        return Integrity((), 0)  # spots are not tested
    light = light_of(stack, sequence)
    findings: list[Finding] = []
    count = 0
    for part in by_exposure(sequence):
        shot, wanted = light.only(part.index), plan(part.sequence)
        some = examine(shot, wanted, *estimate_noise(shot, wanted), part.index)
        findings += [_numbered(one, part.index) for one in some]
        count += sum(len(group) for group in constraints(wanted, len(part.index))[-1:])
    return Integrity(tuple(dict.fromkeys(findings)), count)


def _numbered(finding: Finding, names: Ints) -> Finding:
    every = finding.frames, finding.spoilt, finding.leave_out
    frames, spoilt, leave_out = (tuple(names[list(one)].tolist()) for one in every)
    images = tuple(-1 if i < 0 else int(names[i]) for i in finding.images)
    return replace(finding, frames=frames, spoilt=spoilt, leave_out=leave_out, images=images)


def examine(
    light: Light, plan: Plan, noise: Noise, lit: Sample, names: Ints | None = None
) -> tuple[Finding, ...]:
    """The fault that explains residuals of single pixels and jumps between neighbours; empty: none.

    lit: illuminated pixels; names (N,): numbers of the frames in sentences, default: their indices.
    """
    known = resolved(plan, lit, noise)
    if not axis_tables(known):
        return ()
    crosses = _crosses(light, known, lit)
    if crosses is None:
        return ()
    names = np.arange(len(light.raw)) if names is None else names
    finding = _single_fault(crosses, known, light.raw.shape[1], names)
    if finding is not None:
        return (replace(finding, leave_out=left_out(finding, plan)),)
    return _rolled(crosses, light.raw.shape[1]) or _refused(crosses, known)


def resolved(plan: Plan, lit: Sample, noise: Noise) -> Plan:
    """The plan without the finest bits that the camera does not resolve: they do not test frames."""
    lost = tuple(_unresolved(axis, plan, lit, noise) for axis in plan.axes)
    return _without_bits(plan, lost) if any(lost) else plan


def _unresolved(axis: AxisPlan, plan: Plan, lit: Sample, noise: Noise) -> int:
    if axis.code is None or not nested(axis.code):
        return 0
    return unresolved_count(axis.code, plan, noise, lit, axis.fringes[0] if axis.fringes else None)


@lru_cache(maxsize=8)
def _without_bits(plan: Plan, lost: tuple[int, ...]) -> Plan:
    """Remove so many of the finest bits of each axis."""
    axes = zip(plan.axes, lost, strict=True)
    less = (axis if axis.code is None else replace(axis, code=coarser(axis.code, n)) for axis, n in axes)
    return replace(plan, axes=tuple(less))


@lru_cache(maxsize=4)
def _chosen(count: int) -> Ints:
    """Random choice among `count` pixels: equidistant ones might match a fringe's period."""
    return np.sort(np.random.default_rng(0).permutation(count)[:_PIXELS])


def _apart(width: int) -> int:
    return min(max(round(width * _APART), _NEAR), _FAR)


@dataclass(frozen=True, slots=True, eq=False)
class _Crosses:
    """Pixels and their four neighbours: -x, +x, -y, +y.

    levels (N, 5, T); at (2, T): rows and columns; contrast (T,): half of the span of a pixel's levels; tables
    of the axes; scales: misfit and second difference of negligible cost; own (axes, T): cost of the described
    order of images; strange (T,): whether the misfit indicates a wrong frame, or an edge inside the pixel;
    vertical: distance of neighbours, px.
    """

    levels: F32
    at: Ints
    contrast: F32
    tables: tuple[AxisTable, ...]
    scales: tuple[tuple[float, float], ...]
    own: F32
    strange: Mask
    vertical: int

    def only(self, keep: Any) -> _Crosses:
        """Some of the pixels."""
        levels, own, strange = self.levels[:, :, keep], self.own[:, keep], self.strange[keep]
        at, contrast = self.at[:, keep], self.contrast[keep]
        return replace(self, levels=levels, at=at, contrast=contrast, own=own, strange=strange)

    def contradictions(self, plan: Plan, order: Ints) -> Contradictions:
        """Contradictions if frame i is image order[i] (-1: none)."""
        return contradictions(plan, self.levels, self.contrast, order)

    def cost(self, order: Ints) -> F32:
        """Cost (T,) of all axes if frame i is image order[i] (-1: none)."""
        moved = [not np.array_equal(order[table.frames], table.frames) for table in self.tables]
        every = zip(self.tables, self.scales, self.own, moved, strict=True)
        costs = [
            _cost(*_measures(self.levels, table, order), *scale) if changed else own
            for table, scale, own, changed in every
        ]
        return np.asarray(np.sum(costs, axis=0), np.float32)


def _crosses(light: Light, plan: Plan, lit: Sample) -> _Crosses | None:
    _, height, width = light.raw.shape
    apart = _apart(width)
    around = np.array([[0, 0], [0, -apart], [0, apart], [-apart, 0], [apart, 0]])
    seen = lit.places
    if len(seen) < _PIXELS:  # a wrong frame may look like noise that hides the pattern
        sample = sampled(light, None, 256)
        span = np.ptp(sample.levels, axis=0)
        seen = sample.places[span > _ALIKE * np.quantile(span, 0.99)]
    at = seen[_chosen(len(seen))] + around[:, None]
    at = at[:, ((at >= 0) & (at < (height, width))).all(axis=(0, 2))]
    levels = sample_levels(light, at.reshape(-1, 2)).reshape(len(light.raw), 5, -1)
    contrast = np.ptp(levels[_used(plan)], axis=0) / 2
    whole = (contrast > _ALIKE * contrast[0]).all(axis=0)  # False where a sample is NaN
    if np.count_nonzero(whole) < _FEWEST:
        return None
    levels, tables = levels[:, :, whole], axis_tables(plan)
    measured = [_measures(levels, table, np.arange(len(levels))) for table in tables]
    scales = tuple(_scale(table, *both) for table, both in zip(tables, measured, strict=True))
    own = np.stack([_cost(*both, *scale) for both, scale in zip(measured, scales, strict=True)])
    odd = [both[0][0] > _STRANGE * scale[0] for both, scale in zip(measured, scales, strict=True)]
    strange = np.any(odd, axis=0)
    return _Crosses(levels, at[0, whole].T, contrast[0, whole], tables, scales, own, strange, apart)


def _scale(table: AxisTable, misfit: F32, bend: F32) -> tuple[float, float]:
    """Misfit and second difference of negligible cost. Bits alone have weak finest bits anyway."""
    code = table.axis.code
    if not (np.isfinite(misfit).any() and np.isfinite(bend).any()):  # no illuminated pixel
        return 1.0, _BEND
    odd = 1.0 if code and not table.axis.fringes else float(np.clip(np.nanmedian(misfit), *_MISFIT))
    return odd, max(_BEND * max(code.cell if code else 1.0, 1.0), 3 * float(np.nanquantile(bend, 0.3)))


def _measures(levels: F32, table: AxisTable, order: Ints) -> tuple[F32, F32]:
    """Misfit (P, T) and second differences (2, T) of an axis whose frame f is image order[f] (-1: none). An
    axis without bits is looked up from all frames at once; its second differences are set to 0."""
    source = order[table.frames]
    free = int(table.frames[np.argmin(source)]) if source.min() < 0 else -1
    pixels = 5 if table.axis.code is not None else 1
    some = levels[np.maximum(source, 0), :pixels].reshape(len(source), -1) / table.exposure[:, None]
    place = places(table, some, free)
    misfits = np.stack([misfit_at(table, some, one, free) for one in place])
    misfit = misfits.min(axis=0).reshape(pixels, -1)
    if pixels == 1:
        return misfit, np.zeros((2, misfit.shape[1]), np.float32)
    if table.axis.fringes:  # fringes determine an unknown bit
        place = np.take_along_axis(place, misfits.argmin(axis=0)[None], axis=0)
    return misfit, bends(place.reshape(len(place), 5, -1))


def _cost(misfit: F32, bend: F32, odd: float, rough: float) -> F32:
    """Cost (T,) of misfits (P, T) and second differences (2, T)."""
    beyond = np.maximum(bend / rough - _STEP, 0)
    both = (
        np.minimum(np.log1p(misfit / odd), _MOST).mean(axis=0),
        np.minimum(np.log1p(beyond**2), _MOST).sum(axis=0),
    )
    return np.asarray(both[0] + both[1], np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    """A tried fault and its reduction of the cost of pixels (T,); usual: number of pixels repaired without
    such a fault; tried: number of such faults."""

    finding: Finding
    gain: F32
    usual: int = 0
    tried: int = 1

    @property
    def mended(self) -> int:
        return int(np.count_nonzero(self.gain > _MENDED))

    @property
    def broken(self) -> int:
        return int(np.count_nonzero(self.gain < -_MENDED))

    @property
    def margin(self) -> float:
        return float(self.gain.sum())


def _single_fault(crosses: _Crosses, plan: Plan, rows: int, names: Ints) -> Finding | None:
    count, total = len(crosses.levels), crosses.own.sum(axis=0)
    odd: Mask = np.any(crosses.own > _ODD, axis=0)
    if np.count_nonzero(odd) < _LEAST:
        return None
    gains = np.stack([total - crosses.cost(_without(count, i)) for i in range(count)])
    costly = np.argsort(total)[len(total) // 2 :]
    some = crosses.only(costly[:: max(1, len(costly) // _FIRST)])
    told = _told(crosses, _used(plan))
    tried = sorted(_faults(names, _used(plan)), key=lambda fault: float(some.cost(fault[1]).sum()))
    swept = any(axis.stripes is not None for axis in plan.axes)
    trials = []
    for finding, order in tried[:_SECOND]:
        known, usual = np.zeros_like(total), 0
        if order.min() < 0 and not swept:  # subtract the gain of merely dropping a frame
            known = max(known, gains[np.argmin(order)], gains[-1], key=np.sum)
            usual = int(_ALL_LATER * len(total))
        near = finding.kind != "swapped" or finding.frames[1] - finding.frames[0] == 1
        gain = total - known - crosses.cost(order)
        finding = replace(finding, images=tuple(order.tolist()))
        trials.append(_Trial(finding, gain, usual, count if near else len(tried)))
    trials += _replacements(crosses, gains, told, rows, names)
    trials = [trial for trial in trials if _chance(trial) < _CHANCE and _explains(trial, odd)]
    trials = [t for t in trials if crosses.contradictions(plan, _order_of(t.finding, count)).worst < _MOST_OF]
    if not trials:
        return None
    best = max(trials, key=lambda trial: trial.margin * (_TIED if trial.finding.kind in _SHIFTED else 1))
    alike = [t for t in trials if t.margin >= _TIED * best.margin and t.finding.kind == best.finding.kind]
    found = _together([trial.finding for trial in alike], best.finding)
    if best.finding.kind not in _SHIFTED and np.mean(best.gain[odd] > _MENDED) < _PUT_BACK:
        found = replace(found, images=())
    return replace(
        found,
        confidence=1 - _chance(best),
        share=best.mended / len(total),
    )


def _order_of(finding: Finding, count: int) -> Ints:
    """Image of each frame under a finding."""
    order = np.array(finding.images or range(count))
    if not finding.images:
        order[list(finding.spoilt)] = -1
    return order


def _refused(crosses: _Crosses, plan: Plan) -> tuple[Finding, ...]:
    """Finding for all frames: most pixels contradict themselves, or another description explains them."""
    count = len(crosses.levels)
    found = crosses.contradictions(plan, np.arange(count))
    sentence = _stretched(crosses, plan)
    if not sentence and found.worst >= _SOME:
        left = {
            other.sentence: crosses.contradictions(other.plan, other.order).worst
            for other in other_descriptions(plan, count)
        }
        best = min(left, key=left.__getitem__)
        sentence = best if left[best] < _EXPLAINED * found.worst else ""
    if not sentence and found.in_pixel >= _MOST_OF:
        sentence = mistuned(plan, crosses.levels, crosses.contrast) or _NOT_THOSE
    if not sentence:
        return _in_part(crosses)
    return (Finding((), "contradicting", sentence, tuple(range(count)), share=max(found.worst, _MOST_OF)),)


def _rolled(crosses: _Crosses, rows: int) -> tuple[Finding, ...]:
    """Rolling shutter: from a row on every frame shows the one before. Places jump at that row, unless each
    frame is taken from the next image. For axes without other tests: sweeps and fringes without bits."""
    count, best = len(crosses.levels), (0, 0)
    odd = float(np.any(crosses.own > _ODD, axis=0).mean())
    later = np.append(np.arange(1, count), -1)
    for table in crosses.tables:
        if table.axis.code is not None or (table.axis.stripes is None and odd < _PART):
            continue
        here, next_ = (_centre_and_vertical(crosses, table, order) for order in (np.arange(count), later))
        apart = crosses.vertical
        upper, lower = np.concatenate([here[1], here[0]]), np.concatenate([here[0], here[2]])
        rolled = np.concatenate([next_[0], next_[2]])
        top = np.concatenate([crosses.at[0] - apart, crosses.at[0]])
        usual = _JUMP * float(np.median(np.abs(lower - upper))) + 1
        jumps = (np.abs(lower - upper) > usual).astype(int) - 2 * (np.abs(rolled - upper) > usual)
        for row in range(apart, rows - apart):
            across = (top < row) & (row <= top + apart)
            told = int(jumps[across].sum())
            if told > max(best[0], _LEAST, 0.6 * np.count_nonzero(across)):
                best = told, row
    if not best[0]:
        return ()
    start = best[1] - crosses.vertical
    sentence = f"from about row {best[1]} on every frame shows the one before: a rolling shutter, or no sync"
    spoilt = tuple(range(count))
    return (Finding((), "rolling", sentence, spoilt, (max(start, 0), rows), share=1 - start / rows),)


def _centre_and_vertical(crosses: _Crosses, table: AxisTable, order: Ints) -> F32:
    """Places (3, T) of pixels and of their neighbours above and below, if frame i is image order[i]."""
    source = order[table.frames]
    free = int(table.frames[np.argmin(source)]) if source.min() < 0 else -1
    levels = crosses.levels[np.maximum(source, 0)][:, [0, 3, 4]] / table.exposure[:, None, None]
    return np.asarray(places(table, levels.reshape(len(source), -1), free)[0].reshape(3, -1), np.float32)


def _in_part(crosses: _Crosses) -> tuple[Finding, ...]:
    """A part of the picture that no single fault explains. Dim pixels are excluded, as stray light alone
    makes their levels odd; so are axes of bits alone, which black and white test pixel by pixel."""
    if not any(table.axis.fringes for table in crosses.tables):
        return ()
    bright = crosses.only(crosses.contrast > _DIM * np.median(crosses.contrast))
    share = float(bright.strange.mean())
    if not _PART <= share < _MOST_OF:
        return ()
    near = cKDTree(bright.at.T).query(bright.at[:, bright.strange].T, _NEAREST + 1)[1][:, 1:]
    if bright.strange[near].mean() < _GATHERED:  # blurred bits and edges are all over the picture
        return ()
    row, col = np.median(bright.at[:, bright.strange], axis=1).astype(int)
    where = f"in part of the picture, around row {row} and column {col}"
    return (Finding((), "in part", f"frames do not fit their description {where}", share=share),)


def _stretched(crosses: _Crosses, plan: Plan) -> str:
    """A sentence if black is as bright as white."""
    if min(plan.white, plan.black) < 0:
        return ""
    apart = crosses.levels[plan.white, 0] - crosses.levels[plan.black, 0]
    alike = float(np.median(np.abs(apart) / crosses.contrast)) < _SAME
    return "black is as bright as white: every frame was stretched by itself (auto contrast)" if alike else ""


def _explains(trial: _Trial, odd: Mask) -> bool:
    """Whether a fault repairs more than half of the odd pixels beyond those at edges of a scene."""
    return bool(trial.mended - trial.broken > 0.5 * (np.count_nonzero(odd) - _EDGES * len(odd)))


def _together(findings: list[Finding], best: Finding) -> Finding:
    """Merge tied faults of one kind: images on which they agree."""
    images = np.array([one.images for one in findings])
    agreed = np.where((images == images[0]).all(axis=0), images[0], -1) if images.size else images
    return replace(
        best,
        frames=tuple(sorted({i for one in findings for i in one.frames})),
        spoilt=tuple(sorted({i for one in findings for i in one.spoilt})),
        sentence=" or ".join(list(dict.fromkeys(one.sentence for one in findings))[:4]),
        images=tuple(agreed.ravel().tolist()),
    )


def _without(count: int, frame: int) -> Ints:
    order = np.arange(count)
    order[frame] = -1
    return order


def _chance(trial: _Trial) -> float:
    """Probability that the excess of repaired pixels over broken ones (or over those repaired without a
    fault) is chance."""
    lost = max(trial.broken, trial.usual)
    if trial.mended < _LEAST or trial.mended < 2 * lost or trial.margin <= 0:
        return 1.0
    return min(1.0, 0.5 * trial.tried * erfc((trial.mended - lost) / sqrt(2 * (trial.mended + lost))))


def _used(plan: Plan) -> list[int]:
    """Numbers of the frames in a plan's tables, ascending."""
    return sorted({i for table in axis_tables(plan) for i in table.frames.tolist()})


def _faults(names: Ints, used: list[int]) -> Iterator[tuple[Finding, Ints]]:
    """Every fault that keeps images complete, and the image of each frame under it (-1: none); swaps are
    limited to frames in use."""
    count = len(names)
    for k, i in enumerate(used):
        for j in used[k + 1 : None if len(used) <= _ALL_PAIRS else k + 3]:
            order = np.arange(count)
            order[[i, j]] = j, i
            yield (
                Finding(
                    (i, j), "swapped", f"frames {names[i]} and {names[j]} are in each other's place", (i, j)
                ),
                order,
            )
    for k in range(count - 1):
        order = np.concatenate([np.arange(k), [-1], np.arange(k, count - 1)])
        told = f"frame {names[k]} is missing, those after it come one too early"
        yield Finding((k,), "lost", told, tuple(range(k, count))), order
    for k in range(1, count - 1):
        order = np.concatenate([np.arange(k), np.arange(k + 1, count), [-1]])
        told = f"frame {names[k - 1]} is there twice, those after it come one late"
        yield Finding((k,), "repeated", told, tuple(range(k, count))), order


def _told(crosses: _Crosses, used: list[int]) -> Mask:
    """Where frames (N, T) are clearly bright or dark."""
    centre = crosses.levels[:, 0]
    middle = centre[used].min(axis=0) + crosses.contrast
    return np.asarray(np.abs(centre - middle) > 0.5 * crosses.contrast)


def _replacements(crosses: _Crosses, gains: F32, told: Mask, rows: int, names: Ints) -> Iterator[_Trial]:
    """Frames replaced by another one, in all rows or beyond a tear. gains (N, T): of dropping each frame;
    told (N, T): where frames are clearly bright or dark, because blurred greys are all similar."""
    mended = np.count_nonzero(gains > _MENDED, axis=1)
    usual = int(np.median(np.maximum(mended - np.count_nonzero(gains < -_MENDED, axis=1), 0)))
    by_row, centre = np.argsort(crosses.at[0], kind="stable"), crosses.levels[:, 0]
    structured = np.ptp(crosses.levels, axis=1) > crosses.contrast
    for i in np.flatnonzero(mended >= max(usual, _LEAST)).tolist():
        sure = told[i] | told
        same = (np.abs(centre[i] - centre) < _SAME * crosses.contrast) & sure
        same[i] = False
        alike = same.sum(axis=1) / np.maximum(sure.sum(axis=1), 1)
        nearest = np.where(alike < _MOSTLY, np.inf, np.abs(centre[i] - centre).mean(axis=1))
        for j in (
            [int(nearest.argmin())] if alike.max() >= _MOSTLY else np.flatnonzero(same.any(axis=1)).tolist()
        ):
            some = by_row[sure[j, by_row]]
            row = crosses.at[0, some]
            for start, stop in _parts(same[j, some]):
                first, last = (int(row[start]) if start else 0), (int(row[stop]) if stop < len(row) else rows)
                if (first, last) == (0, rows):
                    sentence = f"frame {names[i]} is frame {names[j]} again"
                    finding = Finding((i,), "replaced", sentence, (i,))
                else:
                    torn = f"in rows {first} to {last - 1} it shows frame {names[j]}"
                    sentence = f"frame {names[i]} is torn: {torn}"
                    finding = Finding((i,), "torn", sentence, (i,), (first, last))
                part = some[start:stop]
                # two frames with structure everywhere are never equal in a real scene
                chance = 0 if structured[j, part].mean() > _STRUCTURED else usual
                ways = 4 if finding.rows else 1  # either side, and the row
                gain = np.zeros_like(gains[i])
                gain[part] = gains[i, part]
                yield _Trial(finding, gain, chance, ways * len(gains))


def _parts(same: Mask) -> Iterator[tuple[int, int]]:
    """Ranges of sorted pixels, from the first or to the last one, in which two frames are equal."""
    count = len(same)
    if same.mean() >= _MOSTLY:
        yield 0, count
        return
    for flipped in (False, True):
        run = same[::-1] if flipped else same
        score = np.cumsum(np.where(run, 1 - _MOSTLY, -_MOSTLY))
        length = int(np.argmax(score)) + 1
        if length >= 8 and score[length - 1] > 0:
            yield (count - length, count) if flipped else (0, length)
