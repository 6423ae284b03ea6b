"""Single-shot crossed fringe: displacement of one frame against the rest frame, for what moves.

The frame is the mean of a fringe along u and one along v. Multiplied with the carrier exp(-2 pi i u0 / P)
that the map u0 at rest predicts, one side lobe moves to frequency 0 and all else stays away from it; a
Gaussian cuts it out (the Fourier method, Takeda, Ina, Kobayashi 1982, doi:10.1364/JOSA.72.000156, with a
local carrier). Its phase, the deformed frame's minus the rest frame's, is the displacement, unwrapped by
least squares (Ghiglia & Romero 1994, doi:10.1364/JOSAA.11.000107) and made congruent.

The Gaussian smooths what it shows: of a frequency that it leaves the share g, the first pass has g. So the
next pass takes the last one's phase into its carrier and adds what is left, 1 - (1 - g)^k after k passes
(van Cittert); what the last of them still changed counts as error.
"""

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft

from optolever.errors import InputError
from optolever.patterns import Sequence

from .correspondence import Correspondence, Flag
from .guide import PatternMap, guide_map

__all__ = ["crossed"]

F64 = NDArray[np.float64]
Complex = NDArray[np.complex128]
#: Rms width of the Gaussian in periods of the fringe: what is left of the mean level is exp(-2 (0.6 pi)^2).
_WIDTH = 0.6
#: Side lobe over its noise below which a pixel is flagged.
_LEAST = 6.0
_PASSES = 4
#: Factor of the passes on the noise: squared 2 (2 H(k) - H(2 k)), H(k) = 1 + 1/2 + ... + 1/k.
_GROWTH = math.sqrt(
    4 * sum(1 / k for k in range(1, _PASSES + 1)) - 2 * sum(1 / k for k in range(1, 2 * _PASSES + 1))
)
#: Change in the last pass, turns, above which a pixel is flagged.
_SETTLED = 0.02
#: At a straight edge the other lobes leak through half a Gaussian: rms phase, turns, over the root of the
#: share of the window that is missing (there 1/2).
_LEAK = math.hypot(0.5, math.sqrt(0.5)) / (2 * math.pi * _WIDTH * math.sqrt(2 * math.pi)) / (2 * math.pi)


def crossed(
    frame: ArrayLike, rest: ArrayLike, sequence: Sequence, *, guide: PatternMap | None = None
) -> Correspondence:
    """Displacement u, v (pattern pixels, deformed minus rest) of one crossed-fringe frame.

    frame, rest  (H, W), or (N, H, W) as the sequence describes them
    guide        where the camera looked at rest, to a fraction of a period across the fringe's own width
                 (a trace, a decoded capture); default: the surface fills the frame

    Whole periods follow from continuity, the median displacement being within half a period: what is cut off
    from the largest connected part is flagged. sigma holds noise, smoothing and the frame's edge. Flagged
    are pixels where the fringe is lost (LOW_CONTRAST), where the displacement steps by more than a quarter of
    a period, does not settle, or has no connection (ORDER_DOUBTFUL).
    """
    number, period = _crossed_frame(sequence)
    now, still = (
        _image(stack, number, len(sequence), name) for stack, name in ((frame, "frame"), (rest, "rest"))
    )
    if now.shape != still.shape:
        raise InputError(f"crossed: frame is {now.shape}, rest is {still.shape}, must be equal")
    axes = [_axis(now, still, coord, period) for coord in guide_map(guide, sequence, still.shape, "crossed")]
    flags = np.bitwise_or(*(axis.flags for axis in axes))
    flags |= np.where(_connected(flags == 0), 0, int(Flag.ORDER_DOUBTFUL)).astype(np.uint16)
    offset = np.asarray(cv2.GaussianBlur(now, (0, 0), 8.0), np.float64)
    u, v = axes
    return Correspondence(
        u.moved, v.moved, u.sigma, v.sigma, flags, np.minimum(u.amplitude, v.amplitude), offset
    )


@dataclass(frozen=True, slots=True)
class _Axis:
    """Along one axis, (H, W): displacement and its sigma (pattern pixels), amplitude, flags."""

    moved: F64
    sigma: F64
    amplitude: F64
    flags: NDArray[np.uint16]


def _axis(now: F64, still: F64, coord: F64, period: float) -> _Axis:
    """Displacement along an axis; coord: where the camera looked at rest."""
    known = np.isfinite(coord)
    angle = 2 * np.pi / period * np.where(known, coord, 0.0)
    width = _WIDTH * period / max(_steepness(coord), 1e-3)
    carrier = np.where(known, np.exp(-1j * angle), 0.0)
    # of white noise the Gaussian leaves sigma / (2 sqrt(pi) width), 1 / sqrt(2) of it in each quadrature
    noise = _noise(now) / (2 * np.sqrt(np.pi) * width) / np.sqrt(2)
    before, after = _lobe(still, carrier, width), _lobe(now, carrier, width)
    turn = _unwrapped(after * before.conj(), _height(before, after) > _LEAST * noise)
    rested = np.angle(before)
    pressed = 2 * np.pi * turn + rested
    change = np.zeros(coord.shape)
    for _ in range(_PASSES - 1):
        before, after = (
            _lobe(i, carrier * np.exp(-1j * p), width) for i, p in ((still, rested), (now, pressed))
        )
        change = np.angle(after) - np.angle(before)
        rested, pressed = rested + np.angle(before), pressed + np.angle(after)
    height = _height(before, after)
    turn = (pressed - rested) / (2 * np.pi)
    change = _around(np.abs(change) / (2 * np.pi), width)
    lost = height <= _LEAST * noise
    doubtful = (_torn(turn) | (change > _SETTLED)) & ~lost
    flags = np.where(lost, int(Flag.LOW_CONTRAST), 0) | np.where(doubtful, int(Flag.ORDER_DOUBTFUL), 0)
    flags |= np.where(known, 0, int(Flag.INVALID))
    random = _GROWTH * np.sqrt(2.0) * noise / np.maximum(height, 1e-9) / (2 * np.pi)
    # at rest both frames leak alike
    edge = _GROWTH * _LEAK * np.sqrt(2 * _missing(known, width)) * np.minimum(np.pi * np.abs(turn), 1.0)
    sigma = period * np.sqrt(random**2 + change**2 + edge**2)
    return _Axis(period * turn, sigma, 2 * height, flags.astype(np.uint16))


def _height(before: Complex, after: Complex) -> F64:
    return np.minimum(np.abs(before), np.abs(after))


def _around(values: F64, width: float) -> F64:
    """The largest value within a window's width, smoothed: solvers weigh by sigma."""
    size = 2 * math.ceil(width) + 1
    largest = cv2.dilate(values, np.ones((size, size), np.uint8))
    return np.asarray(cv2.GaussianBlur(largest, (0, 0), width))


def _missing(known: NDArray[np.bool_], width: float) -> F64:
    """Share of a pixel's window that lies beside the frame or the map."""
    inside = known.astype(np.float64)
    blurred = cv2.GaussianBlur(inside, (0, 0), width, borderType=cv2.BORDER_CONSTANT)
    return np.clip(1.0 - np.asarray(blurred, np.float64), 0.0, 1.0)


def _connected(good: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The largest connected part."""
    count, labels = cv2.connectedComponents(good.astype(np.uint8), connectivity=4)
    if count < 2:
        return good
    return np.asarray(labels == 1 + np.argmax(np.bincount(labels.ravel())[1:]))


def _crossed_frame(sequence: Sequence) -> tuple[int, float]:
    for i, frame in enumerate(sequence.frames):
        if frame.kind == "crossed":
            return i, frame.period_px or 1.0
    raise InputError(f"crossed: sequence {sequence.name} has no frame of kind 'crossed'")


def _image(stack: ArrayLike, number: int, count: int, name: str) -> F64:
    array = np.asarray(stack)
    if array.ndim == 3 and len(array) == count:
        array = array[number]
    if array.ndim != 2 or min(array.shape) < 16:
        raise InputError(f"crossed: {name} has shape {array.shape}, must be (H, W), at least 16 x 16")
    if not np.isfinite(array).all():
        raise InputError(f"crossed: {name} holds values that are not finite")
    return array.astype(np.float64)


def _steepness(coord: F64) -> float:
    """Median gradient of the map, pattern pixels per camera pixel."""
    slope = np.hypot(*np.gradient(coord))
    return float(np.median(slope[np.isfinite(slope)])) if np.isfinite(slope).any() else 1.0


def _lobe(image: F64, carrier: Complex, width: float) -> Complex:
    """Side lobe of one fringe at frequency 0: half its amplitude, its phase minus the carrier's."""
    flat = (image - cv2.GaussianBlur(image, (0, 0), 2 * width)) * carrier
    return cv2.GaussianBlur(flat.real, (0, 0), width) + 1j * cv2.GaussianBlur(flat.imag, (0, 0), width)


def _noise(image: F64) -> float:
    """Immerkaer's estimate; its mask is blind to fringes along either axis (doi:10.1006/cviu.1996.0060)."""
    across = image[:, :-2] - 2 * image[:, 1:-1] + image[:, 2:]
    second = (across[:-2] - 2 * across[1:-1] + across[2:]) / 6
    return max(1.4826 * float(np.median(np.abs(second))), 12**-0.5)


def _unwrapped(lobe: Complex, usable: NDArray[np.bool_]) -> F64:
    """Phase in turns, its median within half a turn of 0."""
    wrapped = np.where(usable, np.angle(lobe), 0.0)
    down, along = (_wrap(np.diff(wrapped, axis=axis)) for axis in (0, 1))
    source = np.zeros(wrapped.shape)
    source[:-1] += down
    source[1:] -= down
    source[:, :-1] += along
    source[:, 1:] -= along
    rows, cols = (2 * np.cos(np.pi * np.arange(size) / size) - 2 for size in wrapped.shape)
    spectrum = np.asarray(fft.dctn(source, norm="ortho"))
    scale = rows[:, None] + cols[None, :]
    scale[0, 0] = 1.0
    spectrum[0, 0] = 0.0
    smooth = np.asarray(fft.idctn(spectrum / scale, norm="ortho"))
    smooth += np.angle(np.mean(np.exp(1j * (wrapped - smooth))[usable])) if usable.any() else 0.0
    phase = smooth + _wrap(wrapped - smooth)
    turns = phase / (2 * np.pi)
    turns -= np.rint(np.median(turns[usable])) if usable.any() else 0.0
    return np.asarray(turns)


def _torn(turns: F64) -> NDArray[np.bool_]:
    """True on either side of a step by more than a quarter of a turn."""
    torn = np.zeros(turns.shape, bool)
    down, along = (np.abs(np.diff(turns, axis=axis)) > 0.25 for axis in (0, 1))
    torn[:-1] |= down
    torn[1:] |= down
    torn[:, :-1] |= along
    torn[:, 1:] |= along
    return torn


def _wrap(angle: Any) -> F64:
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)
