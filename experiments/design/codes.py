"""Binary codes in closed form: misread bits, and the error that cells leave; cells of the display under a
fringe.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc

from optolever.patterns import BINARY_CODES, Frame, bits_for, code_words

__all__ = ["bit_failure", "cell_error", "code_of", "sideband", "stairs", "stairs_of_noise"]

Floats = NDArray[np.float64]
#: Systematic error of a margin that the decoder reckons with, in half contrasts.
LOOSE = 0.02
#: What blur leaves of a sideband, under which it is left out.
NOTHING = 1e-5


def code_of(frames: list[Frame]) -> list[Frame]:
    """The binary code among the frames of an axis."""
    return [frame for frame in frames if frame.kind in BINARY_CODES]


def cell_error(coord: Floats, frame: Frame) -> Floats:
    """Decoded minus true coordinate where only the cell is known: its centre is what is answered."""
    first = -0.5 + (frame.offset_px or 0.0)
    cell = np.floor((coord - first) / frame.cell_px)
    return np.asarray(first + (cell + 0.5) * frame.cell_px - coord)


def stairs(coord: Floats, widths: tuple[Floats, ...], blur: float, period: float) -> Floats:
    """Error (cells) of a fringe of a period (cells) read through the display's cells, at coord."""
    return np.asarray(np.angle(_sidebands(coord, widths, blur, period)[0]) * period / (2 * math.pi))


def stairs_of_noise(
    coord: Floats, widths: tuple[Floats, ...], blur: float, period: float
) -> tuple[Floats, Floats]:
    """(share of the contrast there, slope of the stairs) at coord: noise counts over the one, and over one
    plus the other where the stairs are undone."""
    whole, change = _sidebands(coord, widths, blur, period)
    return np.abs(whole), np.asarray((change / whole).imag * period / (2 * math.pi))


def sideband(widths: tuple[float, ...], blur: float, period: float) -> float:
    """Amplitude of the nearest sideband that cells add to a fringe, as a share of it."""
    f = 1 / period
    boxes = tuple(np.array(width) for width in widths)
    return abs(float(f / (f - 1) * _transfer(f - 1, boxes, blur) / _transfer(f, boxes, blur)))


def _sidebands(
    coord: Floats, widths: tuple[Floats, ...], blur: float, period: float
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """1 + sum_k r_k exp(2 pi i k u), and its derivative.

    A cosine of frequency f shown on cells holds f + k as well, each with sinc(f + k), of which pixel
    (boxes of the widths) and blur leave M(f + k): r_k = (-1)^k f / (f + k) M(f + k) / M(f). For long periods
    its angle is the sawtooth of the cells, low-passed.
    """
    f = 1 / period
    whole, change = np.ones(np.shape(coord), np.complex128), np.zeros(np.shape(coord), np.complex128)
    base = _transfer(f, widths, blur)
    base = np.where(np.abs(base) > 1e-3, base, 1e-3)
    for k in (1, -1, 2, -2, 3, -3, 4, -4):
        if math.exp(-2 * (math.pi * blur) ** 2 * k * (k + 2 * f)) < NOTHING:
            continue
        left = (-1) ** k * f / (f + k) * _transfer(f + k, widths, blur) / base
        part = left * np.exp(2j * math.pi * k * coord)
        whole += part
        change += 2j * math.pi * k * part
    return whole, change


def _transfer(frequency: float, widths: tuple[Floats, ...], blur: float) -> Floats:
    left: Floats = np.asarray(math.exp(-2 * (math.pi * blur * frequency) ** 2))
    for width in widths:
        left = left * np.sinc(frequency * width)
    return left


def bit_failure(
    frames: list[Frame],
    references: bool,
    coord: Floats,
    half: Floats,
    deviation: Floats,
    widths: tuple[Floats, Floats],
    blur: float,
    extent: int,
) -> Floats:
    """Probability that some bit leads to a cell that is no neighbour, at coord (H, W).

    half: levels from mid to white; deviation: rms noise of a sample. The margin of a bit at a distance d from
    its nearest edge is half erf(d / (sqrt 2 s)), s the rms width of blur and pixel; it is compared with
    noise / sqrt 2 where the inverse was shown, with sqrt(3/2) noise against white and black. A bit whose
    misreading leads from a cell to its neighbour does no harm there.
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
        distance, harmless = _edge_distance(frame, place, math.ceil(extent / pitch))
        distance = pitch * distance
        margin = half * (1 - erfc(distance / (math.sqrt(2) * spread)))
        noise = np.hypot(scale * deviation, LOOSE * half)
        failure += np.where(harmless, 0.0, 0.5 * erfc(margin / (math.sqrt(2) * noise)))
    return np.asarray(np.minimum(failure, 1.0))


def _edge_distance(frame: Frame, place: Floats, cells: int) -> tuple[Floats, NDArray[np.bool_]]:
    """From places (in cells) to the bit's nearest edge; whether its misreading only leads to a neighbour."""
    count = max(cells, int(place.max()) + 2)
    places = np.arange(count)
    if frame.kind == "long-run-gray":  # another code for each number of bits, and none beyond them
        places = np.minimum(places, (1 << bits_for(cells)) - 1)
    words = code_words(frame.kind, places)
    edges = np.flatnonzero(np.diff((words >> (frame.bit or 0)) & 1)) + 1
    cell_of = np.full(2 * int(words.max()) + 2, -9)
    cell_of[words] = np.arange(count)
    harmless = np.abs(cell_of[words ^ (1 << (frame.bit or 0))] - np.arange(count)) == 1
    here = harmless[np.floor(place).astype(np.int64)]
    if len(edges) == 0:
        return np.full(place.shape, np.inf), here
    inside = np.searchsorted(edges, place, side="right")
    low, high = np.maximum(inside - 1, 0), np.minimum(inside, len(edges) - 1)
    nearest = np.minimum(np.abs(place - edges[low]), np.abs(edges[high] - place))
    return nearest, here
