"""Decoding without a picture, by the user's word: what of a code its other pictures hold."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from optolever.errors import InputError
from optolever.patterns import BINARY_CODES, Frame, Sequence

from ..plan import AxisPlan, plan

__all__ = ["without"]


def without(sequence: Sequence, pictures: Iterable[int]) -> tuple[tuple[int, ...], Sequence]:
    """Numbers of the pictures that decode without some, and their description: a bit by its inverse or by
    coarser ones, a fringe by its other steps or by its other periods. InputError where the code needs one."""
    kept, less = tuple(range(len(sequence))), sequence
    for number in sorted(set(pictures)):
        if not 0 <= number < len(sequence):
            raise InputError(f"--without {number}: pictures are 0 to {len(sequence) - 1}")
        if number in kept:
            some, less = _without_one(less, kept.index(number), number)
            kept = tuple(kept[i] for i in some)
    return kept, less


def _without_one(sequence: Sequence, at: int, number: int) -> tuple[tuple[int, ...], Sequence]:
    axes, lost, every = plan(sequence).axes, sequence.frames[at], range(len(sequence))
    own = [{*f.index} for axis in axes for f in (*axis.fringes, *axis.singles) if at in f.index]
    for drop in ({at}, *own):
        keep = tuple(i for i in every if i not in drop)
        less = replace(sequence, frames=tuple(sequence.frames[i] for i in keep))
        if _decodable(axes, less):
            return keep, less
    coarser = [_coarser(frame, lost) if lost.kind in BINARY_CODES else None for frame in sequence.frames]
    keep = tuple(i for i in every if coarser[i] is not None)
    frames = tuple(frame for frame in coarser if frame is not None)
    if any(frame.kind == lost.kind and frame.axis == lost.axis for frame in frames):
        return keep, replace(sequence, frames=frames)
    raise InputError(
        f"--without {number}: {lost.kind} of {lost.axis or 'both axes'} is needed; capture again"
    )


def _coarser(frame: Frame, lost: Frame) -> Frame | None:
    """A frame of the code without a bit and all finer ones; None: it goes."""
    finer = 1 + (lost.bit or 0)
    cell = lost.cell_px * 2**finer
    if frame.axis != lost.axis or frame.kind != lost.kind:
        return frame
    if (frame.bit or 0) < finer:
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
