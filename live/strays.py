"""Pixels that do not show the fringe: a hair, dust, a drop, a dead line of the camera, not there at rest.

Where the residual is far above its median, the pixels of the largest residuals are left out and the frame is
fitted again, until all others agree. An object is darker than the fringe, or brighter; a fringe that the
model does not follow, as at a contact's rim, is both: then there is no second fit, but where the picture is
dark over a period. Where not all others agree in the end, the fit stays as it was."""

import cv2
import numpy as np

from .arrays import Cells, Frame, Mask, Pixels
from .chain import Rig, Settled, settle
from .picture import model

__all__ = ["settle_without_strays"]

_LARGE, _SMALL = 20.0, 6.0  # mean square residual of a cell over the median one: to begin, to end
_SIGMAS = 6.0  # of a grey value: residual of a stray pixel, at least
_OF_LARGEST, _REACH = 0.5, 9  # share of the largest residual among so many pixels
_ROUNDS = 8
_DARK_BOX, _DARK = 0.75, 0.5  # periods of a mean of the picture; of its median
_OTHERS = 0.2  # share of the square residuals left out that have the other sign, at most; of dents .4 to .6
_MOST = 0.05  # share of the pixels


def settle_without_strays(rig: Rig, frame: Frame, sigma: Cells) -> tuple[Settled, float]:
    """The fit of a frame, as `settle`'s, and the share of its lit pixels that it leaves out. sigma (R, C): of
    z, mm."""
    first = found = settle(rig, frame, sigma)
    if _largest(found) < _LARGE:
        return first, 0.0
    out, without = np.zeros(frame.shape, np.bool_), np.asarray(rig.carriers.full, frame.dtype)
    rest, limit = _rest(rig, frame, found)
    new, period = _largest_ones(np.abs(rest), limit), 2 * rig.carriers.spread * rig.carriers.cell
    if not _of_one_sign(rest[new]) and not _dark(rest, limit, frame, period):
        return first, 0.0
    for _ in range(_ROUNDS):
        out |= _largest_ones(np.where(out, np.float32(0), np.abs(rest)), limit)
        if not 0 < out.mean() < _MOST:
            break
        found = settle(rig, np.where(out, without, frame), sigma)  # as saturated: it does not enter
        rest, limit = _rest(rig, frame, found)
        if not _of_one_sign(rest[out]):
            break
        if _largest(found) < _SMALL:
            return found, float(np.count_nonzero(out) / np.count_nonzero(rig.carriers.lit))
    return first, 0.0


def _largest(found: Settled) -> float:
    """Residual of a cell with a height, over the median one."""
    return float(found.residual[found.good].max(initial=0.0)) / max(found.usual, 1e-6)


def _rest(rig: Rig, frame: Frame, found: Settled) -> tuple[Pixels, float]:
    """What the fit leaves (H, W), levels, and the size from which on it is no noise."""
    seen = (rig.carriers.lit > 0) & (frame < rig.carriers.full)
    rest = np.where(seen, frame - model(rig.carriers, found.state), np.float32(0))
    return rest, _SIGMAS * float(np.sqrt(max(found.usual, rig.noise)))


def _dark(rest: Pixels, limit: float, frame: Frame, period: float) -> bool:
    """Whether the picture (H, W) is dark over a period beside large residuals; period: pixels."""
    large = (np.abs(rest) > limit).astype(np.uint8)
    near = cv2.dilate(large, np.ones(_odd(period), np.uint8)) > 0
    mean = cv2.boxFilter(frame, cv2.CV_32F, _odd(_DARK_BOX * period))
    return bool(mean[near].min(initial=np.inf) < _DARK * np.median(mean[::4, ::4]))


def _odd(size: float) -> tuple[int, int]:
    """Side of a square of pixels with a middle, nearest to a size."""
    return (2 * round((size - 1) / 2) + 1,) * 2


def _largest_ones(size: Pixels, limit: float) -> Mask:
    """Pixels (H, W) above the limit whose residual is near the largest around."""
    largest = cv2.dilate(size, np.ones((_REACH, _REACH), np.uint8))
    return np.asarray((size > limit) & (size >= np.float32(_OF_LARGEST) * largest))


def _of_one_sign(rest: Pixels) -> bool:
    """Whether nearly all of the residuals (n,) are positive, or negative, by squares."""
    brighter, all_of_them = (float(np.sum(np.square(part))) for part in (np.maximum(rest, 0), rest))
    return min(brighter, all_of_them - brighter) < _OTHERS * all_of_them
