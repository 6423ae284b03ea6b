"""Captures that hold a code under several exposures: each of them is decoded, every pixel takes its best.

White, black and bits bound each other only under one exposure, so they are not mixed; what a pixel's long
exposure clips its short one shows, and where that is dark, the long one does.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.patterns import Frame, Sequence

from .correspondence import Correspondence, Flag

__all__ = ["Part", "better_of", "by_exposure"]

#: Combined sigmas by which two exposures may differ.
_APART = 5.0
_FEWEST_SHIFTS = 3


@dataclass(frozen=True, slots=True)
class Part:
    """Frames (M,) of a capture that decode by themselves, and their description, relative to one exposure."""

    index: NDArray[np.int64]
    sequence: Sequence


def by_exposure(sequence: Sequence) -> tuple[Part, ...]:
    """Parts of one exposure each that show everything the sequence does, exposures rising.

    Fringes alone are one part, as their fit takes samples of all exposures, and so do those of a code that is
    whole under one exposure only; else each part has the fringes of its exposure, or all if these are too
    few. Frames of an exposure under which the code is not whole are left out. InputError if no exposure
    shows all of it.
    """
    exposures = sorted({frame.exposure for frame in sequence.frames if frame.kind != "phase"})
    if exposures in ([], [1.0]):
        return (Part(np.arange(len(sequence)), sequence),)
    every = {_place(frame) for frame in sequence.frames if _coded(frame)}
    own = {
        exposure: [i for i, f in enumerate(sequence.frames) if f.kind != "phase" and f.exposure == exposure]
        for exposure in exposures
    }
    lost = {exposure: len(every - {_place(sequence.frames[i]) for i in own[exposure]}) for exposure in own}
    whole = [exposure for exposure in exposures if not lost[exposure]]
    if not whole:
        told = (f"{lost[exposure]} of {len(every)} are missing under {exposure:g}" for exposure in exposures)
        raise InputError(
            f"sequence {sequence.name}: exposure of the code's frames differs and none shows all of them: "
            + ", ".join(told)
        )
    if len(whole) == 1 or not every:
        return (_part(sequence, own[whole[0]] + _fringes(sequence, None), whole[0]),)
    return tuple(_part(sequence, own[one] + _fringes(sequence, one), one) for one in whole)


def _part(sequence: Sequence, index: list[int], exposure: float) -> Part:
    index.sort()
    frames = (sequence.frames[i] for i in index)
    shown = tuple(replace(frame, exposure=frame.exposure / exposure) for frame in frames)
    return Part(np.array(index, np.int64), replace(sequence, frames=shown))


def _coded(frame: Frame) -> bool:
    return frame.axis is not None and frame.kind != "phase"


def _place(frame: Frame) -> tuple[object, ...]:
    """What a frame shows, whatever its polarity and exposure."""
    return frame.kind, frame.axis, frame.bit, frame.at_u, frame.at_v, frame.levels


def _fringes(sequence: Sequence, exposure: float | None) -> list[int]:
    """Fringes of an exposure if they are whole, else all; None: all."""
    every: dict[tuple[str | None, float | None], set[float]] = {}
    own: list[int] = []
    for i, frame in enumerate(sequence.frames):
        if frame.kind == "phase":
            shifts = every.setdefault((frame.axis, frame.period_px), set())
            if frame.exposure == exposure:
                own.append(i)
                shifts.add(round((frame.shift or 0.0) + np.pi * frame.inverted, 6))
    if all(len(shifts) >= _FEWEST_SHIFTS for shifts in every.values()):
        return own
    return [i for i, frame in enumerate(sequence.frames) if frame.kind == "phase"]


def better_of(first: Correspondence, second: Correspondence) -> Correspondence:
    """Every pixel's better answer: unflagged, else not clipped, else of fewer flags; then of least sigma, of
    least probability of a wrong bit, of most contrast. MOVED where both are sure and contradict each other.
    """
    ranks = [np.stack(both) for both in zip(_ranks(first), _ranks(second), strict=True)]
    take = np.lexsort(ranks[::-1], axis=0)[0] == 1
    apart = np.zeros(take.shape, bool)
    for axis in "uv":
        both = [getattr(one, axis) for one in (first, second)]
        sigma = [getattr(one, f"sigma_{axis}").astype(np.float64) for one in (first, second)]
        with np.errstate(invalid="ignore"):
            apart |= np.abs(both[0] - both[1]) > _APART * np.hypot(*sigma)
    names = ("u", "v", "sigma_u", "sigma_v", "flags", "amplitude", "offset", "order_error")
    merged = {name: np.where(take, getattr(second, name), getattr(first, name)) for name in names}
    merged["flags"][apart & first.good & second.good] |= np.uint16(Flag.MOVED)
    return Correspondence(**merged, notices=tuple(dict.fromkeys(first.notices + second.notices)))


def _ranks(found: Correspondence) -> tuple[NDArray[Any], ...]:
    """Less is better, the first that differs decides."""
    sigmas = [np.where(np.isfinite(sigma), sigma, 0) for sigma in (found.sigma_u, found.sigma_v)]
    spoilt = np.isnan(found.u) & np.isnan(found.v)
    assert found.amplitude is not None
    assert found.order_error is not None
    count = np.bitwise_count(found.flags)
    clipped = (found.flags & Flag.SATURATED) > 0
    return count > 0, spoilt, clipped, count, np.hypot(*sigmas), found.order_error, -found.amplitude
