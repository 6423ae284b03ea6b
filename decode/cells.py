"""The display's cells: read through a footprint smaller than a cell, a fringe carries stairs.

A camera pixel that averages w cells of the map reads u + e(u) instead of u. Cells turn a fringe of P cells
into itself and sidebands of frequency 1/P + m,

    e = P / 2 pi arg(1 + sum over m of A_m exp(2 pi i m u)),   A_m = (-1)^m / (1 + m P) sinc((1/P + m) w) /
        sinc(w/P) T^(m^2 + 2 m / P),

T = exp(-2 (pi b)^2) being what a Gaussian blur of b cells leaves of a frequency of one per cell. For T = 1
and P >> 1, e is the sawtooth of the cells averaged over w, rms (1 - w) / sqrt(12): treads of 1 - w on which u
cannot be told, and risers between them on which it can. u + e(u) is inverted for u.

A coordinate that several periods share in has the mean of their stairs, weighed by their contrasts. T is
measured where nobody gave the blur (see gathering).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.blocks import over_rows

from .gathering import contradicted, gathered, solve_stairs
from .plan import Fringe
from .sample import quantile
from .stairs_kernels import undo_rows
from .unwrap_kernels import MUCH_FINER

__all__ = ["take_off_stairs"]

Map = NDArray[Any]
F64 = NDArray[np.float64]
#: Lines, pairs of neighbours on each and least distance of these that tell along which axis a coordinate
#: changes.
_LINES, _PAIRS, _APART = 16, 64, 8
#: Attenuation below which the stairs (under 0.003 px) are left out.
_NEGLIGIBLE = 0.012
#: Harmonics of the stairs, at most; what blur leaves of one that does not matter.
_TERMS, _WEAK = 8, 1e-5


def take_off_stairs(
    fringes: tuple[Fringe, ...],
    coord: Map,
    sigma: Map,
    flags: Map,
    blur_px: float | None,
    measured: float | None = None,
) -> None:
    """Undo the stairs in coord (H, W) and add to sigma (H, W) what cannot be undone, in place.

    fringes: from coarse to fine. The footprint is the local gradient of coord. A pixel that sees one cell
    only (a tread of the stairs) is put at its middle, with the rms (1 - w) / sqrt(12) of a place on it.
    blur_px: rms blur, cells; None: read off the stairs, or where they cannot tell, `measured` otherwise.
    """
    attenuation, fill = 0.0, 1.0
    shares = _shares(fringes)
    if blur_px is not None:
        attenuation = _left_by(blur_px)
    else:
        turned = _along_the_change(coord, sigma, flags)
        seen, gradient = gathered(*turned)
        attenuation, fill = solve_stairs(seen, gradient, shares)
        if attenuation == 0 and measured is not None:
            attenuation = _left_by(measured)
            if contradicted(attenuation, seen, gradient, shares):
                return
    if attenuation < _NEGLIGIBLE:
        return
    rows, stairs = coord.shape[0], _of_points(shares, attenuation)
    before = coord.copy()
    over_rows(
        lambda start, stop: undo_rows(start, stop, rows, *stairs, fill, before, coord, sigma),
        rows,
        64,
    )


def _shares(fringes: tuple[Fringe, ...]) -> F64:
    """Periods whose mean a coordinate is, and their shares in it (G, 2), as in unwrap_kernels."""
    periods = [fringe.period for fringe in fringes]
    first = max((g for g in range(1, len(periods)) if periods[g] * MUCH_FINER < periods[g - 1]), default=0)
    told = np.array([len(fringe.index) / fringe.period**2 for fringe in fringes[first:]])
    return np.stack([np.array(periods[first:]), told / told.sum()], axis=1)


def _of_points(shares: F64, attenuation: float) -> tuple[F64, F64, F64]:
    """Periods, their shares by what cells and blur leave of them, and sidebands (G, 2, K) seen by a point."""
    period, share = shares.T
    terms = np.arange(1, _TERMS + 1)
    # the strongest of each order is that of m = -k of the finest period
    seen = attenuation ** (terms**2 - 2 * terms / period.min()) > _WEAK
    m = np.stack([terms, -terms])[:, : max(1, np.count_nonzero(seen))]
    left = attenuation ** (m**2 + 2 * m / period[:, None, None])
    weight = share * (np.sinc(1 / period) * attenuation**period**-2) ** 2
    return period, weight, (-1.0) ** m * left / (1 + m * period[:, None, None])


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
