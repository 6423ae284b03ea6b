"""Weighted Poisson problems on pixel edges: min sum_e w_e (x_j - x_i - g_e)^2, i.e. D^T w D x = D^T w g.

Weights that depend on the column alone separate: a DCT-II along the rows diagonalises that axis (the Neumann
Laplacian needs no boundary terms), one tridiagonal M-matrix per mode remains along the columns.
Its elimination is written in Schur excesses (Grassmann, Taksar, Heyman, doi:10.1287/opre.33.5.1107): sums of
positive numbers only,
so that weight ratios of 1e14 cost no digits. Anything else - weights of both axes, masks - is for `masked`.
"""

from dataclasses import dataclass

import numpy as np
import scipy.fft

from optolever.blocks import over_image, threads
from optolever.kernels import exact

from ..arrays import Floats

__all__ = ["Accuracy", "ColumnPoisson", "PoissonResult", "column_profile"]

#: What a solve in float32 leaves of its peak, at most (4 Mpx: 5e-7, of pure noise 2e-5).
_SINGLE = 1e-4
_ABREAST = 8  # modes


@dataclass(frozen=True, slots=True)
class PoissonResult:
    """A solution (free constant arbitrary), the iterations it took and its energy error estimate.

    error: square root of the last preconditioned residual's energy, in units of the edges' standard
    deviations.
    """

    x: Floats
    iterations: int
    error: float


@dataclass(frozen=True, slots=True)
class Accuracy:
    """When to stop: at an error of `energy` standard deviations of the edges, or `relative` to the first one,
    or, if `peak` is given, only where no pixel is off by more than that.
    """

    energy: float = 0.0
    relative: float = 0.0
    peak: float | None = None

    @property
    def single(self) -> bool:
        """Whether float32 is enough for a direct solve."""
        return self.relative >= _SINGLE

    def met(self, energy: float, first: float, error: Floats) -> bool:
        """energy and first: squared energy norms of the error, now and at the start; error: (rows, cols)."""
        if self.peak is not None:
            return max(float(error.max()), -float(error.min())) <= self.peak
        return energy <= max(self.energy**2, self.relative**2 * first)


class ColumnPoisson:
    """The direct solve for weights that depend on the column alone.

    wx: (cols,) weights of the edges (j, j + 1), the last unused; wy: (cols,) weights of the edges along rows.
    """

    def __init__(self, wx: Floats, wy: Floats, rows: int) -> None:
        self.rows = rows
        self.wx = np.ascontiguousarray(wx, dtype=np.float64)
        self.wy = np.ascontiguousarray(wy, dtype=np.float64)
        self.eigenvalues = 4.0 * np.sin(0.5 * np.pi * np.arange(rows) / rows) ** 2
        cols = self.wx.size
        # Eliminate from the light end: mode 0 then sums small numbers first.
        half = max((cols - 1) // 2, 1)
        light_first = self.wx[:half].sum() < self.wx[cols - 1 - half : cols - 1].sum()
        self._order = slice(None, None, -1 if light_first else 1)
        along, across = np.append(self.wx[:-1][self._order], 0.0), self.wy[self._order].copy()
        self._elimination = along, across, self.eigenvalues
        self._inverse_pivot = np.empty((rows, cols))
        over_image(
            lambda start, stop: _factor(*self._elimination, self._inverse_pivot, start, stop), (rows, cols)
        )

    def solve(self, rhs: Floats, single: bool = False) -> Floats:
        """x with D^T w D x = rhs (rows, cols); the mean over the rows is zero at the heavy end's column.

        single: in float32, half the time.
        """
        given = rhs[:, self._order].astype(np.float32 if single else np.float64)
        modes = scipy.fft.dct(given, axis=0, norm="ortho", overwrite_x=True, workers=threads())
        over_image(
            lambda start, stop: _substitute(self._elimination[0], self._inverse_pivot, modes, start, stop),
            modes.shape,
        )
        x = scipy.fft.idct(modes, axis=0, norm="ortho", overwrite_x=True, workers=threads())
        return np.ascontiguousarray(x[:, self._order], dtype=np.float64)

    def inverse_diagonal(self) -> Floats:
        """Diagonal of every mode's inverse, (modes, cols);
        mode 0 is pinned to zero at the heavy end's column.
        """
        out = np.empty((self.rows, self.wx.size))
        over_image(lambda start, stop: _inverse_diagonal(*self._elimination, out, start, stop), out.shape)
        return out[:, self._order]


def column_profile(weights: Floats) -> Floats:
    """Mean over the rows of the weights that are not zero, (cols,);
    empty columns take their neighbours' value.
    """
    count = np.count_nonzero(weights, axis=0)
    total = weights.sum(axis=0)
    filled = np.flatnonzero(count)
    if filled.size == 0:
        return np.ones(weights.shape[1])
    mean = total[filled] / count[filled]
    profile: Floats = np.exp(np.interp(np.arange(weights.shape[1]), filled, np.log(mean)))
    return profile


@exact
def _factor(wx, wy, eigenvalues, inverse_pivot, start, stop):  # type: ignore[no-untyped-def]
    """Pivot = weight of the edge towards the heavy end, column 0, + excess; column 0's is its excess."""
    for k in range(start, stop):
        excess = 0.0
        for j in range(wx.size - 1, 0, -1):
            excess += eigenvalues[k] * wy[j]
            inverse_pivot[k, j] = 1.0 / (wx[j - 1] + excess)
            excess = wx[j - 1] * excess / (wx[j - 1] + excess)
        excess += eigenvalues[k] * wy[0]
        inverse_pivot[k, 0] = 1.0 / excess if excess > 0.0 else 0.0


@exact
def _substitute(wx, inverse_pivot, b, start, stop):  # type: ignore[no-untyped-def]
    """Each mode waits for its last column: several at once keep the processor busy."""
    cols = wx.size
    for first in range(start, stop, _ABREAST):
        last = min(first + _ABREAST, stop)
        for j in range(cols - 1, 0, -1):
            for k in range(first, last):
                b[k, j - 1] += wx[j - 1] * inverse_pivot[k, j] * b[k, j]
        for k in range(first, last):
            b[k, 0] *= inverse_pivot[k, 0]
        for j in range(1, cols):
            for k in range(first, last):
                b[k, j] = (b[k, j] + wx[j - 1] * b[k, j - 1]) * inverse_pivot[k, j]


@exact
def _inverse_diagonal(wx, wy, eigenvalues, out, start, stop):  # type: ignore[no-untyped-def]
    cols = wx.size
    for k in range(start, stop):
        if eigenvalues[k] == 0.0:
            variance = 0.0
            for j in range(cols):
                if j > 0:
                    variance += 1.0 / wx[j - 1]
                out[k, j] = variance
            continue
        excess = 0.0
        for j in range(cols):
            out[k, j] = excess
            excess += eigenvalues[k] * wy[j]
            excess = wx[j] * excess / (wx[j] + excess)
        excess = 0.0
        for j in range(cols - 1, -1, -1):
            out[k, j] = 1.0 / (out[k, j] + eigenvalues[k] * wy[j] + excess)
            if j > 0:
                excess += eigenvalues[k] * wy[j]
                excess = wx[j - 1] * excess / (wx[j - 1] + excess)
