"""Wrong frames by a score of small blocks of the image: plain decoding under every swap, loss and repetition,
and under other descriptions. The order of most good and smooth pixels is taken, and named.

A test is a share of pixels, 1 in a right capture: of an axis, those whose bits are decided, whose fringes are
sinusoids and whose place continues its neighbours'; of a bit, the same at its edges (a coarse bit has few, so
blocks are chosen at them); of a fringe, the mean phasor of its phase against the coarser place; of white and
black, those in which white is brighter. The search compares sums of 1 - test. It sees neither a mirrored
display nor a fault in bits that are constant over the image.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import combinations, product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.kernels import F32
from optolever.patterns import BINARY_CODES, Frame, Sequence

from .plan import AxisPlan, Code, Fringe, Plan, plan

__all__ = ["Repair", "find_order"]

Mask = NDArray[np.bool_]
Order = NDArray[np.int64]
#: Blocks of the search, side of one, pixels.
_BLOCKS, _SIDE = 36, 10
#: Places at which blocks may lie; pixels by which two frames count as the same.
_SEEN, _COMPARED = 3000, 400
#: Sum of 1 - test that starts the search, and least gain (right captures: 0.35 where bits are resolved).
_POOR = 0.6
_EXCHANGED = "u and v are exchanged"
#: Most that a repair leaves: a picture too many in front of a real capture leaves 1.06, a wrong offset 2.6.
_MOST = 1.6
#: Finest bits without which a place is still worth its pixel: the rounding of coarser cells is no noise.
_FINE = 2
#: Median residual of a fringe over its amplitude, at most.
_SINE = 0.3
#: Penalty of a test without pixels; of a lost frame.
_NONE, _LOST = 0.05, 0.1
#: Share of the unrepaired sum, and most of it, by which equal repairs differ; most of them that are compared.
_EQUAL, _LITTLE, _OTHERS = 0.1, 0.25, 3


class Repair(NamedTuple):
    """name, cure: for the notice; order (N',): captured frame of each image of `sequence`, which fits.
    solved: False where the code needs an image that no frame shows, or the order is open: no pixel is
    good. others: repairs that explain the frames as well, at other places of some pixels."""

    name: str
    cure: str
    order: Order
    sequence: Sequence
    solved: bool = True
    others: tuple[Repair, ...] = ()


class _Trial(NamedTuple):
    """order (N,): captured frame of each image; frames: wrong ones; free: image that no frame shows, -1:
    none."""

    name: str
    order: Order
    sequence: Sequence
    frames: tuple[int, ...] = ()
    free: int = -1

    @property
    def in_place(self) -> bool:
        """Whether one image is lost, and all others are in their places."""
        return self.free >= 0 and bool((np.diff(self.order) == 1).all())


def find_order(frames: NDArray[Any], sequence: Sequence, mask: Mask | None = None) -> Repair | None:
    """frames (N, H, W). None: they are as described, or no other order explains them better."""
    known = plan(sequence)
    blocks = _blocks(frames, mask) if any(a.code is not None or a.fringes for a in known.axes) else None
    if blocks is None:
        return None
    same = _Trial("", np.arange(len(blocks)), sequence)
    base = _missing(blocks, same)
    dead = _dead(blocks, sequence)
    strange = [k for k in np.flatnonzero(dead).tolist() if _strange(blocks, known, k)]
    if len(strange) != 1 and base.sum() <= _POOR / 3:
        return None
    faults, ends = list(_faults(sequence)), tuple(sorted((known.white, known.black)))
    alone = {trial.free: trial for trial in faults if trial.in_place}
    lost = _repair(alone[strange[0]]) if len(strange) == 1 else None
    if base.sum() < _POOR:
        if lost is not None:
            return lost
        likely = [trial for trial in faults if trial.in_place and dead[trial.free]]
        likely += [trial for trial in _descriptions(sequence) if trial.name == _EXCHANGED]
        tried = [(_cost(blocks, trial, base), trial) for trial in likely]
        cost, found = min(tried, key=lambda one: one[0], default=(np.inf, same))
        return _repair(found) if cost < min(0.55 * base.sum(), base.sum() - _POOR / 3) else None
    if ends[0] >= 0 and base[:-1].sum() < _POOR:
        darker = next(trial for trial in faults if trial.frames == ends)
        if _missing(blocks, darker).sum() < _POOR:
            name = "white is darker than black on most lit pixels: exchanged"
            return _repair(darker._replace(name=name))
    few, trials = blocks[:, ::3], [*faults, *_descriptions(sequence)]
    rough = _missing(few, same)
    first = np.argsort([_missing(few, trial, rough).sum() for trial in trials], kind="stable")[:24]
    costs = np.array([_cost(blocks, trials[i], base) for i in first])
    free = np.array([trials[i].free for i in first])
    freed = {
        k: _missing(blocks, alone[k], base).sum() - _LOST
        for k in set(free[free >= 0].tolist())
        if not dead[k]
    }
    # what a lost image alone gains is no order: a picture that no other one shows is hardly in its place
    alive = np.array([cost > freed.get(int(k), np.inf) for cost, k in zip(costs, free, strict=True)])
    # share that remains: in right captures of poor phones .65 to .83, in faults below .55
    best = np.argmin(costs + alive)
    if costs[best] > min((0.3 if alive[best] else 0.55) * base.sum(), base.sum() - _POOR, _MOST):
        return lost
    costs += alive
    equals = [trials[int(i)] for i in sorted(first[costs <= costs.min() + 0.02])]
    # three steps that are left of four agree with any order: one that all four confirm is likelier
    found, *equal = sorted(equals, key=lambda one: not _confirmed(blocks, one))
    if not found.frames:
        if not _elsewhere(blocks, found, equal):
            return _repair(found)
        # u before v and v before u look the same: the usual one
        cure = "decoded so; the other axis first fits as well: check u and v, or correct capture.toml"
        return _repair(found)._replace(cure=cure)
    most = costs.min() + min(_EQUAL * base.sum(), _LITTLE)
    near = [trials[int(i)] for i in first[costs <= most]]
    others = _elsewhere(blocks, found, [one for one in near if one.frames and one is not found])
    if not others:
        return _repair(found)
    names = ", or ".join(one.name for one in (found, *others[:_OTHERS]))
    if len(others) > _OTHERS:
        return Repair(
            names, "other orders explain the frames as well; capture again", found.order, sequence, False
        )
    cure = "both explain the frames: no coordinates where they differ; capture again"
    return _repair(found)._replace(name=names, cure=cure, others=tuple(map(_repair, others)))


def _confirmed(blocks: F32, trial: _Trial) -> bool:
    """Whether every image is shown, and all steps of each fringe lie on a sinusoid."""
    some = blocks[trial.order]
    fits = [_fringe(some, one, -1) for axis in plan(trial.sequence).axes for one in axis.fringes]
    return trial.free < 0 and all(fit is not None and np.median(fit[3]) < _SINE for fit in fits)


def _elsewhere(blocks: F32, found: _Trial, trials: list[_Trial]) -> list[_Trial]:
    """Trials that place more than a hundredth of the pixels elsewhere."""
    places = _axes(blocks, found)
    return [
        trial
        for trial in trials
        if any(
            np.mean(np.abs(mine - other) > np.maximum(step, beside)) > 0.01
            for (_, mine, step), (_, other, beside) in zip(places, _axes(blocks, trial), strict=True)
        )
    ]


def _dead(blocks: F32, sequence: Sequence) -> Mask:
    """Frames (N,) that show the same as another one, or of a code or fringe nothing but black or white."""
    flat = blocks.reshape(len(blocks), -1)
    order = np.sort(flat, axis=0)
    low, high = (
        np.where(flat > order[0], order[0], order[1]),
        np.where(flat < order[-1], order[-1], order[-2]),
    )
    share = (flat - low) / np.maximum(high - low, 1)
    flat = (flat - order[0]) / np.maximum(order[-1] - order[0], 1)
    constant = np.maximum((share < 0.1).mean(axis=1), (share > 0.9).mean(axis=1)) > 0.95
    coded = np.array([frame.axis is not None for frame in sequence.frames])
    few = flat[:, :: max(1, flat.shape[1] // _COMPARED)]
    same = np.stack([(np.abs(one - few) < 0.1).mean(axis=1) > 0.95 for one in few])
    alike = same.sum(axis=1) > 1  # itself, and another one
    return np.asarray(constant & coded | alike, np.bool_)


def _strange(blocks: F32, known: Plan, k: int) -> bool:
    """Whether frame k of a fringe is half of the amplitude off its other frames' fit."""
    for fringe in (one for axis in known.axes for one in axis.fringes if k in one.index):
        if (fit := _fringe(blocks, fringe, k)) is not None:
            turn, amplitude, offset, _ = fit
            shift = np.float32(fringe.shifts[fringe.index.index(k)])
            off = blocks[k] - offset - amplitude * np.cos(2 * np.pi * turn - shift)
            return bool(np.median(np.abs(off)) > 0.5 * np.median(amplitude))
    return False


def _cost(blocks: F32, trial: _Trial, base: NDArray[np.float64]) -> float:
    """Of a trial; an image that no frame shows loses its tests: a swap is likelier."""
    return float(_missing(blocks, trial, base).sum()) + (_LOST if trial.in_place else 0.0)


def _blocks(frames: NDArray[Any], mask: Mask | None) -> F32 | None:
    """Lit blocks (N, B, side, side); for every frame some in which it has an edge, the rarest edges first."""
    half, step, rng = _SIDE // 2, _SIDE // 2 - 1, np.random.default_rng(0)
    stride = max(4, int((frames[0].size / _SEEN) ** 0.5))
    low = frames[:, half : frames.shape[1] - half : stride, half : frames.shape[2] - half : stride].astype(
        np.float32
    )
    if 0 in low.shape:
        return None
    span = np.ptp(low, axis=0)
    lit = span > 0.4 * np.quantile(span, 0.95)
    if mask is not None:
        lit &= mask[half : mask.shape[0] - half : stride, half : mask.shape[1] - half : stride]
    corners = [(y, x) for y in (half - step, half + step) for x in (half - step, half + step)]
    around = [frames[:, y::stride, x::stride][:, : low.shape[1], : low.shape[2]] for y, x in corners]
    edges = (np.max(around, axis=0).astype(np.float32) - np.min(around, axis=0) > 0.5 * span) & lit
    chosen: list[tuple[int, int]] = []
    for edge in sorted(edges, key=np.count_nonzero):
        more = 2 - sum(bool(edge[at]) for at in chosen)
        chosen += [(int(y), int(x)) for y, x in rng.permutation(np.argwhere(edge))[: max(more, 0)]]
    chosen = chosen[:_BLOCKS]
    chosen += [(int(y), int(x)) for y, x in rng.permutation(np.argwhere(lit))[: _BLOCKS - len(chosen)]]
    if not chosen:
        return None
    cut = [
        frames[:, stride * y : stride * y + _SIDE, stride * x : stride * x + _SIDE]
        for y, x in rng.permutation(chosen)
    ]
    return np.stack(cut, axis=1).astype(np.float32)


def _missing(blocks: F32, trial: _Trial, base: Any = _NONE) -> NDArray[np.float64]:
    """1 - test of all tests; without pixels half as much as in the base."""
    try:
        known = plan(trial.sequence)
    except InputError:
        return np.array([np.inf])
    tests = [axis[0] for axis in _axes(blocks, trial)]
    ends = [known.white, known.black]
    if min(ends) >= 0:
        white, black = blocks[trial.order[ends]]
        bright = np.mean(white - black > 0.25 * np.ptp(blocks, axis=0))
        tests.append(np.array([np.nan if trial.free in ends else bright]))
    one = np.concatenate(tests)
    if np.shape(base):
        lost = np.isposinf(one).sum()
        one = one[~np.isposinf(one)]
        if lost:
            return np.append(np.where(np.isnan(one), _NONE, 1 - one), [max(base.max(), _NONE)] * lost)
    unknown = np.maximum(0.5 * base, _NONE) if np.shape(base) == one.shape else _NONE
    return np.where(np.isnan(one), unknown, 1 - one)


def _axes(blocks: F32, trial: _Trial) -> list[tuple[NDArray[np.float64], F32, F32]]:
    known, some = plan(trial.sequence), blocks[trial.order]
    axes = [a for a in known.axes if (a.code is not None or a.fringes) and not a.looked_up]
    return [_tests(some, axis, known, trial.free) for axis in axes]


def _tests(blocks: F32, axis: AxisPlan, known: Plan, free: int) -> tuple[NDArray[np.float64], F32, F32]:
    """Tests of an axis: of the axis, twice; of each bit and each finer fringe, NaN: too few pixels. Places
    (B, side, side), and the difference of unequal ones, pattern px."""
    fits = [(f.period, *fit) for f in axis.fringes if (fit := _fringe(blocks, f, free)) is not None]
    gone = len(axis.fringes) - len(fits)
    ok: Mask = np.ones(blocks.shape[1:], np.bool_)
    for *_, residual in fits:
        ok &= residual < 0.7  # gamma 2.2: .57
    width: Any = np.zeros(blocks.shape[1:], np.float32)
    phasors, coded = [], ok[None, :, 1:-1, 1:-1]
    edges: list[Mask] = []
    if axis.code is not None:
        place, width, decided, edges = _word_place(blocks, axis.code, known, fits[0] if fits else None, free)
        ok &= decided & (width <= max(8 * axis.code.cell, axis.extent / 16))
        coded = _smooth(place, np.broadcast_to(3 * width, place.shape), 0.5) & ok[:, 1:-1, 1:-1]
    elif not fits:
        return np.zeros(2), width, width
    else:
        place = _ladder_place(fits, axis.extent)[None]
    good, step = coded, 2 * width + (0.25 * fits[-1][0] if fits else 0.0)
    for period, turn, _, _, _ in fits:
        gap = turn - place / period
        use = (width < 0.75 * period) & ok
        if axis.code is not None or period < fits[0][0]:
            mean = np.cos(2 * np.pi * gap) / np.sinc(np.minimum(width / period, 0.75))
            share = (mean * use).sum(axis=(2, 3)).max(axis=0).sum() / max(use.sum(), 1)
            phasors.append(min(share, 1.0) if use.mean() > 0.2 else np.nan if ok.mean() > 0.2 else 0.0)
        place, width = period * (turn - np.rint(gap)), np.zeros_like(width)
        good = _smooth(place, 0.25 * period, 0.25) & ok[:, 1:-1, 1:-1]
    inner = place[..., 1:-1, 1:-1]
    good = good & (inner > -0.02 * axis.extent - 1) & (inner < 1.02 * axis.extent)
    better = good.mean(axis=(2, 3)).argmax(axis=0), np.arange(blocks.shape[1])
    share, coded = float(good[better].mean()), coded[better]
    at_edges = [coded[edge].mean() if np.count_nonzero(edge) >= 8 else np.nan for edge in edges]
    # a test that a trial takes away is not passed by it
    return np.array([share, share, *phasors, *at_edges, *[np.inf] * gone]), place[better], step


def _fringe(blocks: F32, fringe: Fringe, free: int) -> tuple[F32, F32, F32, F32] | None:
    """Phase (turns), amplitude, offset, residual over amplitude; None: less than three samples."""
    keep = [k for k, i in enumerate(fringe.index) if i != free]
    if len(keep) < 3:
        return None
    design, levels = fringe.design[keep].astype(np.float32), blocks[[fringe.index[k] for k in keep]]
    fit = np.tensordot(np.linalg.pinv(design), levels, 1)
    amplitude = np.hypot(fit[1], fit[2]) + np.float32(1e-3)
    square = np.square(levels - np.tensordot(design, fit, 1)).sum(axis=0) / max(len(keep) - 3, 1)
    residual = np.sqrt(square) / amplitude if len(keep) > 3 else np.zeros_like(amplitude)
    return np.arctan2(fit[2], fit[1]) / np.float32(2 * np.pi), amplitude, fit[0], residual


def _word_place(
    blocks: F32, code: Code, known: Plan, fit: tuple[Any, ...] | None, free: int
) -> tuple[F32, F32, Mask, list[Mask]]:
    """Place (1 or 2, B, side, side), of both values of an unknown bit; width of its interval, pattern px;
    whether all but the finest bits are decided; inner pixels at the edges of each bit."""
    ends = [known.white, known.black]
    used = [i for i in (*code.plain, *code.inverse) if i >= 0 and i != free]
    high, low = blocks[used].max(axis=0), blocks[used].min(axis=0)
    middle, half = 0.5 * (high + low), np.maximum(0.5 * (high - low), 1)
    if min(ends) >= 0 and free not in ends:
        middle = 0.5 * (blocks[known.white] + blocks[known.black])
    elif fit is not None:
        middle = fit[3]
    pairs = [[-1 if i == free else i for i in pair] for pair in zip(code.plain, code.inverse, strict=True)]
    unknown = [b for b, pair in enumerate(pairs) if max(pair) < 0]

    def bright(i: int, j: int) -> F32:
        """Level of a bit beyond its middle, by its frame, that of its inverse, or both."""
        if min(i, j) >= 0:
            return np.asarray((blocks[i] - blocks[j]) / 2)
        return np.asarray(blocks[i] - middle if i >= 0 else middle - blocks[j])

    levels = np.stack([bright(i, j) for i, j in pairs])
    levels[unknown] = half
    bits, opened = np.arange(len(pairs))[:, None, None, None], np.abs(levels) < 0.25 * half
    run = np.zeros(half.shape, np.int64)
    together = code.kind == "binary"  # several bits change between adjacent cells; in Gray codes one does
    for b in range(0 if together else len(pairs)):
        run += (run == b) & opened[b]
    fine = bool(unknown) and unknown[0] <= 2  # coarser ones are constant in most blocks
    run = np.maximum(run, unknown[0] + 1) if fine else run
    decided = (opened & (bits >= run)).sum(axis=0) <= (3 if together else 1)
    word = ((levels > 0) << bits).sum(axis=0)
    words = np.stack([word, word ^ (1 << unknown[0])]) if unknown and not fine else word[None]
    finest = (1 << run) - 1
    cell = np.minimum(code.cells[words & ~finest], code.cells[words | finest]) >> run << run
    width = np.asarray((1 << run) * code.cell, np.float32)
    edges, lit = [], (half > 0.25 * np.quantile(half, 0.9))[:, 1:-1, 1:-1]  # noise has edges, too
    for b, bit in enumerate(levels > 0):
        beside = bit[:, 1:-1, 2:], bit[:, 1:-1, :-2], bit[:, 2:, 1:-1], bit[:, :-2, 1:-1]
        edge = np.any([bit[:, 1:-1, 1:-1] != one for one in beside], axis=0) & (run <= b)[:, 1:-1, 1:-1] & lit
        # an unknown one is no fault of the order that leaves it out
        edges.append(edge | (fine and b <= unknown[0]))
    return np.asarray(cell * code.cell + 0.5 * (width - 1) + code.origin, np.float32), width, decided, edges


def _ladder_place(fits: list[Any], extent: int) -> F32:
    """Place by the coarsest fringe; its order is that which the others confirm best."""
    period, turn = fits[0][:2]
    place = np.asarray(np.mod(turn + 0.5 / period, 1) * period - 0.5, np.float32)
    if period >= extent or len(fits) == 1:
        return place
    best, cost = place, np.full(place.shape, np.inf, np.float32)
    for order in range(int(np.ceil(extent / period))):
        tried = place + np.float32(order * period)
        gaps = [other[1] - tried / other[0] for other in fits[1:]]
        square = sum(np.square(gap - np.rint(gap)) for gap in gaps)
        best, cost = np.where(square < cost, tried, best), np.minimum(square, cost)
    return best


def _smooth(place: F32, slack: Any, share: float) -> Mask:
    """Inner pixels whose second differences are below slack and a share of the first differences."""
    good: Any = True
    for axis in (2, 3):
        first = np.abs(step := np.diff(place, axis=axis))
        a, b = (np.delete(first, end, axis) for end in (-1, 0))
        rough = np.abs(np.diff(step, axis=axis)) - share * (a + b)
        cut = (..., slice(None), slice(1, -1)) if axis == 2 else (..., slice(1, -1), slice(None))
        good = good & (rough[cut] <= (slack[..., 1:-1, 1:-1] if np.ndim(slack) else slack))
    return np.asarray(good, np.bool_)


def _faults(sequence: Sequence) -> Iterator[_Trial]:
    """Single faults of frames, the simplest first."""
    count = len(sequence)
    same = np.arange(count)
    yield _Trial("picture 0 is one too many", np.append(same[1:], count - 1), sequence, (0,), count - 1)
    for k in range(count - 1):
        late, early = same.copy(), same.copy()
        late[k + 1 :], early[k + 1 : -1] = late[k:-1], early[k + 2 :]
        yield _Trial(f"frame {k} is missing, later ones are one early", late, sequence, (k,), k)
        if k < count - 2:
            name = f"frame {k} is there twice, later ones are one late"
            yield _Trial(name, early, sequence, (k + 1,), count - 1)
    for i, j in combinations(range(count), 2):
        order = same.copy()
        order[[i, j]] = j, i
        yield _Trial(f"frames {i} and {j} are in each other's place", order, sequence, (i, j))
    for k in range(count):
        yield _Trial(f"frame {k} is missing, another image is in its place", same, sequence, (k,), k)


def _descriptions(sequence: Sequence) -> Iterator[_Trial]:
    """Descriptions that are often mistaken for the right one; orders of the images in a folder."""
    same, frames = np.arange(len(sequence)), sequence.frames
    yield _Trial("the frames are in reverse order", same[::-1].copy(), sequence)
    names = sorted(range(len(frames)), key=str)
    yield _Trial("the frames are in the alphabetical order of their numbers", np.argsort(names), sequence)
    last = {axis: max((f.bit or 0 for f in frames if f.axis == axis), default=0) for axis in ("u", "v")}
    other = {"gray": "binary", "binary": "gray"}
    changes: list[tuple[str, tuple[str, ...], Callable[[Frame], dict[str, Any]]]] = [
        ("bits are inverted", BINARY_CODES, lambda f: {"inverted": not f.inverted}),
        ("bits are in reverse order", BINARY_CODES, lambda f: {"bit": last[f.axis or "u"] - (f.bit or 0)}),
        ("binary and Gray bits are exchanged", tuple(other), lambda f: {"kind": other[f.kind]}),
        ("fringes have shifts of the other sign", ("phase",), lambda f: {"shift": -(f.shift or 0.0)}),
        *(
            (
                f"fringes are {name} for a cosine",
                ("phase",),
                lambda f, by=by: {"shift": (f.shift or 0.0) + by},
            )
            for name, by in (("a sine", -np.pi / 2), ("a negative sine", np.pi / 2))
        ),
        (_EXCHANGED, (*BINARY_CODES, "phase"), lambda f: {"axis": "uv".replace(f.axis or "", "")}),
    ]
    kinds = {f.kind for f in frames}
    if kinds & set(BINARY_CODES) and "phase" in kinds:  # else unseen
        size = next(f.cell_px for f in frames if f.kind in BINARY_CODES)
        for by, how in ((0.5, "half"), (2.0, "twice")):
            by_cell = lambda f, by=by: {"cell_px": f.cell_px * by}  # noqa: E731
            by_period = lambda f, by=by: {"period_px": (f.period_px or 1.0) * by}  # noqa: E731
            changes += [(f"cells are {how} as large, {by * size:.3g} px", BINARY_CODES, by_cell)]
            changes += [(f"periods are {how} as large", ("phase",), by_period)]
    for name, of, change in changes:
        if kinds & set(of):
            changed = tuple(replace(f, **change(f)) if f.kind in of else f for f in frames)
            yield _Trial(name, same, replace(sequence, frames=changed))
    ends = [("white", "black"), ("black", "white")]
    axes = {"u before v": "uv", "v before u": "vu", "u and v in turns": ""}
    pairs = ["", ", inverses first", ", all inverses after all bits"]
    for end, axis, sign, pair, first in product(ends, axes, (-1, 1), range(3), (0, 9)):

        def key(
            i: int, end: Any = end, axis: str = axis, sign: int = sign, pair: int = pair, at: int = first
        ) -> Any:
            f = frames[i]
            if f.kind in end:
                return at, end.index(f.kind)
            bit, polarity = sign * (f.bit or 0), f.inverted != (pair == 1)
            fringe = f.kind == "phase"
            place = (polarity, bit) if pair == 2 else (bit, polarity)
            return 5, axes[axis].find(f.axis or ""), fringe, -(f.period_px or 0), not fringe and place, i

        order = np.argsort(sorted(range(len(frames)), key=key))
        parts = [" and ".join(end) + (" last" if first else " first"), axis]
        parts.append(("coarse" if sign < 0 else "fine") + " bits first" + pairs[pair])
        yield _Trial("the frames are in another order: " + ", ".join(parts), order, sequence)


def _repair(found: _Trial) -> Repair:
    """Leave out an image that no frame shows, with its fringe, or with the finer bits if need be."""
    sequence, cure = found.sequence, "decoded in the right order; correct capture.toml, or capture again"
    if found.free < 0:
        return Repair(found.name, cure, found.order, sequence)
    axes, lost, every = plan(sequence).axes, sequence.frames[found.free], range(len(sequence))
    own = [{*f.index} for axis in axes for f in (*axis.fringes, *axis.singles) if found.free in f.index]
    for drop in ({found.free}, *own):
        keep = [i for i in every if i not in drop]
        less = replace(sequence, frames=tuple(sequence.frames[i] for i in keep))
        if _decodable(axes, less):
            return Repair(found.name, "decoded without it; capture again", found.order[keep], less)
    fine = lost.kind in ("gray", "binary") and (lost.bit or 0) < _FINE
    coarser = [_coarser(frame, lost) if fine else None for frame in sequence.frames]
    left = tuple(frame for frame in coarser if frame is not None)
    if any(frame.kind == lost.kind and frame.axis == lost.axis for frame in left):
        keep = [i for i in every if coarser[i] is not None]
        cure = f"decoded without it, {lost.axis} by coarser bits alone; capture again"
        return Repair(found.name, cure, found.order[keep], replace(sequence, frames=left))
    return Repair(found.name, "this code needs it; capture again", found.order, sequence, solved=False)


def _coarser(frame: Frame, lost: Frame) -> Frame | None:
    """A frame of the code without a bit and all finer ones; None: it goes."""
    finer = 1 + (lost.bit or 0)
    cell = lost.cell_px * 2**finer
    if frame.axis != lost.axis or (frame.kind == "phase" and (frame.period_px or 0) >= cell):
        return frame
    if frame.kind != lost.kind or (frame.bit or 0) < finer:
        return None
    return replace(frame, bit=(frame.bit or 0) - finer, cell_px=cell)


def _decodable(before: tuple[AxisPlan, ...], less: Sequence) -> bool:
    """Whether all axes still have absolute places."""
    try:
        axes = plan(less).axes
    except InputError:
        return False
    whole = [a.code is not None or bool(a.fringes and a.fringes[0].period >= a.extent) for a in axes]
    same = [[(len(a.singles), a.code is None or len(a.code.plain)) for a in some] for some in (before, axes)]
    return all(whole) and same[0] == same[1]
