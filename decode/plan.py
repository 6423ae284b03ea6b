"""From a sequence's descriptions to the structure for decoding: frames by axis, fringe and code."""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.kernels import F64
from optolever.patterns import BINARY_CODES, Frame, Packing, Sequence, code_words

__all__ = ["AxisPlan", "Code", "Fringe", "Plan", "Stripes", "constraints", "harmonics", "plan"]

#: Fewest places of a stripe along an axis.
_PLACES = 5


@dataclass(frozen=True, eq=False)
class Fringe:
    """Frames of one axis and period: I_i = A + c cos d_i + s sin d_i, phase = atan2(s, c). Its matrices
    are cached."""

    index: tuple[int, ...]
    period: float
    shifts: F64

    @cached_property
    def design(self) -> F64:
        """Model matrix (N, 3) of offset, c and s."""
        return np.stack([np.ones(len(self.shifts)), np.cos(self.shifts), np.sin(self.shifts)], axis=1)

    @cached_property
    def inverse(self) -> F64:
        """Offset, c and s (3, N) by least squares."""
        return np.asarray(np.linalg.pinv(self.design))

    @cached_property
    def unlike(self) -> F64:
        """Orthonormal combinations (N - 3, N) of samples that vanish for every fringe."""
        return np.ascontiguousarray(np.linalg.qr(self.design, mode="complete")[0][:, 3:].T)

    def harmonics(self, levels: F64) -> F64:
        """Terms (9, K) of harmonics() in samples (N, K)."""
        return harmonics(*self.inverse @ levels)

    def few(self) -> bool:
        """Whether there are fewer than three different shifts, too few for a phase."""
        return len(np.unique(np.round(np.mod(self.shifts, 2 * np.pi), 6))) < 3


def harmonics(offset: F64, c: F64, s: F64) -> F64:
    """Terms (9, K) of a smooth response's harmonics in fits (K,): 1, offset, amplitude, and the amplitude
    times cosine and sine of one to three times the phase."""
    wave, amplitude = c + 1j * s, np.hypot(c, s)
    unit = wave / np.maximum(amplitude, 1e-9)
    waves = wave, wave * unit, wave * unit * unit
    parts = [part for one in waves for part in (one.real, one.imag)]
    return np.stack([np.ones_like(offset), offset, amplitude, *parts])


@dataclass(frozen=True, slots=True, eq=False)
class Code:
    """Bits of one axis, least significant first; frame numbers, -1: the sequence lacks that polarity."""

    kind: str
    plain: NDArray[np.int64]
    inverse: NDArray[np.int64]
    cell: float
    origin: float
    cells: NDArray[np.int32]  # word -> cell

    def pairs(self) -> list[tuple[int, int]]:
        """Frames of the bits that have an inverse, and of it."""
        both = (self.plain >= 0) & (self.inverse >= 0)
        return list(zip(self.plain[both].tolist(), self.inverse[both].tolist(), strict=True))

    def centre(self, cell: NDArray[np.int32]) -> F64:
        """Coordinate of a cell's centre, pattern pixels."""
        return cell.astype(np.float64) * self.cell + (0.5 * (self.cell - 1) + self.origin)


@dataclass(frozen=True, slots=True)
class Stripes:
    """Frames of a line swept over one axis, in the order of its places; width at half maximum, pattern px."""

    index: NDArray[np.int64]
    at: F64
    width: float


@dataclass(frozen=True, slots=True)
class AxisPlan:
    """Description of one axis of `extent` pixels; fringes from coarse to fine.

    singles: fringes of one or two shifts, too few for a phase (micro phase shifting)
    """

    axis: str
    extent: int
    code: Code | None
    fringes: tuple[Fringe, ...]
    singles: tuple[Fringe, ...]
    stripes: Stripes | None
    levels: tuple[int, ...]

    @property
    def looked_up(self) -> bool:
        """Whether the axis is decoded by a look-up of known levels."""
        return bool(self.levels or self.singles) or self.stripes is not None

    def frames(self) -> tuple[int, ...]:
        """Numbers of all frames of this axis, ascending."""
        found = {i for fringe in (*self.fringes, *self.singles) for i in fringe.index} | set(self.levels)
        if self.code is not None:
            found |= {int(i) for i in (*self.code.plain, *self.code.inverse) if i >= 0}
        if self.stripes is not None:
            found |= {int(i) for i in self.stripes.index}
        return tuple(sorted(found))


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """All axes, the frames that serve both (-1: none), all frames, and the frames (E, channels) of each
    exposure. packing: of a capture in colour, None: grey."""

    axes: tuple[AxisPlan, ...]
    white: int
    black: int
    frames: tuple[Frame, ...]
    exposures: NDArray[np.int64]
    packing: Packing | None = None

    def times(self) -> F64:
        """Number (N,) of each frame's exposure; the mean of several."""
        shown = self.exposures.ravel()
        each = np.repeat(np.arange(len(self.exposures)), self.exposures.shape[1])
        return np.asarray(np.bincount(shown, each) / np.bincount(shown))

    def before(self, depth: int) -> F64:
        """(N, N): each frame's predecessor on its channel of the display, so many exposures before; the first
        one for those before it."""
        last = np.maximum(np.arange(len(self.exposures)) - depth, 0)
        found = np.zeros((len(self.frames),) * 2)
        np.add.at(found, (self.exposures.ravel(), self.exposures[last].ravel()), 1.0)
        return np.asarray(found / found.sum(axis=1, keepdims=True))


@lru_cache(maxsize=16)
def plan(sequence: Sequence) -> Plan:
    """Sort the frames by their descriptions; their order in the sequence does not matter.

    Cached: a series of captures has one plan.
    """
    frames = sequence.frames
    axes = tuple(
        found
        for axis, extent in (("u", sequence.cols), ("v", sequence.rows))
        if (found := _axis_plan(sequence, axis, extent)) is not None
    )
    if not axes:
        kinds = ", ".join(sorted({frame.kind for frame in frames}))
        raise InputError(
            f"sequence {sequence.name}: frames are {kinds}, none of them encodes u or v by itself "
            "(crossed frames are read by live)"
        )
    packing = sequence.packing
    shown = np.arange(len(frames))[:, None] if packing is None else np.array(packing.exposures)
    white, black = (_reference(sequence, kind) for kind in ("white", "black"))
    return Plan(axes, white, black, frames, shown, packing)


def _reference(sequence: Sequence, kind: str) -> int:
    """Number of the white (black) frame, -1 if there is none; an inverted black is a white."""
    other = "black" if kind == "white" else "white"
    for index, frame in enumerate(sequence.frames):
        if frame.kind == (other if frame.inverted else kind):
            return index
    return -1


def _axis_plan(sequence: Sequence, axis: str, extent: int) -> AxisPlan | None:
    mine = [(i, frame) for i, frame in enumerate(sequence.frames) if frame.axis == axis]
    code = _code(sequence, [i for i, frame in mine if frame.kind in BINARY_CODES], axis)
    fringes = _fringes(sequence, [i for i, frame in mine if frame.kind == "phase"])
    stripes = _stripes(sequence, [i for i, frame in mine if frame.kind == "stripe"], axis)
    levels = tuple(i for i, frame in mine if frame.kind == "levels")
    if code is None and not fringes and stripes is None and not levels:
        return None
    whole = tuple(fringe for fringe in fringes if not fringe.few())
    singles = tuple(fringe for fringe in fringes if fringe.few())
    return AxisPlan(axis, extent, code, whole, singles, stripes, levels)


def _code(sequence: Sequence, index: list[int], axis: str) -> Code | None:
    if not index:
        return None
    frames = [sequence.frames[i] for i in index]
    first = frames[0]
    for frame in frames:
        for name in ("kind", "cell_px", "offset_px"):
            if getattr(frame, name) != getattr(first, name):
                raise InputError(
                    f"sequence {sequence.name}: code on {axis} mixes {name} {getattr(first, name)!r} "
                    f"and {getattr(frame, name)!r}, must be one code"
                )
    bits = 1 + max(frame.bit or 0 for frame in frames)
    polarity = np.full((2, bits), -1, np.int64)
    for i, frame in zip(index, frames, strict=True):
        if polarity[int(frame.inverted), frame.bit or 0] >= 0:
            raise InputError(
                f"sequence {sequence.name}: bit {frame.bit} on {axis}"
                f"{' inverted' if frame.inverted else ''} is described twice"
            )
        polarity[int(frame.inverted), frame.bit or 0] = i
    missing = np.flatnonzero(polarity.max(axis=0) < 0)
    if len(missing):
        raise InputError(
            f"sequence {sequence.name}: bit {missing[0]} on {axis} is missing, code has {bits} bits"
        )
    words = code_words(first.kind, np.arange(1 << bits), bits)
    cells = np.empty(1 << bits, np.int32)
    cells[words] = np.arange(1 << bits)
    return Code(first.kind, polarity[0], polarity[1], first.cell_px, first.offset_px or 0.0, cells)


def _stripes(sequence: Sequence, index: list[int], axis: str) -> Stripes | None:
    if not index:
        return None
    place = np.array([getattr(sequence.frames[i], f"at_{axis}") for i in index], np.float64)
    order = np.argsort(place, kind="stable")
    widths = {sequence.frames[i].width_px or 1.0 for i in index}
    if len(place) < _PLACES or np.any(np.diff(place[order]) <= 0):
        raise InputError(
            f"sequence {sequence.name}: axis {axis} has {len(place)} stripes, "
            f"must have {_PLACES} or more at different places"
        )
    if len(widths) > 1:
        raise InputError(
            f"sequence {sequence.name}: stripes on {axis} are {sorted(widths)} px wide, must be alike"
        )
    return Stripes(np.array(index, np.int64)[order], place[order], widths.pop())


def _fringes(sequence: Sequence, index: list[int]) -> tuple[Fringe, ...]:
    groups: dict[float, list[int]] = {}
    for i in index:
        groups.setdefault(sequence.frames[i].period_px or 1.0, []).append(i)

    def shift(i: int) -> float:
        """Inversion adds half a turn."""
        return (sequence.frames[i].shift or 0.0) + (math.pi if sequence.frames[i].inverted else 0.0)

    found = []
    for period in sorted(groups, reverse=True):
        own = sorted(groups[period], key=shift)
        found.append(Fringe(tuple(own), period, np.array([shift(i) for i in own])))
    return tuple(found)


@lru_cache(maxsize=16)
def constraints(plan: Plan, count: int) -> tuple[F64, ...]:
    """Orthonormal combinations (C, count) of a pixel's samples that vanish at every place, by reliability.

    First those within one fringe (offset, c, s are free), then those within the pairs of bits and inverses
    (one sum), last all of them: fringes, pairs, white and black share one mean level. Everything else is
    free. Empty groups are omitted.
    """
    fringes = [fringe for axis in plan.axes for fringe in axis.fringes]
    pairs = [pair for axis in plan.axes if axis.code for pair in axis.code.pairs()]
    ends = [(plan.white, plan.black)] if plan.white >= 0 and plan.black >= 0 else []
    within = [row for fringe in fringes for row in _null_space([fringe], [], count)]
    groups = [within, _null_space([], pairs, count), _null_space(fringes, pairs + ends, count)]
    return tuple(np.asarray(group, np.float64) for group in groups if len(group))


def _null_space(fringes: list[Fringe], pairs: list[tuple[int, int]], count: int) -> list[F64]:
    """Rows (count,) orthogonal to: one mean level, c and s of each fringe, the difference of each pair."""
    used = [i for fringe in fringes for i in fringe.index] + [i for pair in pairs for i in pair]
    if not used:
        return []
    columns = [np.zeros(count)]
    for fringe in fringes:
        for part in fringe.design.T[1:]:
            columns.append(np.zeros(count))
            columns[-1][list(fringe.index)] = part
        columns[0][list(fringe.index)] = 1.0
    for plain, inverse in pairs:
        columns[0][[plain, inverse]] = 1.0
        columns.append(np.zeros(count))
        columns[-1][plain], columns[-1][inverse] = 1.0, -1.0
    model = np.stack(columns, axis=1)[used]
    free = np.linalg.qr(model, mode="complete")[0][:, np.linalg.matrix_rank(model) :]
    rows = np.zeros((free.shape[1], count))
    rows[:, used] = free.T
    return list(rows)
