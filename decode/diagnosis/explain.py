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
from .blocks import Trial, blocks_of, cut, fit_fringe, plain_decode, shortfall, word_places
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
    if trial.before or trial.name == _TORN:
        return Mistake(trial.name, share)
    shown = {int(k): i for i, k in enumerate(trial.order) if i != trial.free}
    ordered = replace(trial.sequence, frames=tuple(trial.sequence.frames[shown[k]] for k in sorted(shown)))
    pictures = np.array(sorted(shown))
    if trial.free < 0:
        return Mistake(trial.name, share, tuple(pictures.tolist()), ordered)
    try:
        kept, less = without(trial.sequence, (trial.free,))
    except InputError:
        return Mistake(trial.name, share)
    number = {i: int(trial.order[i]) for i in kept}
    by_picture = sorted(range(len(kept)), key=lambda one: number[kept[one]])
    frames = tuple(less.frames[one] for one in by_picture)
    return Mistake(
        trial.name, share, tuple(number[kept[one]] for one in by_picture), replace(less, frames=frames)
    )


def _cost(blocks: F32, trial: Trial, base: NDArray[np.float64]) -> float:
    in_place = trial.free >= 0 and bool((np.diff(trial.order) == 1).all())
    return float(shortfall(blocks, trial, base).sum()) + (_LOST if in_place else 0.0)


def _placed(blocks: F32, trial: Trial) -> float:
    try:
        return min((float(one.share.mean()) for one in plain_decode(blocks, trial)), default=0.0)
    except InputError:
        return 0.0


def _between(blocks: F32, sequence: Sequence) -> list[tuple[float, float, Trial]]:
    """Pictures between two images: half of each, everywhere; one or the other, by block."""
    count = len(sequence)
    same, late = np.arange(count), np.minimum(np.arange(count) + 1, count - 1)
    both = [plain_decode(blocks, Trial("", order, sequence)) for order in (same, late)]
    shares = [
        (one.share.mean(), np.maximum(one.share, two.share).mean(), two.share.mean())
        for one, two in zip(*both, strict=True)
    ]
    found = []
    if shares and all(most > max(one, two) + _LESS for one, most, two in shares):
        torn = [float(most) for _, most, _ in shares]
        found.append((2 * sum(1 - one for one in torn), min(torn), Trial(_TORN, same, sequence)))
    mixed = Trial(_MIXED, same, sequence, before=0.5)
    return [*found, (float(shortfall(blocks, mixed).sum()), _placed(blocks, mixed), mixed)]


def _shifts(blocks: F32, sequence: Sequence) -> Iterator[Trial]:
    """Fringes whose phase is off the bits by the same share of a period everywhere."""
    known, turns, names = plan(sequence), dict[tuple[str, float], float](), list[str]()
    for axis in known.axes:
        if axis.code is None or axis.looked_up:
            continue
        for fringe in axis.fringes:
            fit = fit_fringe(blocks, fringe)
            assert fit is not None
            place, width, decided = word_places(blocks, axis.code, known, (fringe.period, *fit))
            use = decided & (width < 0.75 * fringe.period)
            gap = np.exp(2j * np.pi * (fit[0] - place[0] / fringe.period))[use]
            if (
                gap.size
                and abs(gap.mean()) > _COHERENT
                and abs(turn := np.angle(gap.mean()) / (2 * np.pi)) > _SHIFT
            ):
                turns[axis.axis, fringe.period] = float(turn)
                names.append(f"of {axis.axis} by {turn:+.2f} periods ({turn * fringe.period:+.3g} px)")
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
        (
            "u and v are exchanged",
            (*BINARY_CODES, "phase"),
            lambda f: {"axis": "uv".replace(f.axis or "", "")},
        ),
    ]
    kinds = {f.kind for f in frames}
    if kinds & set(BINARY_CODES) and "phase" in kinds:  # else unseen
        size = next(f.cell_px for f in frames if f.kind in BINARY_CODES)
        for by in _SIZES:
            for name, off in (("", 0.0), (f", offset by half a cell, {0.5 * size:.3g} px", 0.5 * size)):
                if by != 1 or off:
                    cells = lambda f, by=by, off=off: {  # noqa: E731
                        "cell_px": f.cell_px * by, "offset_px": (f.offset_px or 0.0) + off,
                    }  # fmt: skip
                    changes += [
                        (f"cells are {by * size:.3g} px, not {size:.3g} px{name}", BINARY_CODES, cells)
                    ]
        for by, how in ((0.5, "half"), (2.0, "twice")):
            by_period = lambda f, by=by: {"period_px": (f.period_px or 1.0) * by}  # noqa: E731
            changes += [(f"periods are {how} as large", ("phase",), by_period)]
    for axis, bit in sorted({(f.axis, f.bit) for f in frames if f.bit is not None}):
        one_bit = lambda f, of=(axis, bit): {"inverted": f.inverted ^ ((f.axis, f.bit) == of)}  # noqa: E731
        changes += [(f"bit {bit} of {axis} is inverted", BINARY_CODES, one_bit)]
    for name, of, change in changes:
        if kinds & set(of):
            changed = tuple(replace(f, **change(f)) if f.kind in of else f for f in frames)
            yield Trial(name, same, replace(sequence, frames=changed))
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
        yield Trial("the frames are in another order: " + ", ".join(parts), order, sequence)
