"""What the kernels are told, as records that they take apart themselves, and their room to work in.

A part that is None is left out when they are compiled (what is done in its absence never is: numba decides by
the type of None only), so that a capture waits for the kernels of its own code.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.handing import handed_by_address

from .tile_lines import LINES, OF_PERIOD

__all__ = [
    "ROWS_AROUND",
    "TILE",
    "AxisRecord",
    "Camera",
    "CellLines",
    "CodeRecord",
    "Edges",
    "FringeRecord",
    "Near",
    "Scratch",
    "Shared",
    "scratch",
]

Array = NDArray[Any]

#: Pixels that are worked on at once.
TILE = 4096
#: Pixels, about, and rows at most that are decoded along one axis before the other: with fewer, a kernel is
#: handed all its records more often. Rows are a power of two, so that blocks of any number of threads are cut
#: into the same tiles.
_BATCH, _MOST_ROWS = 16384, 16
#: Rows that are kept besides those worked on at once: those that wait for neighbours, and one beyond.
ROWS_AROUND = 8
#: Bytes of a vector: what is not laid out by it takes two accesses each.
_VECTOR = 64
#: What lines are longer than a tile: places in lines that lie a power of two apart share few of the cache's.
_APART = 64


@handed_by_address
class Camera(NamedTuple):
    """frames (N, 1, pixels), rows end to end, clipped from level `clip` on; lut: linear level of a raw one,
    slope (empty: 1) its slope, scale: that at mid level, squared; variance = read2 + gain level, of codes:
    of_code; dark: level that counts as such; floor: of sigma."""

    frames: Array
    lut: Array | None
    slope: Array
    scale: np.float32
    clip: float
    read2: np.float32
    gain: np.float32
    of_code: tuple[np.float32, np.float32]
    dark: np.float32
    floor: np.float32


@handed_by_address
class Edges(NamedTuple):
    """Of each bit (bits,): rms contrast and level away from edges, both over the half contrast without blur;
    share of the pixels that are edges; how far an edge reaches to either side, cells. inside: variance of a
    place in a cell whose bits are certain, cells^2. Of bits without inverses: their threshold's distance
    from the mid level (shift), and its error (astray), half contrasts."""

    contrast: Array
    level: Array
    share: Array
    reach: Array
    inside: np.float32
    shift: np.float32
    astray: np.float32


@handed_by_address
class CodeRecord(NamedTuple):
    """Bits of a code.

    source: see code_kernels; white, black (frame numbers), plain, inverse (bits,): -1 = not shown, bit 0
    least significant; cells: word -> cell, which for a Gray code (gray) is computed; together: bits change
    together from cell to cell; fringed: a fringe tells where in a cell a pixel is; loose: systematic error of
    a margin, in half contrasts; beyond: half contrasts by which a bit's level may pass white or black; pitch,
    origin: place of a cell; most: cells of the surface; bytes: True if frames are such, there are no fringes,
    every bit has its inverse, and words have 15 bits at most, else None.
    """

    source: int
    white: int
    black: int
    plain: Array
    inverse: Array
    gray: bool
    cells: Array
    together: bool
    fringed: bool
    edges: Edges
    loose: np.float32
    beyond: np.float32
    pitch: np.float32
    origin: np.float32
    most: np.int32
    bytes: bool | None


@handed_by_address
class CellLines(NamedTuple):
    """What a code tells of the pixels of a tile, (n,) each.

    cell; weak: some bit is in doubt; probabilities that the truth is one cell up, one cell down, or anywhere
    else (far; 1 where levels are no bit's); mean square of a place's error (place, cells^2); half contrast,
    mid level; clipped = 1 where clipped samples make a bit unreadable. Room: least margins of bits with and
    without inverse (pair, single), largest of the latter (most), extremes of a pair's sum (high, low).
    """

    cell: Array
    weak: Array
    far: Array
    up: Array
    down: Array
    place: Array
    half: Array
    middle: Array
    clipped: Array
    pair: Array
    single: Array
    most: Array
    high: Array
    low: Array


@handed_by_address
class FringeRecord(NamedTuple):
    """Periods, see arrays.FringeArrays (samples: count, frame: index; own: 0, 1, ...) and display_kernels
    (shown); unlike: some are no quarters, searched: no period spans the surface, pair: two periods of
    quarters, one much finer, and linear levels are all there is (True or None); reach: distance from the
    code's cell; disagreement: limit of the periods' chi squared."""

    samples: Array
    frame: Array
    own: Array
    solve: Array
    model: Array
    quad: Array
    even: Array
    quarters: Array
    unlike: bool | None
    periods: Array
    misfit: Array
    searched: bool | None
    pair: bool | None
    reach: np.float32
    disagreement: np.float32
    shown: Any


@handed_by_address
class AxisRecord(NamedTuple):
    """One axis of `extent` pattern pixels: what was shown (alone: the code, if there are no fringes); maps
    (H, W); joined: the shared ones hold the other axis; least: distance of an outlier; number: 0 for u, 1
    for v."""

    code: CodeRecord | None
    alone: CodeRecord | None
    fringes: FringeRecord | None
    extent: float
    least: np.float32
    joined: bool
    number: int
    coord: Array
    sigma: Array


@handed_by_address
class Shared(NamedTuple):
    """Maps of both axes, (H, W) and (1, pixels)."""

    flags: Array
    amplitude: Array
    offset: Array
    flat_flags: Array
    flat_amplitude: Array
    flat_offset: Array
    flat_error: Array


Steep = tuple[np.float32, np.float32, np.uint16]


@handed_by_address
class Near(NamedTuple):
    """What neighbours are asked, see neighbour_kernels.near_block; dim (H,): rows that are asked again."""

    shown: tuple[bool, bool]
    steep: tuple[Steep | None, Steep | None]
    least: tuple[np.float32, np.float32]
    read2: np.float32
    gain: np.float32
    extents: tuple[float, float]
    bands: tuple[tuple[float, float], tuple[float, float]]
    u: Array
    v: Array
    sigma_u: Array
    sigma_v: Array
    dim: Array


@handed_by_address
class Scratch(NamedTuple):
    """Room of one thread: lines of a tile in float32, int32, int16 and uint8 (marks, sizes), of linear
    levels, of a whole row.

    kept (2, R, W or more): rows of u and v in float32, row r in line r % R, as long as their neighbours need
    them.
    """

    lines: Array
    words: Array
    shorts: Array
    marks: Array
    sizes: Array
    linear: Array
    equations: Array
    across: Array
    wide: Array
    kept: Array


def _at_once(width: int) -> int:
    """Rows of that width that are decoded along one axis before the other."""
    return min(1 << (max(_BATCH // width, 1).bit_length() - 1), _MOST_ROWS)


def scratch(width: int, periods: int = 0, samples: int = 0) -> Scratch:
    """For images `width` pixels wide; samples: of a period, if they are made linear."""
    lines = LINES + OF_PERIOD * periods
    padded = -(-width // _VECTOR) * _VECTOR
    rows = _at_once(width) + ROWS_AROUND
    tile = TILE + _APART
    room = np.empty(4 * tile * (lines + 6 + samples) + (6 + 8 * rows) * padded + 4 * _VECTOR, np.uint8)
    start = -room.ctypes.data % _VECTOR
    taken = []
    for count, length, kind in (
        *((lines, tile, np.float32), (2, tile, np.int32), (6, tile, np.int16)),
        *((2, tile, np.uint8), (2, tile, np.uint8)),
        *((samples, tile, np.float32), (1, padded, np.float32), (1, padded, np.uint16)),
        (2 * rows, padded, np.float32),
    ):
        size = count * length * np.dtype(kind).itemsize
        taken.append(room[start : start + size].view(kind).reshape(count, length))
        start += size
    line, word, short, mark, size_of, linear, across, wide, kept = taken
    return Scratch(
        *(line, word, short, mark, size_of, linear[:, None], np.empty((3, 4))),
        *(across[0, :width], wide[0, :width]),
        kept.reshape(2, rows, padded),
    )
