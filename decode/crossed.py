"""Single-shot crossed fringe: displacement of one frame against the rest frame, for what moves.

The frame is the mean of a fringe along u and one along v. Multiplied with the carrier exp(-2 pi i u0 / P)
that the map u0 at rest predicts, one side lobe moves to frequency 0 and all else stays away from it; a
Gaussian cuts it out (the Fourier method, Takeda, Ina, Kobayashi 1982, doi:10.1364/JOSA.72.000156, with a
local carrier). Its phase, the deformed frame's minus the rest frame's, is the displacement, unwrapped by
least squares (Ghiglia & Romero 1994, doi:10.1364/JOSAA.11.000107) and made congruent.
"""

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


def crossed(
    frame: ArrayLike, rest: ArrayLike, sequence: Sequence, *, guide: PatternMap | None = None
) -> Correspondence:
    """Displacement u, v (pattern pixels, deformed minus rest) of one crossed-fringe frame.

    frame, rest  (H, W), or (N, H, W) as the sequence describes them
    guide        where the camera looked at rest, to a fraction of a period across the fringe's own width
                 (a trace, a decoded capture); default: the surface fills the frame

    Details finer than about a period are smoothed away, which sigma does not hold. Whole periods follow from
    continuity, the median displacement being within half a period. Pixels are flagged where the fringe is
    lost (LOW_CONTRAST) and where the displacement steps by more than a quarter of a period (ORDER_DOUBTFUL).
    """
    number, period = _crossed_frame(sequence)
    now, still = (
        _image(stack, number, len(sequence), name) for stack, name in ((frame, "frame"), (rest, "rest"))
    )
    if now.shape != still.shape:
        raise InputError(f"crossed: frame is {now.shape}, rest is {still.shape}, must be equal")
    flags = np.zeros(still.shape, np.uint16)
    moved, sigmas, heights = [], [], []
    for coord in guide_map(guide, sequence, still.shape, "crossed"):
        known = np.isfinite(coord)
        angle = 2 * np.pi / period * np.where(known, coord, 0.0)
        width = _WIDTH * period / max(_steepness(coord), 1e-3)
        carrier = np.where(known, np.exp(-1j * angle), 0.0)
        before, after = _lobe(still, carrier, width), _lobe(now, carrier, width)
        # of white noise the Gaussian leaves sigma / (2 sqrt(pi) width), 1 / sqrt(2) of it in each quadrature
        noise = _noise(now) / (2 * np.sqrt(np.pi) * width) / np.sqrt(2)
        height = np.minimum(np.abs(before), np.abs(after))
        turn, torn = _unwrapped(after * before.conj(), height > _LEAST * noise)
        moved.append(period * turn)
        sigmas.append(period / (2 * np.pi) * np.sqrt(2.0) * noise / np.maximum(height, 1e-9))
        flags |= np.where(height > _LEAST * noise, 0, int(Flag.LOW_CONTRAST)).astype(np.uint16)
        flags |= np.where(known, 0, int(Flag.INVALID)).astype(np.uint16)
        flags |= np.where(torn, int(Flag.ORDER_DOUBTFUL), 0).astype(np.uint16)
        heights.append(2 * height)
    offset = np.asarray(cv2.GaussianBlur(now, (0, 0), 8.0), np.float64)
    return Correspondence(
        moved[0], moved[1], sigmas[0], sigmas[1], flags, np.minimum(heights[0], heights[1]), offset
    )


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


def _unwrapped(lobe: Complex, usable: NDArray[np.bool_]) -> tuple[F64, NDArray[np.bool_]]:
    """Phase in turns, its median within half a turn of 0; True where it steps by more than a quarter."""
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
    torn = np.zeros(turns.shape, bool)
    for axis, (first, second) in enumerate(
        (((np.s_[:-1],), (np.s_[1:],)), ((np.s_[:], np.s_[:-1]), (np.s_[:], np.s_[1:])))
    ):
        step = np.abs(np.diff(turns, axis=axis)) > 0.25
        torn[first] |= step
        torn[second] |= step
    return turns, torn & usable


def _wrap(angle: Any) -> F64:
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)
