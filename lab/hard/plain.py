"""The places that ideal levels mean, without any doubt, and how far wrong places depart from right ones.

They judge whether a fault changes anything: a frame that is not what its description says changes the place
of those pixels where this differs from the place that the right frames give.
"""

import math

import numpy as np
from numpy.typing import NDArray

from optolever.experiments.arrays import Floats
from optolever.patterns import Frame, Sequence


def plain_places(levels: NDArray[np.floating], sequence: Sequence) -> tuple[Floats, Floats]:
    """u and v (H, W) of ideal levels (N, H, W) of bits (`gray`, `binary`) and fringes, coarse ones first."""
    return _along("u", sequence.cols, levels, sequence), _along("v", sequence.rows, levels, sequence)


def seams(
    right: tuple[Floats, Floats], wrong: tuple[Floats, Floats], within: NDArray[np.bool_], apart: float
) -> int:
    """Pairs of neighbours, both `within` (H, W), from one to the other of which the wrong places (u, v) go by
    more than `apart` farther than the right ones."""
    count = 0
    for one, two in zip(right, wrong, strict=True):
        farther = [np.abs(np.diff(two, axis=axis) - np.diff(one, axis=axis)) > apart for axis in (0, 1)]
        count += int((farther[0] & within[1:] & within[:-1]).sum())
        count += int((farther[1] & within[:, 1:] & within[:, :-1]).sum())
    return count


def _along(axis: str, extent: int, levels: NDArray[np.floating], sequence: Sequence) -> Floats:
    frames = [(i, frame) for i, frame in enumerate(sequence.frames) if frame.axis == axis]
    bits = [(i, frame) for i, frame in frames if frame.bit is not None]
    place = _of_bits(bits, levels, sequence) if bits else np.full(levels.shape[1:], 0.5 * (extent - 1))
    known = bits != []
    for period in sorted({frame.period_px for _, frame in frames if frame.period_px}, reverse=True):
        swept = [(levels[i], frame.shift or 0.0) for i, frame in frames if frame.period_px == period]
        sine, cosine = (sum(level * turn(shift) for level, shift in swept) for turn in (math.sin, math.cos))
        fine = np.arctan2(sine, cosine) / (2 * math.pi) % 1.0 * period
        place = fine + period * np.rint((place - fine) / period) if known else fine
        known = True
    return np.asarray(place, np.float64)


def _of_bits(bits: list[tuple[int, Frame]], levels: NDArray[np.floating], sequence: Sequence) -> Floats:
    """Centres of the cells that the bits name."""
    references = [levels[i] for i, frame in enumerate(sequence.frames) if frame.kind in ("white", "black")]
    inverse = {frame.bit: levels[i] for i, frame in bits if frame.inverted}
    word = np.zeros(levels.shape[1:], np.int64)
    for i, frame in bits:
        if not frame.inverted:
            threshold = inverse[frame.bit] if frame.bit in inverse else sum(references) / 2
            word |= (levels[i] > threshold).astype(np.int64) << (frame.bit or 0)
    first = bits[0][1]
    if first.kind == "gray":
        shift = 1
        while shift < 32:
            word ^= word >> shift
            shift *= 2
    return np.asarray((word + 0.5) * first.cell_px - 0.5, np.float64)
