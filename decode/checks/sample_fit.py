"""Per-pixel codeword fit of some pixels: places by each axis, and the residuals.

A pixel at place x has the levels A + B t_i(x) in frames i. Codes are read bit by bit, and fringes refine
their place; any other axis is looked up in a table of t by correlation. The misfit is the sum of squared
residuals over B^2; the roughness is the second difference of places between a pixel and its neighbours.
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..plan import AxisPlan, Fringe, Plan

__all__ = ["AxisTable", "ambiguous", "axis_tables", "bends", "bit_levels", "misfit_at", "places", "turns"]

F32 = NDArray[np.float32]
Ints = NDArray[np.int64]
#: Table entries per finest period: the phase error is a 32nd of a turn, 0.2 B, at most.
_PER_PERIOD = 16
#: Pixels per block of a look-up: their scores fit the cache.
_BLOCK = 256


@dataclass(frozen=True, slots=True, eq=False)
class AxisTable:
    """Codewords of the frames (n,) of an axis with white and black, at places (M,): shown (n, M), -1..1.

    exposure (n,): divisor of the levels.
    """

    axis: AxisPlan
    frames: Ints
    first: float
    step: float
    shown: F32
    exposure: F32
    references: tuple[int, ...]

    def entry(self, place: Any) -> Any:
        """Number of the table's entry nearest to places."""
        with np.errstate(invalid="ignore"):
            at = np.nan_to_num(np.rint((place - self.first) / self.step))
        return np.clip(at, 0, self.shown.shape[1] - 1).astype(np.int64)

    def place(self, entry: Any) -> Any:
        """Pattern pixels of an entry."""
        return entry * self.step + self.first


@lru_cache(maxsize=8)
def axis_tables(plan: Plan) -> tuple[AxisTable, ...]:
    """Tables of the axes whose levels follow from the plan: all but free levels."""
    return tuple(_axis_table(plan, axis) for axis in plan.axes if not axis.levels)


def _axis_table(plan: Plan, axis: AxisPlan) -> AxisTable:
    both = (plan.white, plan.black) if plan.white >= 0 and plan.black >= 0 else ()
    frames = np.array(sorted({*axis.frames(), *both}), np.int64)
    described = [plan.frames[i] for i in frames]
    step = min([1.0, *(fringe.period / _PER_PERIOD for fringe in (*axis.fringes, *axis.singles))])
    at = np.arange(-0.5 + step / 2, axis.extent - 0.5, step)
    levels = [frame.ideal_levels(at, "u" if frame.axis is None else axis.axis) for frame in described]
    shown = (np.stack(levels) / 127.5 - 1).astype(np.float32)
    exposure = np.array([frame.exposure for frame in described], np.float32)
    references = tuple(int(np.searchsorted(frames, i)) for i in both) or (-1, -1)
    return AxisTable(axis, frames, float(at[0]), step, shown, exposure, references)


def places(table: AxisTable, levels: F32, free: int = -1) -> F32:
    """Candidate places (A, K) of levels (n, K), pattern pixels: A = 2 if a bit is unknown.

    free: number of a frame to ignore (-1: none).
    """
    code, fringes = table.axis.code, table.axis.fringes
    if code is None:
        return _looked_up(table, levels, free)[None]
    reader, unknown = _reader(table, free)
    word = (1 << np.arange(len(reader))) @ (reader @ levels > 0)
    words = np.stack([word & ~unknown, word | unknown]) if unknown else word[None]
    found = code.centre(code.cells[words])
    for fringe in fringes:
        inverse = _phase_reader(table, fringe, free)
        if inverse is not None:
            cosine, sine = inverse @ levels
            turn = np.arctan2(sine, cosine) / (2 * np.pi) - found / fringe.period
            found = found + (turn - np.rint(turn)) * fringe.period
    return np.asarray(found, np.float32)


def bit_levels(table: AxisTable, levels: F32, free: int = -1) -> tuple[F32, F32]:
    """Signed differences (bits, K) of levels (n, K), above 0 where a bit is 1, and their scale (bits,): value
    at half of the levels' span, twice as large with an inverse."""
    code = table.axis.code
    assert code is not None
    both = (np.minimum(code.plain, code.inverse) >= 0) + np.float32(1)
    return np.asarray(_reader(table, free)[0] @ levels, np.float32), both


def ambiguous(table: AxisTable, free: int) -> bool:
    """Whether a bit is unknown without a frame."""
    return table.axis.code is not None and _reader(table, free)[1] > 0


def turns(table: AxisTable, fringe: Fringe, levels: F32, free: int = -1) -> NDArray[np.float64]:
    """Phase (K,) of levels (n, K), turns; NaN: too few frames."""
    inverse = _phase_reader(table, fringe, free)
    if inverse is None:
        return np.full(levels.shape[1], np.nan)
    cosine, sine = inverse @ levels
    return np.asarray(np.arctan2(sine, cosine) / (2 * np.pi), np.float64)


@lru_cache(maxsize=256)
def _reader(table: AxisTable, free: int) -> tuple[F32, int]:
    """Weights (bits, n) whose product with levels is above 0 where a bit is 1; mask of unknown bits."""
    code, known = table.axis.code, [int(i) for i in table.frames if i != free]
    assert code is not None
    both = [int(table.frames[k]) for k in table.references if k >= 0]
    # the mean level: that of white and black, else of all frames, in which pairs of bits cancel
    mean = np.isin(table.frames, both if both and free not in both else known).astype(np.float32)
    mean /= mean.sum()
    weights, unknown = np.zeros((len(code.plain), len(table.frames)), np.float32), 0
    for bit, pair in enumerate(zip(code.plain, code.inverse, strict=True)):
        shown = [sign * (table.frames == i) for sign, i in zip((1, -1), pair, strict=True) if i in known]
        unknown |= 0 if shown else 1 << bit
        if shown:
            weights[bit] = np.sum(shown, axis=0)
            weights[bit] -= weights[bit].sum() * mean
    return weights, unknown


@lru_cache(maxsize=256)
def _phase_reader(table: AxisTable, fringe: Fringe, free: int) -> F32 | None:
    """Weights (2, n) of cosine and sine; None: too few frames."""
    kept = [m for m, i in enumerate(fringe.index) if i != free]
    less = Fringe(
        tuple(fringe.index[m] for m in kept), fringe.period, fringe.shifts[kept], np.ones(len(kept))
    )
    if less.few():
        return None
    weights = np.zeros((2, len(table.frames)), np.float32)
    weights[:, np.searchsorted(table.frames, less.index)] = less.inverse[1:]
    return weights


def _looked_up(table: AxisTable, levels: F32, free: int) -> F32:
    """Places (K,) of the largest normalised correlation."""
    kept, shown, _ = _centred(table, free)
    own = levels[kept]
    own = own - own.mean(axis=0)
    best = np.empty(levels.shape[1], np.int64)
    for start in range(0, len(best), _BLOCK):
        some = slice(start, start + _BLOCK)
        best[some] = (own[:, some].T @ shown).argmax(axis=1)
    return np.asarray(table.place(best), np.float32)


@lru_cache(maxsize=64)
def _centred(table: AxisTable, free: int) -> tuple[Ints, F32, F32]:
    """Slots of the frames in use, their table without mean at unit length, and that length."""
    kept = np.flatnonzero(table.frames != free)
    shown = table.shown[kept] - table.shown[kept].mean(axis=0)
    length = np.maximum(np.linalg.norm(shown, axis=0), 1e-3).astype(np.float32)
    return kept, np.asarray(shown / length, np.float32), length


@lru_cache(maxsize=64)
def _in_part(table: AxisTable, free: int) -> NDArray[np.bool_]:
    """Slots and entries (n, M) of bits that flip within a cell: pixels may read a mixture."""
    code = table.axis.code
    bits: Any = () if code is None else np.concatenate([code.plain, code.inverse])
    at = table.place(np.arange(table.shown.shape[1]))
    before, after = (table.shown[:, table.entry(at + side)] for side in (-1, 1))
    flips = (before != after) & np.isin(table.frames, bits)[:, None]
    return np.asarray(flips[table.frames != free])


def misfit_at(table: AxisTable, levels: F32, place: Any, free: int = -1) -> F32:
    """Sum of squared residuals over B^2 (K,) of levels (n, K) at places (K,), without bits at an edge."""
    kept, shown, length = _centred(table, free)
    at = table.entry(place)
    own = levels[kept]
    own = own - own.mean(axis=0)
    along = np.einsum("nk,nk->k", own, shown[:, at])
    scale = np.maximum(along / length[at], 1e-3)
    left = np.square(own / scale - shown[:, at] * length[at])
    return np.asarray(np.where(_in_part(table, free)[:, at], 0, left).sum(axis=0))


def bends(place: F32) -> F32:
    """Second differences (2, T), rows and columns, of places (A, 5, T) of a pixel and its neighbours (-x, +x,
    -y, +y): the least magnitude over the A candidates."""
    centre, others = place[:, 0], place[:, 1:]
    least = np.full((2, place.shape[2]), np.inf, np.float32)
    for one, middle, two in product(range(len(place)), repeat=3):
        for line in range(2):
            bend = others[one, 2 * line] - 2 * centre[middle] + others[two, 2 * line + 1]
            least[line] = np.minimum(least[line], np.abs(bend))
    return least
