"""After a refusal, and only when asked: mistakes of an order or a description that explain the frames.

Every hypothesis is one order of the pictures and one description; blocks of the image say how well it fits.
They are ranked by what they leave unexplained. Nothing is decoded by them: the user reads a description, and
decodes by it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optolever.errors import InputError
from optolever.kernels import F32
from optolever.patterns import BINARY_CODES, Frame, Sequence

from ..frames import in_levels
from ..plan import plan
from .blocks import Trial, blocks_of, cut, fits_of, plain_decode, shortfall, word_places
from .without import without

__all__ = ["Mistake", "explain"]

#: Least share of placed pixels; how much less than the best it may be; how much more may be unexplained.
_PLACED, _LESS, _NEAR = 0.6, 0.1, 0.25
#: Beside the description: pixels that a mistake without an image places, fit that another gains. Right
#: captures of 7 codes in 9 lights have .002 and .016 at most, wrong ones .018 and .043 at least.
_MORE, _FITS = 0.01, 0.03
#: Names; hypotheses that are tried on all blocks; penalty of a lost image: a swap is likelier.
_NAMES, _TRIED, _LOST = 3, 24, 0.1
#: Sizes of cells over the described ones; shift of fringes against bits, periods, and its phasor, at least.
_SIZES = (0.5, 2 / 3, 0.75, 0.8, 1.0, 1.25, 4 / 3, 1.5, 2.0)
_SHIFT, _COHERENT = 0.04, 0.5
_EARLY = "picture 0 is one too many, or every picture shows the image before"
_MIXED = "every picture is half of the image before: the camera exposes while the display changes"
_TORN = "pictures are torn, part of each shows the image before: the camera exposes while the display changes"
#: Fields of a frame that change.
_Change = Callable[[Frame], dict[str, Any]]


@dataclass(frozen=True, slots=True)
class Mistake:
    """name: a sentence; share of the pixels that it places; pictures: numbers of the captured ones that are
    used, in order, and `sequence`, their description; none: capture again."""

    name: str
    share: float
    pictures: tuple[int, ...] = ()
    sequence: Sequence | None = None


def explain(frames: ArrayLike, sequence: Sequence, *, mask: ArrayLike | None = None) -> tuple[Mistake, ...]:
    """Up to three mistakes that explain frames (N, H, W) better than their description does, the likeliest
    first; mask (H, W): pixels to look at. InputError if frames and sequence do not fit."""
    levels = in_levels(frames).frames
    if levels.ndim != 3 or len(levels) != len(sequence):
        raise InputError(f"explain: {len(levels)} frames, sequence {sequence.name} describes {len(sequence)}")
    at = blocks_of(levels, None if mask is None else np.asarray(mask, np.bool_))
    if at is None or all(axis.looked_up for axis in plan(sequence).axes):
        return ()
    blocks = cut(levels, at).astype(np.float32)
    same = Trial("", np.arange(len(levels)), sequence)
    trials = [*_faults(sequence), *_descriptions(sequence), *_shifts(blocks, sequence)]
    base, few = shortfall(blocks, same), blocks[:, ::3]
    rough = shortfall(few, same)
    first = np.argsort([shortfall(few, one, rough).sum() for one in trials], kind="stable")[:_TRIED]
    placed = _placed(blocks, same)
    tried = [(_cost(blocks, trials[i], base), _placed(blocks, trials[i]), trials[i]) for i in first]
    better = [
        one for one in (*tried, *_between(blocks, sequence))
        if (one[1] > placed + _MORE if one[2].free >= 0 else one[0] < base.sum() - _FITS)
    ]  # fmt: skip
    found = [one for one in ((base.sum(), placed, same), *better) if one[1] >= _PLACED]
    most = max((one[1] for one in found), default=0.0)
    found = sorted((one for one in found if one[1] >= most - _LESS), key=lambda one: one[0])
    if not found or found[0][2] is same:
        return ()
    near = [one for one in found if one[0] <= found[0][0] + _NEAR and one[2] is not same]
    return tuple(_mistake(trial, share) for _, share, trial in near[:_NAMES])


def _mistake(trial: Trial, share: float) -> Mistake:
    """With its description, in the order of the captured pictures."""
    try:
        shown = range(len(trial.order)), trial.sequence
        kept, less = without(trial.sequence, (trial.free,)) if trial.free >= 0 else shown
    except InputError:
        return Mistake(trial.name, share)
    if trial.before:
        return Mistake(trial.name, share)
    pairs = sorted(zip(trial.order[list(kept)].tolist(), less.frames, strict=True), key=lambda pair: pair[0])
    pictures, frames = zip(*pairs, strict=True)
    return Mistake(trial.name, share, pictures, replace(less, frames=frames))


def _cost(blocks: F32, trial: Trial, base: NDArray[np.float64]) -> float:
    in_place = trial.free >= 0 and bool((np.diff(trial.order) == 1).all())
    return float(shortfall(blocks, trial, base).sum()) + (_LOST if in_place else 0.0)


def _placed(blocks: F32, trial: Trial) -> float:
    try:
        return min((float(share.mean()) for share in plain_decode(blocks, trial)), default=0.0)
    except InputError:
        return 0.0


def _between(blocks: F32, sequence: Sequence) -> list[tuple[float, float, Trial]]:
    """Pictures between two images: half of each, everywhere; one or the other, by block."""
    count = len(sequence)
    same, late = np.arange(count), np.minimum(np.arange(count) + 1, count - 1)
    both = zip(*(plain_decode(blocks, Trial("", order, sequence)) for order in (same, late)), strict=True)
    shares = [(one.mean(), np.maximum(one, two).mean(), two.mean()) for one, two in both]
    found = []
    if shares and all(most > max(one, two) + _LESS for one, most, two in shares):
        torn = [float(most) for _, most, _ in shares]
        found.append((2 * sum(1 - one for one in torn), min(torn), Trial(_TORN, same, sequence, before=1)))
    mixed = Trial(_MIXED, same, sequence, before=0.5)
    return [*found, (float(shortfall(blocks, mixed).sum()), _placed(blocks, mixed), mixed)]


def _shifts(blocks: F32, sequence: Sequence) -> Iterator[Trial]:
    """Fringes whose phase is off the bits by the same share of a period everywhere."""
    known, turns, names = plan(sequence), dict[tuple[str, float], float](), list[str]()
    fits = fits_of(blocks, known)
    for axis in known.axes:
        for fit in fits[axis.axis]:
            if axis.code is None or fit is None:
                continue
            place, width, decided = word_places(blocks, axis.code, known, [fit])
            use = decided & (width < 0.75 * fit.period)
            gap = np.exp(2j * np.pi * (fit.phase - place[0] / fit.period))[use]
            mean = gap.mean() if gap.size else 0j
            turn = float(np.angle(mean)) / (2 * np.pi)
            if abs(mean) > _COHERENT and abs(turn) > _SHIFT:
                turns[axis.axis, fit.period] = turn
                names.append(f"of {axis.axis} by {turn:+.2f} periods ({turn * fit.period:+.3g} px)")
    if turns:
        frames = tuple(
            replace(f, shift=(f.shift or 0.0) - 2 * np.pi * turns.get((f.axis or "", f.period_px or 0), 0))
            if f.kind == "phase" else f
            for f in sequence.frames
        )  # fmt: skip
        name = f"fringes are shifted against the bits, {', '.join(names)}"
        yield Trial(name, np.arange(len(sequence)), replace(sequence, frames=frames))


def _faults(sequence: Sequence) -> Iterator[Trial]:
    """Single faults of frames, the simplest first."""
    count = len(sequence)
    same = np.arange(count)
    yield Trial(_EARLY, np.append(same[1:], count - 1), sequence, count - 1)
    for k in range(count - 1):
        late, early = same.copy(), same.copy()
        late[k + 1 :], early[k + 1 : -1] = late[k:-1], early[k + 2 :]
        yield Trial(f"frame {k} is missing, later ones are one early", late, sequence, k)
        if k < count - 2:
            name = f"frame {k} is there twice, later ones are one late"
            yield Trial(name, early, sequence, count - 1)
    for i, j in combinations(range(count), 2):
        order = same.copy()
        order[[i, j]] = j, i
        yield Trial(f"frames {i} and {j} are in each other's place", order, sequence)
    for k in range(count):
        yield Trial(f"frame {k} is missing, another image is in its place", same, sequence, k)


def _descriptions(sequence: Sequence) -> Iterator[Trial]:
    """Descriptions that are often mistaken for the right one; orders of the images in a folder."""
    same, frames = np.arange(len(sequence)), sequence.frames
    yield Trial("the frames are in reverse order", same[::-1].copy(), sequence)
    names = sorted(range(len(frames)), key=str)
    yield Trial("the frames are in the alphabetical order of their numbers", np.argsort(names), sequence)
    for name, kinds, change in _changes(frames):
        if any(f.kind in kinds for f in frames):
            changed = tuple(replace(f, **change(f)) if f.kind in kinds else f for f in frames)
            yield Trial(name, same, replace(sequence, frames=changed))
    axes = {"u before v": "uv", "v before u": "vu", "u and v in turns": ""}
    pairs = ("", ", inverses first", ", all inverses after all bits")
    ends = ("white", "black"), ("black", "white")
    for end, axis, coarse, pair, last in product(ends, axes, (True, False), range(3), (False, True)):
        by = end, axes[axis], coarse, pair, last
        order = np.argsort(sorted(range(len(frames)), key=lambda i, by=by: _rank(frames[i], *by)))  # type: ignore[misc]
        first = ("coarse" if coarse else "fine") + " bits first" + pairs[pair]
        name = f"{' and '.join(end)} {'last' if last else 'first'}, {axis}, {first}"
        yield Trial(f"the frames are in another order: {name}", order, sequence)


def _rank(f: Frame, ends: tuple[str, ...], axes: str, coarse: bool, pair: int, last: bool) -> tuple[Any, ...]:
    """Place of an image among the others of a folder."""
    if f.kind in ends:
        return 2 * last, ends.index(f.kind)
    bit, polarity = (f.bit or 0) * (-1 if coarse else 1), f.inverted != (pair == 1)
    within = (polarity, bit) if pair == 2 else (bit, polarity)
    fringe = f.kind == "phase"
    return 1, axes.find(f.axis or ""), fringe, -(f.period_px or 0), *(() if fringe else within)


def _changes(frames: tuple[Frame, ...]) -> list[tuple[str, tuple[str, ...], _Change]]:
    """Name, kinds of frames, and fields that are others in them."""
    last = {axis: max((f.bit or 0 for f in frames if f.axis == axis), default=0) for axis in ("u", "v")}
    other, fringes = {"gray": "binary", "binary": "gray"}, ("phase",)
    sines = (("a sine", -np.pi / 2), ("a negative sine", np.pi / 2))
    found: list[tuple[str, tuple[str, ...], _Change]] = [
        ("bits are inverted", BINARY_CODES, lambda f: {"inverted": not f.inverted}),
        ("bits are in reverse order", BINARY_CODES, lambda f: {"bit": last[f.axis or "u"] - (f.bit or 0)}),
        ("binary and Gray bits are exchanged", tuple(other), lambda f: {"kind": other[f.kind]}),
        ("fringes have shifts of the other sign", fringes, lambda f: {"shift": -(f.shift or 0.0)}),
        *(
            (f"fringes are {name} for a cosine", fringes, lambda f, by=by: {"shift": (f.shift or 0.0) + by})
            for name, by in sines
        ),
        (
            "u and v are exchanged", (*BINARY_CODES, *fringes),
            lambda f: {"axis": "uv".replace(f.axis or "", "")},
        ),
    ]  # fmt: skip
    size = next((f.cell_px for f in frames if f.kind in BINARY_CODES), 0.0)
    if not size or all(f.kind != "phase" for f in frames):  # no frame shows the others
        return found
    for by, off in product(_SIZES, (0.0, 0.5 * size)):
        name = f"cells are {by * size:.3g} px, not {size:.3g} px"
        name += f", offset by half a cell, {off:.3g} px" if off else ""
        cells = lambda f, by=by, off=off: {  # noqa: E731
            "cell_px": f.cell_px * by, "offset_px": (f.offset_px or 0.0) + off,
        }  # fmt: skip
        found += [(name, BINARY_CODES, cells)] if by != 1 or off else []
    for by, name in ((0.5, "half"), (2.0, "twice")):
        periods = lambda f, by=by: {"period_px": (f.period_px or 1.0) * by}  # noqa: E731
        found.append((f"periods are {name} as large", fringes, periods))
    return found
