"""Binary codes in closed form: misread bits, and the error that cells leave."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc

from optolever.patterns import BINARY_CODES, Frame, bits_for, code_words

__all__ = ["cell_error", "code_of", "misread"]

Floats = NDArray[np.float64]
#: Systematic error of a margin that the decoder reckons with, in half contrasts.
LOOSE = 0.02
#: Edges on either side whose blur is reckoned with.
EDGES = 4


def code_of(frames: list[Frame]) -> list[Frame]:
    """The binary code among the frames of an axis."""
    return [frame for frame in frames if frame.kind in BINARY_CODES]


def cell_error(coord: Floats, frame: Frame) -> Floats:
    """Decoded minus true coordinate where only the cell is known: its centre is what is answered."""
    first = -0.5 + (frame.offset_px or 0.0)
    cell = np.floor((coord - first) / frame.cell_px)
    return np.asarray(first + (cell + 0.5) * frame.cell_px - coord)


def misread(
    frames: list[Frame],
    references: bool,
    coord: Floats,
    half: Floats,
    deviation: Floats,
    widths: tuple[Floats, Floats],
    blur: float,
    extent: int,
) -> Floats:
    """Probability (H, W) that misread bits of a code at coord lead to a cell that is no neighbour.

    half: levels from mid to white; deviation: rms noise of a sample. The margin of a bit is half (1 - 2 Q(d_1
    / s) + 2 Q(d_2 / s) - ...) over its edges at distances d_1 < d_2 < ... on either side, s the rms width of
    blur and pixel; it is compared with noise / sqrt 2 where the inverse was shown, with sqrt(3/2) noise
    against white and black. A bit whose misreading leads from a cell to its neighbour does no harm there.
    """
    failure = np.zeros(np.shape(half))
    if not frames:
        return failure
    pairs = {frame.bit for frame in frames if frame.inverted} & {f.bit for f in frames if not f.inverted}
    first, pitch = -0.5 + (frames[0].offset_px or 0.0), frames[0].cell_px
    spread = np.sqrt(blur**2 + (widths[0] ** 2 + widths[1] ** 2) / 12 + 1e-6)
    place = np.clip((np.nan_to_num(coord) - first) / pitch, 0.0, None)
    for frame in {frame.bit: frame for frame in frames}.values():
        scale = math.sqrt(0.5) if frame.bit in pairs else math.sqrt(1.5 if references else 1.0)
        edges, leads = _edges(frame, place, math.ceil(extent / pitch))
        margin = half * _contrast_of_bit(edges, place, spread / pitch)
        noise = np.hypot(scale * deviation, LOOSE * half)
        failure += np.where(np.abs(leads) == 1, 0.0, 0.5 * erfc(margin / (math.sqrt(2) * noise)))
    return np.minimum(failure, 1.0)


def _contrast_of_bit(edges: NDArray[np.int64], place: Floats, spread: Floats) -> Floats:
    """Share of a bit's contrast that is left at places (cells of the code): edges on either side, blurred."""
    left = np.ones(place.shape)
    if len(edges) == 0:
        return left
    inside = np.searchsorted(edges, place, side="right")
    for sign, start, step in ((1, inside, 1), (-1, inside - 1, -1)):
        for k in range(EDGES):
            at = start + step * k
            there = (at >= 0) & (at < len(edges))
            distance = sign * (edges[np.clip(at, 0, len(edges) - 1)] - place)
            left += np.where(there, (-1) ** (k + 1) * erfc(distance / (math.sqrt(2) * spread)), 0.0)
    return left


def _edges(frame: Frame, place: Floats, cells: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Where the bit changes (cells of the code), and by how many cells its misreading leads away from each
    place; far: to no cell at all."""
    count = max(cells, int(place.max()) + 2)
    places = np.arange(count)
    if frame.kind == "long-run-gray":  # another code for each number of bits, and none beyond them
        places = np.minimum(places, (1 << bits_for(cells)) - 1)
    words = code_words(frame.kind, places)
    edges = np.flatnonzero(np.diff((words >> (frame.bit or 0)) & 1)) + 1
    cell_of = np.full(2 * int(words.max()) + 2, -9)
    cell_of[words] = np.arange(count)
    leads = cell_of[words ^ (1 << (frame.bit or 0))] - np.arange(count)
    return edges, np.asarray(leads[np.floor(place).astype(np.int64)])
