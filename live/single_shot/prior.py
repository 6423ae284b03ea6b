"""The frame at rest: its map (given, or a default), pixels with a fringe, and their noise. A mirror may fill
a small part of the picture; around it there may be darkness, a lit room, a lamp, a second and weaker
reflection of the pattern.
"""

import math
from typing import Any, Protocol, runtime_checkable

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from optolever.decode import Correspondence
from optolever.errors import InputError
from optolever.patterns import Frame, Sequence

__all__ = ["PatternMap", "frame_pair", "noise_of", "overexposed", "prior_map", "seeing", "window_width"]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]
#: Rms width of the window in periods of the fringe.
_WIDTH = 0.5
#: Least amplitude relative to its surroundings: a window centred on a straight border has half.
_HALF = 0.5
#: Least relative amplitude: twice the reflectance of glass of index 1.5, ((1.5 - 1) / (1.5 + 1))^2.
_GLASS = 0.08


@runtime_checkable
class PatternMap(Protocol):
    """u and v (H, W), pattern pixels, of camera pixels at rest: a Correspondence, a trace; NaN: unknown."""

    @property
    def u(self) -> NDArray[Any]: ...
    @property
    def v(self) -> NDArray[Any]: ...


def prior_map(prior: PatternMap | None, sequence: Sequence, shape: tuple[int, ...]) -> tuple[F64, F64]:
    """u and v at rest (H, W), NaN where unknown or flagged.

    Without a prior the surface fills the frame, u along columns, v along rows.
    """
    if prior is None:
        row, col = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
        u = (col + 0.5) * sequence.cols / shape[1] - 0.5
        return u, (row + 0.5) * sequence.rows / shape[0] - 0.5
    u, v = np.asarray(prior.u, np.float64), np.asarray(prior.v, np.float64)
    if u.shape != tuple(shape) or v.shape != tuple(shape):
        raise InputError(f"{sequence.name}: prior is {u.shape}, rest is {tuple(shape)}, must be equal")
    if isinstance(prior, Correspondence):
        return np.where(prior.good, u, np.nan), np.where(prior.good, v, np.nan)
    return u, v


def frame_pair(
    now: ArrayLike, rest: ArrayLike, sequence: Sequence, kind: str
) -> tuple[Frame, NDArray[Any], NDArray[Any]]:
    """The frame of this kind that a sequence describes, and both its images (H, W)."""
    number = next((i for i, frame in enumerate(sequence.frames) if frame.kind == kind), None)
    if number is None:
        raise InputError(f"{kind}: sequence {sequence.name} has no frame of kind {kind!r}")
    images = [_image(stack, sequence, number, name) for stack, name in ((now, "frame"), (rest, "rest"))]
    if images[0].shape != images[1].shape:
        raise InputError(f"{kind}: frame is {images[0].shape}, rest is {images[1].shape}, must be equal")
    return sequence.frames[number], images[0], images[1]


def _image(stack: ArrayLike, sequence: Sequence, number: int, name: str) -> NDArray[Any]:
    """One image (H, W), from the stack of a sequence, or given alone."""
    array, kind = np.asarray(stack), sequence.frames[number].kind
    if array.ndim == 3:
        if len(array) != len(sequence):
            raise InputError(f"{kind}: {name} has {len(array)} images, sequence describes {len(sequence)}")
        array = array[number]
    if array.ndim != 2 or min(array.shape) < 16:
        raise InputError(f"{kind}: {name} has shape {array.shape}, must be (H, W), at least 16 x 16")
    if not np.isfinite(array).all():
        raise InputError(f"{kind}: {name} holds values that are not finite")
    return array


def window_width(at_rest: tuple[F64, F64], lit: Mask, period: float) -> float:
    """Rms width of the window, camera pixels, from the flatter coordinate's median gradient where lit."""
    steepness = []
    for coord in at_rest:
        slope = np.hypot(*np.gradient(coord))
        slope = slope[lit & np.isfinite(slope)]
        steepness.append(float(np.median(slope)) if slope.size else 1.0)
    return _WIDTH * period / max(min(steepness), 1e-3)


def seeing(height: F32, known: Mask, width: float) -> Mask:
    """Pixels with a fringe, from the amplitude (H, W) within windows of this width.

    Borders are where it falls to half of the maximum within two widths: farther away, light behind the border
    contributes 2 %. Half a width along them is left out, as a step of brightness has amplitude, too. The
    typical amplitude weights pixels by its square, so that many faint ones do not count.
    """
    lit = np.where(known, height, np.float32(0)).astype(np.float32)
    size = 2 * math.ceil(2 * width) + 1
    around = cv2.dilate(lit, np.ones((size, size), np.uint8))
    power = np.square(lit, dtype=np.float64)
    usual = float((power * lit).sum() / max(power.sum(), 1e-9))
    blind = known & (height < np.maximum(_HALF * around, _GLASS * usual))
    size = 2 * math.ceil(width / 2) + 1
    return np.asarray(known & (cv2.dilate(blind.astype(np.uint8), np.ones((size, size), np.uint8)) == 0))


def overexposed(image: NDArray[Any], width: float) -> Mask:
    """Where an integer image is at its maximum over half a period both ways: no fringe is bright that far."""
    if image.dtype.kind not in "ui":
        return np.zeros(image.shape, bool)
    top = (image == np.iinfo(image.dtype).max).astype(np.uint8)
    size = math.ceil(0.5 * width / _WIDTH)
    return np.asarray(cv2.morphologyEx(top, cv2.MORPH_OPEN, np.ones((size, size), np.uint8)) > 0)


def noise_of(image: F32, lit: Mask) -> float:
    """Immerkaer's estimate (doi:10.1006/cviu.1996.0060), median in place of mean, where his mask is lit.

    The mask ignores fringes along either axis of the camera. The result is at least the rounding to integers.
    """
    inner = cv2.erode(lit.astype(np.uint8), np.ones((3, 3), np.uint8))[1:-1, 1:-1] > 0
    across = image[:, :-2] - 2 * image[:, 1:-1] + image[:, 2:]
    second = (across[:-2] - 2 * across[1:-1] + across[2:]) / 6
    size = np.abs(second[inner])
    return max(1.4826 * float(np.median(size)) if size.size else 0.0, 12**-0.5)
