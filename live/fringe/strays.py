"""Pixels that do not show the fringe: a hair, dust, a drop, a dead line of the camera, not there at rest.

Dark areas are left out at once. Where the residual is then far above its median, the pixels of the largest
residuals are left out and the frame is fitted again, until all others agree. An object is darker than the
fringe, or brighter; a fringe that the model does not follow, as at a contact's rim, is both: then there is no
second fit, and where not all others agree in the end, the fit stays as it was."""

import cv2
import numpy as np

from optolever.arrays import Cells, Frame, Mask, Pixels

from .chain import LEAST_SHARE, Rig, Settled, settle
from .picture import model, window_mean

__all__ = ["settle_without_strays"]

_LARGE, _SMALL = 20.0, 6.0  # mean square residual of a cell over the median one: to begin, to end
_SIGMAS = 6.0  # of a grey value: residual of a stray pixel, at least
_OF_LARGEST, _REACH = 0.5, 9  # share of the largest residual among so many pixels
_ROUNDS = 8
_DARK, _OUT, _LOST = 0.5, 5, 7  # level over that at rest, of its median; cells across that are left out, lost
_ASKED, _OTHERS = 0.35, 0.2  # of the rarer sign: share of the largest squares, of all left out; dents: .4, .5
_MOST = 0.05  # share of the pixels


def settle_without_strays(rig: Rig, frame: Frame, sigma: Cells) -> tuple[Settled, float]:
    """The fit of a frame, as `settle`'s, and the share of its lit pixels that it leaves out, without dark
    areas. sigma (R, C): of z, mm."""
    without, dark = np.asarray(rig.carriers.full, frame.dtype), _dark(rig, frame)
    if not dark.any():
        return _without_strays(rig, frame, sigma)
    across = np.kron(_beside(dark, _OUT), np.ones((rig.carriers.cell,) * 2, np.bool_))
    found, strays = _without_strays(rig, np.where(across, without, frame), sigma)
    found.good[_beside(dark, _LOST)] = False  # their windows end there
    return found, strays


def _without_strays(rig: Rig, frame: Frame, sigma: Cells) -> tuple[Settled, float]:
    first = found = settle(rig, frame, sigma)
    if _largest(found) < _LARGE:
        return first, 0.0
    out, without = np.zeros(frame.shape, np.bool_), np.asarray(rig.carriers.full, frame.dtype)
    rest, limit = _rest(rig, frame, found)
    for _ in range(_ROUNDS):
        new = _largest_ones(np.where(out, np.float32(0), np.abs(rest)), limit)
        if found is first and _others(rest[new]) > _ASKED:
            break
        out |= new
        if not 0 < out.mean() < _MOST:
            break
        found = settle(rig, np.where(out, without, frame), sigma)  # as saturated: it does not enter
        rest, limit = _rest(rig, frame, found)
        if _others(rest[out]) > _OTHERS:
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


def _dark(rig: Rig, frame: Frame) -> Mask:
    """Cells (R, C) of areas of a period and more that are dark beside the level at rest: a drop, a speck, or
    an object that ends total reflection where it touches."""
    carriers = rig.carriers
    whole = np.maximum(carriers.share, np.float32(LEAST_SHARE))
    cells = cv2.resize(frame * carriers.lit, carriers.shape[::-1], interpolation=cv2.INTER_AREA)
    mean = window_mean(np.asarray(cells, np.float32), carriers.window) / whole
    ratio = mean / np.maximum(rig.rest.level, 1)
    return np.asarray(rig.lit & (ratio < np.float32(_DARK) * np.median(ratio[rig.lit])))


def _beside(dark: Mask, across: int) -> Mask:
    """With the cells around, so many across."""
    return cv2.dilate(dark.astype(np.uint8), np.ones((across, across), np.uint8)) > 0


def _largest_ones(size: Pixels, limit: float) -> Mask:
    """Pixels (H, W) above the limit whose residual is near the largest around."""
    largest = cv2.dilate(size, np.ones((_REACH, _REACH), np.uint8))
    return np.asarray((size > limit) & (size >= np.float32(_OF_LARGEST) * largest))


def _others(rest: Pixels) -> float:
    """Share of the squares of residuals (n,) that have the rarer sign; 0 of none."""
    brighter, every = (float(np.sum(np.square(part))) for part in (np.maximum(rest, 0), rest))
    return min(brighter, every - brighter) / max(every, 1e-6)
