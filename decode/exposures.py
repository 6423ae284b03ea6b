"""Captures under several exposures: each is decoded, and every pixel takes its best result.

A camera's black level does not grow with the exposure, and neither does its noise in proportion; so frames of
several exposures are not combined. A short exposure serves pixels that clip in a long one; a long exposure
serves dark pixels.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.patterns import Frame, Sequence

from .records import Correspondence, Flag

__all__ = ["Part", "better_of", "by_exposure"]

#: Combined sigmas by which two exposures may differ.
_APART = 5.0


@dataclass(frozen=True, slots=True)
class Part:
    """Frames (M,) of a capture that decode by themselves; their description, relative to one exposure."""

    index: NDArray[np.int64]
    sequence: Sequence


def by_exposure(sequence: Sequence) -> tuple[Part, ...]:
    """Parts of one exposure each that encode all that the sequence encodes, exposures ascending.

    A code or fringes that are complete under some exposures only serve the other parts, too. Fringes that are
    complete under no exposure are fitted from all. An incomplete code or fringes are left out. InputError if
    no exposure shows a complete code.
    """
    frames = sequence.frames
    if {frame.exposure for frame in frames} == {1.0}:
        return (Part(np.arange(len(frames)), sequence),)
    code, fringes = ([i for i, f in enumerate(frames) if (f.kind == "phase") == own] for own in (False, True))
    bits, lost = _places(frames, code), _lost(frames, code)
    if lost and all(lost.values()):
        told = (f"{some} of {len(bits)} are missing under {one:g}" for one, some in lost.items())
        raise InputError(
            f"sequence {sequence.name}: exposure of the code's frames differs and none shows all of them: "
            + ", ".join(told)
        )
    codes, waves = _whole(frames, code), _whole(frames, fringes)
    first = min(codes, default=1.0)
    others = codes[first] if bits else [], waves[min(waves)] if waves else fringes
    exposures = sorted({*waves, *(codes if bits or not waves else ())}) or [first]
    return tuple(
        _part(
            sequence,
            codes.get(one, others[0]) + waves.get(one, others[1]),
            first if bits and one not in codes else one,
        )
        for one in exposures
    )


def _lost(frames: tuple[Frame, ...], index: list[int]) -> dict[float, int]:
    """Number of places that are missing under each exposure, ascending."""
    every, own = _places(frames, index), sorted({frames[i].exposure for i in index})
    return {one: len(every - _places(frames, [i for i in index if frames[i].exposure == one])) for one in own}


def _whole(frames: tuple[Frame, ...], index: list[int]) -> dict[float, list[int]]:
    """Frames of each exposure that shows all places."""
    return {
        one: [i for i in index if frames[i].exposure == one]
        for one, lost in _lost(frames, index).items()
        if not lost
    }


def _places(frames: tuple[Frame, ...], index: list[int]) -> set[tuple[object, ...]]:
    """Encoded places of frames, regardless of exposure and of the polarity of a bit."""
    return {_place(frames[i]) for i in index if frames[i].axis is not None}


def _part(sequence: Sequence, index: list[int], exposure: float) -> Part:
    index.sort()
    frames = (sequence.frames[i] for i in index)
    shown = tuple(replace(frame, exposure=frame.exposure / exposure) for frame in frames)
    return Part(np.array(index, np.int64), replace(sequence, frames=shown))


def _place(frame: Frame) -> tuple[object, ...]:
    if frame.kind != "phase":
        return frame.kind, frame.axis, frame.bit, frame.at_u, frame.at_v, frame.levels
    shift = (frame.shift or 0.0) + np.pi * frame.inverted
    return frame.axis, frame.period_px, round(shift % (2 * np.pi), 6)


def better_of(first: Correspondence, second: Correspondence) -> Correspondence:
    """Better result of every pixel: unflagged, else decoded, else not clipped, else fewer flags; then least
    sigma, least probability of a wrong bit, highest contrast. MOVED where two good ones contradict.
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
    notices = tuple(dict.fromkeys(first.notices + second.notices))
    return Correspondence(**merged, notices=notices, shared_noise=first.shared_noise or second.shared_noise)


def _ranks(found: Correspondence) -> tuple[NDArray[Any], ...]:
    """Ranks in order of priority; less is better."""
    sigmas = [np.where(np.isfinite(sigma), sigma, 0) for sigma in (found.sigma_u, found.sigma_v)]
    spoilt = np.isnan(found.u) & np.isnan(found.v)
    assert found.amplitude is not None
    assert found.order_error is not None
    count = np.bitwise_count(found.flags)
    clipped = (found.flags & Flag.SATURATED) > 0
    return count > 0, spoilt, clipped, count, np.hypot(*sigmas), found.order_error, -found.amplitude
