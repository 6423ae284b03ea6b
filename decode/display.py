"""Display model: a grid of cells, read through the footprint of a pixel and a blur.

A pixel at u takes the share W(k - u) of the light of cell k. W is the convolution of a box of the cell's
luminous part (cells have dark rims), a box of the w cells that the pixel covers, and a Gaussian of b cells. A
fringe of P cells is read as u + e(u),

    e(u) = P / 2 pi arg(sum over k of W(k - u) exp(2 pi i (k - u) / P)),

with the period of a cell: a sharp display gives treads of 1 - w with a constant reading. Several periods
share in the coordinate by their information N_j / P_j^2 (contrast_j)^2. The shift by rounded grey values is
not periodic: a table over the surface, for a pixel of median width.
"""

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d
from scipy.special import ndtr

from optolever.kernels import kernel
from optolever.patterns import Sequence

from .plan import AxisPlan, Fringe, plan

__all__ = [
    "FINE",
    "FINER",
    "PLACES",
    "WIDEST",
    "WIDTHS",
    "cell_error",
    "cell_light",
    "inverted",
    "rounded_places",
    "shares_of",
    "table_rounding",
    "take_off",
    "through",
]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
#: Tabulated places in a cell, and widths of a footprint (cells).
PLACES = 128
WIDEST = 2.5
WIDTHS = np.linspace(0.0, WIDEST, 51)
#: Parts of a cell, and blur (cells), at which rounded levels are read.
FINER, _HALF = 4, 0.5
#: Finer places at which readings are inverted.
FINE = 256


def shares_of(axis: AxisPlan) -> tuple[tuple[float, float], ...]:
    """Periods that share in the coordinate of an axis, and their information over the first's: N / P^2.

    The finest period alone of a ladder; all close periods; none for look-ups, whose tables hold cells.
    """
    fringes = _telling(axis)
    if not fringes:
        return ()
    weights = [len(fringe.index) / fringe.period**2 for fringe in fringes]
    return tuple((f.period, w / weights[0]) for f, w in zip(fringes, weights, strict=True))


def _telling(axis: AxisPlan) -> tuple[Fringe, ...]:
    """Fringes that share in the coordinate of an axis."""
    alone = axis.code is not None or (axis.fringes and axis.fringes[0].period >= axis.extent)
    return () if axis.looked_up else axis.fringes[-1:] if alone else axis.fringes


def cell_light(distance: F64, width: F64, blur: float, fill: float = 1.0) -> F64:
    """Share of a cell's light in a pixel, by the distance of their centres: box * box * Gaussian.

    distance, width (footprint, > 0), blur (rms), fill (luminous part of a cell): cells, arrays that
    broadcast. The second difference of the Gaussian integrated twice, R(t) = t Phi(t / b) + b phi(t / b),
    over both boxes.
    """
    spread = max(blur, 1e-3)

    def twice(t: F64) -> F64:
        z = t / spread
        return np.asarray(t * ndtr(z) + spread * np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi))

    far, near = (fill + width) / 2, (fill - width) / 2
    ends = twice(distance + far) - twice(distance + near) - twice(distance - near) + twice(distance - far)
    return np.asarray(ends / (fill * width))


@lru_cache(maxsize=64)
def cell_error(shares: tuple[tuple[float, float], ...], blur: float, fill: float = 1.0) -> F64:
    """e (W, FINE) in cells, by footprint (WIDTHS) and place in the cell.

    By Poisson's formula the sum over cells is one over m of W^(m - 1 / P) exp(-2 pi i m u), W^ being two
    sincs and a Gaussian.
    """
    cycles = np.fft.fftfreq(FINE, 1 / FINE)
    error, weight = np.zeros((2, len(WIDTHS), FINE))
    for period, share in shares:
        turns = cycles - 1 / period
        cell = np.sinc(fill * turns) * np.exp(-2 * np.square(np.pi * max(blur, 1 / FINE) * turns))
        seen = np.fft.fft(cell * np.sinc(WIDTHS[:, None] * turns), axis=1)
        own = share * np.abs(seen) ** 2
        error += own * period / (2 * np.pi) * np.angle(seen)
        weight += own
    # a pixel between the rims of sharp cells receives no light
    return np.asarray(error / np.maximum(weight, 1e-12))


@lru_cache(maxsize=64)
def inverted(
    shares: tuple[tuple[float, float], ...], blur: float, sigma: float, fill: float = 1.0
) -> tuple[F32, F32]:
    """E[u] - reading, and Var[u] less the noise variance, (W, PLACES), cells; sigma: noise of readings."""
    at, noise = np.arange(FINE) / FINE, np.float32(max(sigma, 1.5 / FINE))
    reading = at + cell_error(shares, blur, fill)
    place = (np.arange(PLACES) / PLACES)[:, None]
    away = (place - reading[:, None, :]).astype(np.float32)
    away -= np.rint(away)
    weight = np.exp(np.float32(-0.5) * np.square(away / noise)) + np.float32(1e-30)
    weight /= weight.sum(axis=2, keepdims=True)
    truth = (at - place).astype(np.float32)
    truth -= np.rint(truth)
    shift = np.einsum("wpf,pf->wp", weight, truth)
    return shift, np.einsum("wpf,pf->wp", weight, np.square(truth)) - np.square(shift) - noise * noise


def table_rounding(fringe: Fringe, tables: NDArray[np.uint8]) -> F64:
    """Phase error (extent,), turns, of every cell by the rounding of its grey values; tables (N, extent)."""
    c, s = fringe.inverse[1:] @ tables[list(fringe.index)].astype(np.float64)
    turns = np.arctan2(s, c) / (2 * np.pi) - np.arange(tables.shape[1]) / fringe.period
    return np.asarray(turns - np.rint(turns))


@lru_cache(maxsize=16)
def rounded_places(name: str, sequence: Sequence, width: float) -> F32:
    """Excess of an axis' readings by rounding of displayed grey values, by place in parts of a cell
    (FINER * extent + 1,), the last one twice; for pixels of `width` cells and a blur of half a cell.

    Joint least squares for offset, contrast and place, for each period that shares in the coordinate.
    """
    axis = next(one for one in plan(sequence).axes if one.axis == name)
    fringes, tables = _telling(axis), sequence.tables()["uv".index(name)]
    moved, weight = np.zeros((2, axis.extent * FINER))
    for fringe in fringes:
        levels = tables[list(fringe.index)].astype(np.float64)
        shown = _design(fringe, np.arange(axis.extent))
        usual = (np.linalg.pinv(shown) @ levels.T[..., None]).mean(axis=0) * [[1], [1], [0]]
        rounding = levels - (shown @ usual)[..., 0].T
        fine = _design(fringe, np.arange(axis.extent * FINER) / FINER)
        turned = fine.transpose(0, 2, 1)
        inverse = np.linalg.inv(turned @ fine)
        _, contrast, _ = (inverse @ (turned @ through(levels, width)))[..., 0].T
        moves = (inverse @ (turned @ through(rounding, width)))[:, 2, 0]
        moved += moves / contrast / inverse[:, 2, 2]
        weight += 1 / inverse[:, 2, 2]
    places = (moved / weight).astype(np.float32)
    return np.append(places, places[-1])


def _design(fringe: Fringe, place: NDArray[Any]) -> F64:
    """Derivatives (K, N, 3) of a fringe's levels by offset, contrast and place (K,), at contrast 1."""
    wave = 2 * np.pi / fringe.period
    phase = wave * place[:, None] - fringe.shifts
    waves = np.stack([np.ones_like(phase), np.cos(phase), -wave * np.sin(phase)], axis=2)
    return np.asarray(fringe.exposure[:, None] * waves)


def through(levels: F64, width: float) -> F64:
    """Levels (N, extent) of cells as read by pixels at parts of a cell, (FINER * extent, N, 1)."""
    reach = math.ceil(width / 2 + 3)
    distance = np.arange(-reach, reach + 1) - np.arange(FINER)[:, None] / FINER
    light = cell_light(distance, np.array(width), _HALF)
    seen = np.stack([correlate1d(levels, part, axis=1, mode="nearest") for part in light], axis=2)
    return seen.reshape(len(levels), -1).T[..., None]


@kernel
def take_off(coord: F32, table: F32) -> None:
    """Subtract a table (see rounded_places) at coordinates (H, W), linearly interpolated, in place."""
    zero, last, finer, one = np.float32(0), np.float32(table.size - 2), np.float32(FINER), np.int32(1)
    for y in range(coord.shape[0]):
        line = coord[y]
        for x in range(line.size):
            at = finer * line[x]
            at = at if at > zero else zero
            at = at if at < last else last
            low = np.int32(at)
            # no place is negative: unsigned indices need no wrap-around
            here, after = table[np.uint32(low)], table[np.uint32(low + one)]
            line[x] -= here + (at - np.float32(low)) * (after - here)
