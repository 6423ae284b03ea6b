"""Any pattern whatever: the Cramer-Rao bound and the risk of confusion from the levels that it shows.

With I_n(u) what sample n of a pixel reads at u, noise of variance s^2 allows no better than
sigma_u^2 = s^2 / sum_n (dI_n / du)^2, and takes u for u' with Q(|I(u) - I(u')| / (2 s)).
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, map_coordinates, uniform_filter1d
from scipy.special import erfc

from optolever.patterns import Frame, Sequence

from .view import Floats, Levels, View

__all__ = ["free_code", "rounding_error", "seen_levels"]

PER_CELL = 4  # samples of the seen levels in a cell
FAR = 2.0  # cells: what is closer is no confusion but noise


def seen_levels(
    frames: list[Frame], sequence: Sequence, axis: str, width: float, blur: float
) -> NDArray[np.float64]:
    """Share of full light (N, K) that pixels of `width` cells read at -0.5 + (k + 0.5) / PER_CELL."""
    tables = np.stack([f.tables(sequence.rows, sequence.cols)["uv".index(axis)] for f in frames])
    return _seen(tables / 255.0, width, blur)


def _seen(light: Floats, width: float, blur: float) -> Floats:
    fine = np.repeat(light, PER_CELL, axis=1)
    if blur > 0:
        fine = gaussian_filter1d(fine, blur * PER_CELL, axis=1, mode="constant")
    size = max(1, round(width * PER_CELL))
    seen: Floats = uniform_filter1d(fine, size, axis=1, mode="constant") if size > 1 else fine
    return seen


def rounding_error(view: View, sequence: Sequence, axis: str, frames: list[Frame]) -> Floats:
    """Error (cells, (H, W)) of swept stripes that are shown in whole grey values and decoded as if they were
    not: the least-squares place moves by sum(I' dI) / sum(I'^2). Other free codes are known value by value.
    """
    coord = view.coordinate(axis)
    swept = [frame for frame in frames if frame.kind == "stripe"]
    if not swept:
        return np.zeros(coord.shape)
    width = float(np.nanmedian(np.hypot(*view.widths[axis])))
    blur, cells = view.scene.pattern.blur_px, np.arange(view.extent(axis))
    tables = np.stack([f.tables(sequence.rows, sequence.cols)["uv".index(axis)] for f in swept]) / 255.0
    exact = np.stack([_stripe(frame, axis, cells) for frame in swept])
    slope = np.gradient(_seen(exact, width, blur), 1 / PER_CELL, axis=1)
    moved = np.sum(slope * _seen(tables - exact, width, blur), axis=0) / np.maximum(
        np.sum(slope**2, axis=0), 1e-12
    )
    return _at(coord, moved)


def _stripe(frame: Frame, axis: str, cells: NDArray[np.int64]) -> Floats:
    """Light of a stripe, before it is rounded."""
    centre = (frame.at_u if axis == "u" else frame.at_v) or 0.0
    distance = np.abs(cells - centre) / (frame.width_px or 1.0)
    return np.where(distance < 1, 0.5 + 0.5 * np.cos(np.pi * distance), 0.0)


def _at(coord: Floats, table: Floats) -> Floats:
    at = (np.nan_to_num(coord) + 0.5) * PER_CELL - 0.5
    return np.asarray(map_coordinates(table, [at], order=1, mode="nearest"))


def free_code(
    view: View, sequence: Sequence, levels: Levels, axis: str, frames: list[Frame]
) -> tuple[Floats, Floats]:
    """(noise in cells, probability of confusion), (H, W), for frames of any levels along an axis."""
    widths = view.widths[axis]
    width = float(np.nanmedian(np.hypot(*widths)))
    seen = seen_levels(frames, sequence, axis, width, view.scene.pattern.blur_px)
    slope = np.gradient(seen, 1 / PER_CELL, axis=1)
    steepness = np.sqrt((slope**2).sum(axis=0))
    distance = _confusion(seen)
    here, apart = (_at(view.coordinate(axis), table) for table in (steepness, distance))
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
