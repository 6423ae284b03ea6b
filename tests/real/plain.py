"""A plain decoder, as a textbook has it: the reference for captures of which nothing else is known.

A bit is the sign of its difference from its inverse, else from the mean of white and black, else of the
fringe's samples, else from the middle of the bits' levels; a fringe's order is that of the place nearest to
the cell. It knows no noise and no flags, and shares nothing with the decoder.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.patterns import Sequence

F64 = NDArray[np.float64]
#: Contrast that nine pixels of ten stay below in a bit that is not resolved; part of a period that a fringe
#: resolves.
_UNRESOLVED, _PART = 0.1, 1 / 16


class Plain(NamedTuple):
    """place (H, W) pattern px, and the width of what is resolved, px."""

    place: F64
    cell: float


def plain_decoder(frames: NDArray[np.generic], sequence: Sequence, axis: str) -> Plain:
    """Gray code of an axis, and its fringe if there is one."""
    levels, shown = np.asarray(frames, np.float64), list(enumerate(sequence.frames))
    fringe = [(i, f) for i, f in shown if f.kind == "phase" and f.axis == axis]
    ends = [i for i, f in shown if f.kind in ("white", "black")] or [i for i, _ in fringe]
    bits = {(f.bit, f.inverted): (i, f) for i, f in shown if f.kind == "gray" and f.axis == axis}
    count, one = 1 + max(bit for bit, _ in bits), bits[0, False][1]
    coded = levels[[i for i, _ in bits.values()]]
    mean = levels[ends].mean(axis=0) if ends else 0.5 * (coded.max(axis=0) + coded.min(axis=0))
    pairs = [(levels[bits[b, False][0]], bits.get((b, True))) for b in range(count)]
    margin = np.stack([plain - (mean if other is None else levels[other[0]]) for plain, other in pairs])
    contrast = np.quantile(np.abs(margin / np.maximum(np.abs(margin).max(axis=0), 1)), 0.9, axis=(1, 2))
    finest = max((b + 1 for b in range(count) if contrast[b] < _UNRESOLVED), default=0)
    word = np.logical_xor.accumulate(margin[finest:][::-1] > 0)[::-1]
    cell = one.cell_px * 2**finest
    place = np.tensordot(2.0 ** np.arange(count - finest), word, 1) * cell + (cell - 1) / 2
    place += one.offset_px or 0.0
    if fringe:
        samples = sum(levels[i] * np.exp(1j * f.shift) for i, f in fringe)
        cell = fringe[0][1].period_px * _PART
        turn = np.angle(samples) / (2 * np.pi) * (fringe[0][1].period_px)
        place = turn + fringe[0][1].period_px * np.rint((place - turn) / fringe[0][1].period_px)
    return Plain(place, cell)
