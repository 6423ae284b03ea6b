"""The display's cells: read through a footprint smaller than a cell, a fringe carries stairs.

A camera pixel that averages w cells of the map reads u + e(u) instead of u. Cells turn a fringe of P cells
into itself and sidebands of frequency 1/P + m,

    e = P / 2 pi arg(1 + sum over m of A_m exp(2 pi i m u)),   A_m = (-1)^m / (1 + m P) sinc((1/P + m) w) /
        sinc(w/P) T^(m^2 + 2 m / P),

T = exp(-2 (pi b)^2) being what a Gaussian blur of b cells leaves of a frequency of one per cell. For T = 1
and P >> 1, e is the sawtooth of the cells averaged over w, rms (1 - w) / sqrt(12): treads of 1 - w on which u
cannot be told, and risers between them on which it can. u + e(u) is inverted for u.

T is measured where nobody gave the blur: stairs gather the decoded coordinates at whole cells, and the
mean of cos(2 pi u) over pixels that sample the cells evenly is T sinc(w) for small e, tabled for the rest.
"""

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.blocks import over_rows

from .jit import kernel
from .sample import quantile

__all__ = ["take_off_stairs"]

Map = NDArray[Any]
_SEGMENT = 32
#: Lines, pairs of neighbours on each and least distance of these that tell along which axis a coordinate
#: changes.
_LINES, _PAIRS, _APART = 16, 64, 8
_SEGMENTS = 512
_STEP = 0.02
#: sinc(w) from which on a run of pixels tells the height of the stairs.
_TOLD = 0.15
#: Attenuation below which the stairs (under 0.003 px) are left out.
_NEGLIGIBLE = 0.012
#: Harmonics of the stairs, steps of the inversion.
_TERMS, _STEPS = 8, 4
#: Share of the stairs' variance that is reckoned as unknown: footprint and blur are estimates.
_DOUBT = 0.02
#: Pixels on either side over which the gradient is taken: stairs themselves must not count as gradient.
_REACH = 8


def take_off_stairs(
    period: float,
    coord: Map,
    sigma: Map,
    flags: Map,
    blur_px: float | None,
    measured: float | None = None,
) -> None:
    """Undo the stairs in coord (H, W) and add to sigma (H, W) what cannot be undone, in place.

    period: of the finest fringe. The footprint is the local gradient of coord. A pixel that sees one cell
    only (a tread of the stairs) is put at its middle, with the rms (1 - w) / sqrt(12) of a place on it.
    blur_px: rms blur, cells; None: read off the stairs, or where they cannot tell, `measured` otherwise.
    """
    attenuation, fill = 0.0, 1.0
    if blur_px is not None:
        attenuation = _left_by(blur_px)
    else:
        turned = _along_the_change(coord, sigma, flags)
        seen, gradient = _gathered(*turned)
        attenuation, fill = _solve_stairs(seen, gradient)
        if fill == 1:
            attenuation = _of_period(attenuation, period, turned[0])
        if attenuation == 0 and measured is not None:
            attenuation = _left_by(measured)
            if _contradicted(_height(attenuation, gradient, period), seen):
                return
    if attenuation < _NEGLIGIBLE:
        return
    rows = coord.shape[0]
    before = coord.copy()
    over_rows(
        lambda start, stop: _undo_rows(start, stop, rows, period, attenuation, fill, before, coord, sigma),
        rows,
        64,
    )


def _left_by(blur_px: float) -> float:
    """T of a Gaussian blur, rms in cells."""
    return float(np.exp(-2 * (np.pi * blur_px) ** 2))


def _along_the_change(coord: Map, sigma: Map, flags: Map) -> tuple[Map, Map, Map]:
    """The maps, turned if coord changes more from row to row than from column to column."""
    rows, cols = (max(1, n // _LINES) for n in coord.shape)
    if _change(coord.T[::cols]) > _change(coord[::rows]):
        return coord.T, sigma.T, flags.T
    return coord, sigma, flags


def _change(lines: Map) -> float:
    """Usual step between neighbours along lines (R, W); 0 where there are none."""
    apart = max(_APART, lines.shape[1] // _PAIRS)
    steps = np.abs(lines[:, apart::apart] - lines[:, apart - 1 : -1 : apart])
    known = steps[np.isfinite(steps)]
    return quantile(known, 0.5) if known.size else 0.0


def _contradicted(model: Map, seen: Map) -> bool:
    """Whether coordinates surely gather at whole cells by less than half of what the model says.

    That is so for ideal cosines that no cells showed, whose contrast looks like that of a sharp display.
    """
    weight = float(np.sum(model**2))
    if len(seen) < 8 or weight == 0:
        return False
    share = float(np.sum(seen * model)) / weight
    doubt = float(np.sqrt(np.sum((seen - share * model) ** 2 * model**2))) / weight
    return share + 4 * doubt < 0.5


def _gathered(coord: Map, sigma: Map, flags: Map) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """By how much runs of pixels gather at whole cells (K,), and their gradients (K,)."""
    segments, noise = _segments(coord, sigma, flags)
    if len(segments) == 0:
        return np.zeros(0), np.zeros(0)
    # einsum: the threads of a matrix product take longer to wake up than this takes
    fit = np.einsum("kb,bs->ks", np.einsum("ks,bs->kb", segments, _parabolas()), _parabolas())
    gradient = np.abs(np.diff(fit, axis=1)).mean(axis=1)
    mean = _phasors(fit)
    even = np.abs(mean) < 0.3
    smooth = np.abs(segments - fit).max(axis=1) < 0.75 + 4 * noise
    keep = even & smooth & (gradient > 0.05) & _like_stairs(segments - fit, fit, noise)
    seen = (_phasors(segments) - mean)[keep].real
    seen *= np.exp(np.minimum(2 * (np.pi * noise[keep]) ** 2, 3.0))
    return seen, gradient[keep]


def _like_stairs(
    residual: NDArray[np.float64], fit: NDArray[np.float64], noise: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Runs whose residual is stairs and noise: of a sawtooth the fundamental holds 61 %, of a bend less."""
    wave = np.sin((2 * np.pi * (fit - np.rint(fit))).astype(np.float32))
    stairs = np.sum(residual * wave, axis=1) ** 2 / np.sum(wave**2, axis=1)
    left = np.sum(residual**2, axis=1) - stairs
    most = _SEGMENT * noise**2 * (1 + 5 * np.sqrt(2 / _SEGMENT))
    return np.asarray(left <= stairs + most)


def _phasors(coord: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Means of exp(2 pi i coord) over each segment."""
    # single precision is exact to 1e-7 and three times as fast
    angle = (2 * np.pi * (coord - np.rint(coord))).astype(np.float32)
    return np.asarray(np.cos(angle).mean(axis=1) + 1j * np.sin(angle).mean(axis=1))


def _of_period(attenuation: float, period: float, coord: Map) -> float:
    """T from the T of an endless period, whose stairs are lower, at the usual footprint."""
    if attenuation <= 0:
        return attenuation
    change = np.abs(np.diff(coord[:: max(1, coord.shape[0] // 64)], axis=1))
    width = np.minimum(np.nanmedian(change), 0.9)
    trial = np.linspace(0, 1, 2001)
    height = _height(trial, width, period)
    return float(trial[np.argmin(np.abs(height - attenuation * np.sinc(width)))])


def _height(attenuation: Map | float, width: Map | float, period: float) -> Map:
    """How much stairs gather coordinates at whole cells: mean of cos(2 pi u), to first order.

    For an endless period they are (T sinc(w) / pi) sin(2 pi u) high, for P cells (1 / 2 pi) (R_1 / (1 + 1/P)
    + R_-1 / (1 - 1/P)) sin(2 pi u), R_m = T^(1 + 2 m / P) sinc((m + 1/P) w) / sinc(w / P).
    """
    f = 1 / period
    sides = [attenuation ** (1 + 2 * m * f) * np.sinc((m + f) * width) / (1 + m * f) for m in (1, -1)]
    return np.asarray(0.5 * (sides[0] + sides[1]) / np.sinc(f * width))


def _solve_stairs(seen: NDArray[np.float64], gradient: NDArray[np.float64]) -> tuple[float, float]:
    """(T, fill): what blur leaves of the cells' fundamental, and the footprint over the gradient, both 0..1.

    T is 0 where the frames cannot tell (1:1 sampling); fill is below 1 only if the stairs are higher than a
    footprint that fills the gradient allows.
    """
    if len(seen) < 8:
        return 0.0, 1.0
    model = np.sinc(gradient)
    # near 1:1 sampling stairs hardly show, and what little is seen would be blown up to any T
    told = np.abs(model) > _TOLD
    seen, gradient, model = seen[told], gradient[told], model[told]
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
def _parabolas() -> NDArray[np.float64]:
    """Orthonormal basis of the parabolas over a segment (3, _SEGMENT)."""
    place = np.linspace(-1, 1, _SEGMENT)
    basis = np.linalg.qr(np.stack([np.ones(_SEGMENT), place, place**2], axis=1))[0]
    return np.ascontiguousarray(basis.T)


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
    """Unflagged runs of pixels (K, 32) from all over the map, along rows, and their usual sigma (K,)."""
    rows, cols = coord.shape
    if cols < _SEGMENT:
        return np.zeros((0, _SEGMENT)), np.zeros(0)
    across = cols // _SEGMENT
    chosen = np.unique(np.linspace(0, rows - 1, max(1, _SEGMENTS // across)).astype(int))
    cut = (chosen, slice(0, across * _SEGMENT))
    good = (flags[cut].reshape(-1, _SEGMENT) == 0).all(axis=1)
    runs = coord[cut].reshape(-1, _SEGMENT)[good].astype(np.float64)
    noise = np.partition(sigma[cut].reshape(-1, _SEGMENT)[good], _SEGMENT // 2, axis=1)[:, _SEGMENT // 2]
    return runs, noise.astype(np.float64)


@kernel
def _undo_rows(
    start: int,
    stop: int,
    rows: int,
    period: float,
    attenuation: float,
    fill: float,
    seen: Map,
    coord: Map,
    sigma: Map,
) -> None:
    """coord: solution of coord + e(coord) = seen, by steps of w (exact on a riser, none on a tread)."""
    cols = coord.shape[1]
    bands = np.empty((2, _TERMS))
    for row in range(start, stop):
        above, below = max(row - _REACH, 0), min(row + _REACH, rows - 1)
        for col in range(cols):
            left, right = max(col - _REACH, 0), min(col + _REACH, cols - 1)
            along = fill * abs(seen[row, right] - seen[row, left]) / max(right - left, 1)
            down = fill * abs(seen[below, col] - seen[above, col]) / max(below - above, 1)
            if not (along < np.inf and down < np.inf):
                continue
            total = _sidebands(period, attenuation, along, down, bands)
            target, place = seen[row, col], seen[row, col]
            step = min(max(along, down), 1.0)
            slope = 0.0
            for _ in range(_STEPS):
                error, slope = _stairs(period, bands, place)
                place += step * (target - place - error)
            steep = max(1 + slope, 1e-3)
            noise = sigma[row, col] ** 2
            coord[row, col] = place
            sigma[row, col] = np.sqrt(min(noise / (steep * steep), noise + total) + _DOUBT * total)


@kernel
def _sidebands(period: float, attenuation: float, along: float, down: float, bands: Map) -> float:
    """bands (2, K): amplitudes A_m of m = 1, 2, ... and -1, -2, ...; returns the variance of the stairs."""
    q = 1 / period
    for side in range(2):
        for k in range(bands.shape[1]):
            m = (k + 1) * (1 - 2 * side)
            part = attenuation ** (m * m + 2 * q * m) / (1 + m * period)
            for width in (along, down):
                part *= _sinc((q + m) * width) / _sinc(q * width)
            bands[side, k] = -part if k % 2 == 0 else part
    total = 0.0
    for k in range(bands.shape[1]):
        total += 0.5 * ((bands[0, k] - bands[1, k]) * period / (2 * np.pi)) ** 2
    return total


@kernel
def _sinc(x: float) -> float:
    angle = np.pi * x
    return np.sin(angle) / angle if abs(angle) > 1e-6 else 1.0


@kernel
def _stairs(period: float, bands: Map, place: float) -> tuple[float, float]:
    """e and its derivative at a coordinate; sin and cos of multiples by rotation."""
    turn = 2 * np.pi * (place - np.rint(place))
    one_c, one_s = np.cos(turn), np.sin(turn)
    c, s = 1.0, 0.0
    real, imag, d_real, d_imag = 1.0, 0.0, 0.0, 0.0
    for k in range(bands.shape[1]):
        c, s = c * one_c - s * one_s, s * one_c + c * one_s
        both, odd = bands[0, k] + bands[1, k], bands[0, k] - bands[1, k]
        real += both * c
        imag += odd * s
        d_real -= (k + 1) * both * s
        d_imag += (k + 1) * odd * c
    power = real * real + imag * imag
    return period / (2 * np.pi) * np.arctan2(imag, real), period * (real * d_imag - imag * d_real) / power
