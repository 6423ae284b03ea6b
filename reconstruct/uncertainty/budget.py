"""The uncertainty of what is read off a height map, by its sources.

A reading is a weighted sum of heights. Noise adds by the weights' squares (a mean over an area is given the
noise of one of its pixels: neighbours share most of theirs); its sources (see `sources`) have their median
shares of the map's variance. The rig's errors are common to all heights: with f the weighted sum of the
modes, (r,), a source of shares A adds f^T A f; A of all sources sum to 1.
"""

from __future__ import annotations

import numpy as np

from optolever.arrays import Mask

from ..heightmap import HeightMap
from .sources import NOISE

__all__ = ["NOISE", "TOTAL", "budget"]

TOTAL, SINKING = "total", "even sinking of the mirror since rest"
_SHALLOW = 0.1  # of the deepest: what surrounds a dent
_PART = 0.01  # of the noise's variance: smaller sources count with the others


def budget(height: HeightMap, less: HeightMap | None = None) -> dict[str, dict[str, float]]:
    """Standard deviations in mm, by reading and source: noise first, TOTAL (their root sum square) last.

    Readings: the height at the deepest good point; the same over the mean of what is a tenth as deep or less
    (of a contact's depth, errors of the rig that its surroundings show are subtracted as well); with `less`,
    a map of the same rig, the deepest point of the difference.
    """
    good = height.good & np.isfinite(height.z) & np.isfinite(height.sigma)
    if not good.any():
        return {}
    at = _deepest(height, good)
    around = good & (height.z <= _SHALLOW * height.z[at])
    readings = {"height (deepest)": _one(height, at, None)}
    if around.any():
        readings["over surroundings (deepest)"] = _one(height, at, around)
    if less is not None:
        difference = height - less
        both = difference.good & np.isfinite(difference.z) & np.isfinite(difference.sigma)
        if both.any():
            place = _deepest(difference, both)
            readings["difference of maps"] = _one(difference, place, None)
    return readings


def _deepest(height: HeightMap, good: Mask) -> tuple[int, int]:
    """Row and column that is deepest even if noise made it so by three sigma."""
    row, col = divmod(int(np.argmax(np.where(good, height.z - 3 * height.sigma, -np.inf))), good.shape[1])
    return row, col


def _one(height: HeightMap, at: tuple[int, int], around: Mask | None) -> dict[str, float]:
    """Sources of the height at a pixel, less the mean around."""
    noise = float(height.sigma[at])
    if around is not None:
        noise = float(np.hypot(noise, np.median(height.sigma[around])))
    shares = {name: share for name, share in height.diagnostics.noise.items() if share > _PART} or {
        NOISE: 1.0
    }
    found = {name: noise * (share / sum(shares.values())) ** 0.5 for name, share in shares.items()}
    modes = height.calibration
    if modes is not None:
        moved = modes[:, at[0], at[1]] - (
            0.0 if around is None else np.nanmean(modes[:, around], axis=1, dtype=np.float64)
        )
        of_rig = np.eye(len(modes))[None] if height.shares is None else height.shares
        names = ("the numbers of the rig",) if height.shares is None else height.sources
        squares = np.einsum("i,sij,j->s", moved, of_rig, moved)
        found |= dict(zip(names, np.sqrt(np.maximum(squares, 0.0)).tolist(), strict=True))
    if around is None and height.sinking:
        found[SINKING] = height.sinking
    found[TOTAL] = float(np.linalg.norm(list(found.values())))
    return found
