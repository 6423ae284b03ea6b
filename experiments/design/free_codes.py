"""Any pattern whatever: the Cramer-Rao bound and the risk of confusion from the levels that it shows.

With I_n(u) what sample n of a pixel reads at u, noise of variance s^2 allows no better than
sigma_u^2 = s^2 / sum_n (dI_n / du)^2, and takes u for u' with Q(|I(u) - I(u')| / (2 s)).
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve1d, gaussian_filter1d, map_coordinates
from scipy.special import erfc

from optolever.patterns import Frame, Sequence

from .view import Floats, Levels, View

__all__ = ["at_places", "free_code", "seen_profiles"]

PER_CELL = 4  # samples of the seen levels in a cell
FAR = 2.0  # cells: what is closer is no confusion but noise


def seen_profiles(
    shown: Sequence, axis: str, width: float, blur: float, per_cell: int = PER_CELL
) -> NDArray[np.float64]:
    """Share of full light (N, K) that pixels of `width` cells read of each frame at -0.5 + (k + 0.5) /
    per_cell along an axis; a frame is the product of both."""
    along = "uv".index(axis)
    tables = np.stack([frame.tables(shown.rows, shown.cols)[along] for frame in shown.frames])
    fine = np.repeat(tables / 255.0, per_cell, axis=1)
    if blur > 0:
        fine = gaussian_filter1d(fine, blur * per_cell, axis=1, mode="constant")
    reach = 0.5 * max(width * per_cell, 1.0)
    place = np.arange(-math.ceil(reach), math.ceil(reach) + 1)
    box = np.clip(reach + 0.5 - np.abs(place), 0.0, 1.0)
    return np.asarray(convolve1d(fine, box / box.sum(), axis=1, mode="constant"))


def at_places(coord: Floats, table: Floats, per_cell: int = PER_CELL) -> Floats:
    """A table (K,) at coordinates, see seen_profiles."""
    at = (np.nan_to_num(coord) + 0.5) * per_cell - 0.5
    return np.asarray(map_coordinates(table, [at], order=1, mode="nearest"))


def free_code(
    view: View, sequence: Sequence, levels: Levels, axis: str, frames: list[Frame]
) -> tuple[Floats, Floats]:
    """(noise in cells, probability of confusion), (H, W), for frames of any levels along an axis."""
    widths = view.widths[axis]
    width = float(np.nanmedian(np.hypot(*widths)))
    shown = Sequence(tuple(frames), sequence.rows, sequence.cols)
    # of frames that are the same all over, the other table may hold what makes them dark
    other = [frame.tables(shown.rows, shown.cols)[1 - "uv".index(axis)][0] / 255.0 for frame in frames]
    seen = seen_profiles(shown, axis, width, view.scene.pattern.blur_px) * np.array(other)[:, None]
    slope = np.gradient(seen, 1 / PER_CELL, axis=1)
    steepness = np.sqrt((slope**2).sum(axis=0))
    distance = _confusion(seen)
    here, apart = (at_places(view.coordinate(axis), table) for table in (steepness, distance))
    deviation = np.sqrt(levels.variance(levels.half))
    with np.errstate(divide="ignore"):
        noise = deviation / (2 * levels.half * here)
    failure = 0.5 * erfc(2 * levels.half * apart / (2 * math.sqrt(2) * deviation))
    return np.asarray(noise), np.asarray(failure)


def _confusion(seen: Floats) -> Floats:
    """Distance (K,) of each place's levels from the most similar ones elsewhere."""
    count = seen.shape[1]
    square = (seen**2).sum(axis=0)
    nearest = np.empty(count)
    place = np.arange(count)
    for start in range(0, count, 256):
        part = slice(start, min(start + 256, count))
        apart = square[part, None] + square - 2 * seen[:, part].T @ seen
        apart[np.abs(place[part, None] - place) < FAR * PER_CELL] = np.inf
        nearest[part] = np.sqrt(np.maximum(apart.min(axis=1), 0.0))
    return nearest
