"""The display's cells: read through a footprint smaller than a cell, a fringe carries stairs.

A camera pixel that averages w cells of the map reads u + e(u) instead of u, e = the sawtooth of the cells
low-passed: sum over k of (-1)^k T^(k^2) sinc(k w) sin(2 pi k u) / (pi k), where T = exp(-2 (pi b)^2) is what
a Gaussian blur of b cells leaves of the fundamental. For T = 1 its rms is (1 - w) / sqrt(12).

T is measured where nobody gave the blur: stairs gather the decoded coordinates at whole cells, and the
mean of cos(2 pi u) over pixels that sample the cells evenly is T sinc(w) for small e, tabled for the rest.
"""

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.blocks import over_rows

from .jit import kernel

__all__ = ["add_cell_term", "estimate_stairs"]

Map = NDArray[Any]
_SEGMENT = 32
_SEGMENTS = 512
_STEP = 0.02
#: Attenuation below which the stairs (under 0.003 px) are left out.
_NEGLIGIBLE = 0.012
#: Pixels on either side over which the gradient is taken: stairs themselves must not count as gradient.
_REACH = 8


def add_cell_term(
    coord: Map, sigma: Map, flags: Map, blur_px: float | None, measured: float | None = None
) -> None:
    """Add the rms of the stairs to sigma (H, W), in place; the footprint is the local gradient of coord.

    blur_px: rms blur, cells; None: read off the stairs, or where they cannot tell, `measured` otherwise.
    """
    attenuation, fill = estimate_stairs(coord, sigma, flags) if blur_px is None else (0.0, 1.0)
    known = measured if blur_px is None else blur_px
    if attenuation == 0 and known is not None:
        attenuation = float(np.exp(-2 * (np.pi * known) ** 2))
    if attenuation < _NEGLIGIBLE:
        return
    rows = coord.shape[0]
    over_rows(lambda start, stop: _stairs_rows(start, stop, rows, attenuation, fill, coord, sigma), rows, 64)


def estimate_stairs(coord: Map, sigma: Map, flags: Map) -> tuple[float, float]:
    """(T, fill): what blur leaves of the cells' fundamental, and the footprint over the gradient, both 0..1.

    T is 0 where the frames cannot tell (1:1 sampling); fill is below 1 only if the stairs are higher than a
    footprint that fills the gradient allows.
    """
    segments, noise = _segments(coord, sigma, flags)
    if len(segments) == 0:
        return 0.0, 1.0
    place = np.linspace(-1, 1, _SEGMENT)
    design = np.stack([np.ones(_SEGMENT), place, place**2], axis=1)
    fit = segments @ np.linalg.pinv(design).T @ design.T
    gradient = np.abs(np.diff(fit, axis=1)).mean(axis=1)
    even = np.abs(np.exp(2j * np.pi * fit).mean(axis=1)) < 0.3
    smooth = np.abs(segments - fit).max(axis=1) < 0.75 + 4 * noise
    keep = even & smooth & (gradient > 0.05)
    if np.count_nonzero(keep) < 8:
        return 0.0, 1.0
    seen = np.cos(2 * np.pi * segments[keep]).mean(axis=1) - np.cos(2 * np.pi * fit[keep]).mean(axis=1)
    seen *= np.exp(np.minimum(2 * (np.pi * noise[keep]) ** 2, 3.0))
    return _solve_stairs(seen, gradient[keep])


def _solve_stairs(seen: NDArray[np.float64], gradient: NDArray[np.float64]) -> tuple[float, float]:
    model = np.sinc(gradient)
    weight = float(np.sum(model**2))
    if weight < 1.0:
        return 0.0, 1.0
    attenuation = float(np.sum(seen * model)) / weight
    doubt = float(np.sqrt(np.sum((seen - attenuation * model) ** 2 * model**2))) / weight
    if attenuation < 4 * doubt:
        return 0.0, 1.0
    table = _gathering()
    column = np.minimum(np.rint(gradient / _STEP).astype(int), table.shape[1] - 1)
    misses = ((seen - table[:, column]) ** 2).sum(axis=1)
    best = int(np.argmin(misses))
    if best < len(table) - 1 or np.sum(seen) <= 1.05 * np.sum(table[-1, column]):
        return best / (len(table) - 1), 1.0
    fills = np.linspace(0, 1, 41)
    shares = [abs(float(np.sum(seen - table[-1, (column * fill).astype(int)]))) for fill in fills]
    return 1.0, float(fills[int(np.argmin(shares))])


@cache
def _gathering() -> NDArray[np.float64]:
    """Mean of cos(2 pi (u + e(u))) over a cell for T = 0, 1/40, ..., 1 (rows) and w = 0, 0.02, ..., 4."""
    place = (np.arange(64) + 0.5) / 64
    blur = np.linspace(0, 1, 41)[:, None, None]
    width = np.arange(0, 4 + _STEP / 2, _STEP)[None, :, None]
    error = np.zeros((41, width.shape[1], 64))
    for k in range(1, 17):
        part = blur ** (k * k) * np.sinc(k * width) / (np.pi * k)
        error += (-1) ** k * part * np.sin(2 * np.pi * k * place)
    mean: NDArray[np.float64] = np.cos(2 * np.pi * (place + error)).mean(axis=2)
    return mean


def _segments(coord: Map, sigma: Map, flags: Map) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Unflagged runs of pixels (K, 32) from all over the map, along rows, and their rms sigma (K,)."""
    rows, cols = coord.shape
    if cols < _SEGMENT:
        return np.zeros((0, _SEGMENT)), np.zeros(0)
    across = cols // _SEGMENT
    chosen = np.unique(np.linspace(0, rows - 1, max(1, _SEGMENTS // across)).astype(int))
    cut = (chosen, slice(0, across * _SEGMENT))
    good = (flags[cut].reshape(-1, _SEGMENT) == 0).all(axis=1)
    runs = coord[cut].reshape(-1, _SEGMENT)[good].astype(np.float64)
    noise = np.sqrt(np.mean(sigma[cut].reshape(-1, _SEGMENT)[good].astype(np.float64) ** 2, axis=1))
    return runs, noise


@kernel
def _stairs_rows(
    start: int, stop: int, rows: int, attenuation: float, fill: float, coord: Map, sigma: Map
) -> None:
    """sigma^2 += sum over k of (T^(k^2) sinc(k w_col) sinc(k w_row) / (pi k))^2 / 2, rows start..stop."""
    cols = coord.shape[1]
    for row in range(start, stop):
        above, below = max(row - _REACH, 0), min(row + _REACH, rows - 1)
        for col in range(cols):
            left, right = max(col - _REACH, 0), min(col + _REACH, cols - 1)
            along = fill * abs(coord[row, right] - coord[row, left]) / max(right - left, 1)
            down = fill * abs(coord[below, col] - coord[above, col]) / max(below - above, 1)
            if not (along < np.inf and down < np.inf):
                continue
            total = 0.0
            for k in range(1, 13):
                part = attenuation ** (k * k) / (np.pi * k)
                if part < 1e-4:
                    break
                for width in (along, down):
                    angle = np.pi * k * width
                    if angle > 1e-6:
                        part *= np.sin(angle) / angle
                total += 0.5 * part * part
            sigma[row, col] = np.sqrt(sigma[row, col] ** 2 + total)
