"""Weighted Poisson problems on pixel edges: min sum_e w_e (x_j - x_i - g_e)^2, i.e. D^T w D x = D^T w g.

Weights that depend on the column alone separate: a DCT-II along the rows diagonalises that axis (the Neumann
Laplacian needs no boundary terms), one tridiagonal M-matrix per mode remains along the columns.
Its elimination is written in Schur excesses (Grassmann, Taksar, Heyman, doi:10.1287/opre.33.5.1107): sums of
positive numbers only,
so that weight ratios of 1e14 cost no digits. Anything else - weights of both axes, masks - is solved by
conjugate gradients with that solve as preconditioner, restricted to the mask.
"""

from dataclasses import dataclass

import numpy as np
import scipy.fft
from numba import njit
from numpy.typing import NDArray

from optolever.blocks import over_rows, threads

from .edges import apply_laplacian

__all__ = ["Accuracy", "ColumnPoisson", "MaskedPoisson", "PoissonResult", "column_profile"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class PoissonResult:
    """A solution (free constant left as it comes), the iterations it took and its energy error estimate.

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
        self.reverse = bool(self.wx[:half].sum() < self.wx[cols - 1 - half : cols - 1].sum())
        self._inverse_pivot = np.empty((rows, cols))
        over_rows(
            lambda start, stop: _factor(
                self.wx, self.wy, self.eigenvalues, self.reverse, self._inverse_pivot, start, stop
            ),
            rows,
        )

    def solve(self, rhs: Floats) -> Floats:
        """x with D^T w D x = rhs (rows, cols); the mean over the rows is zero at the heavy end's column."""
        modes = scipy.fft.dct(rhs, axis=0, norm="ortho", workers=threads())
        over_rows(
            lambda start, stop: _substitute(self.wx, self._inverse_pivot, self.reverse, modes, start, stop),
            self.rows,
        )
        x: Floats = scipy.fft.idct(modes, axis=0, norm="ortho", overwrite_x=True, workers=threads())
        return x

    def inverse_diagonal(self) -> Floats:
        """Diagonal of every mode's inverse, (modes, cols);
        mode 0 is pinned to zero at the heavy end's column.
        """
        out = np.empty((self.rows, self.wx.size))
        over_rows(
            lambda start, stop: _inverse_diagonal(
                self.wx, self.wy, self.eigenvalues, self.reverse, out, start, stop
            ),
            self.rows,
        )
        return out


class MaskedPoisson:
    """Conjugate gradients for weights of any kind, zero where there is no edge.

    wx, wy: (rows, cols). The preconditioner is the rectangle's solve with the columns' mean weights.
    """

    def __init__(self, wx: Floats, wy: Floats, mask: Mask) -> None:
        self.wx, self.wy, self.mask = wx, wy, mask
        self.preconditioner = ColumnPoisson(column_profile(wx), column_profile(wy), wx.shape[0])
        self._boost = _boost(wx, wy, self.preconditioner)

    def solve(
        self, rhs: Floats, accuracy: Accuracy, start: Floats | None = None, limit: int = 500
    ) -> PoissonResult:
        """Solve from start (zero) until the remaining error, as the preconditioner estimates it,
        meets the accuracy.
        """
        x = np.zeros(rhs.shape) if start is None else start * self.mask
        r = np.where(self.mask, rhs, 0.0)
        if start is not None:
            r -= apply_laplacian(x, self.wx, self.wy)
        z = self._precondition(r)
        energy = first = _dot(r, z)
        direction = z
        for iteration in range(limit):
            if energy <= 0.0 or accuracy.met(energy, first, z):
                return PoissonResult(x, iteration, float(np.sqrt(max(energy, 0.0))))
            image = apply_laplacian(direction, self.wx, self.wy)
            alpha = energy / _dot(direction, image)
            _axpy(x, alpha, direction)
            _axpy(r, -alpha, image)
            z = self._precondition(r)
            energy, before = _dot(r, z), energy
            _xpby(z, energy / before, direction)
        return PoissonResult(x, limit, float(np.sqrt(max(energy, 0.0))))

    def _precondition(self, r: Floats) -> Floats:
        z = self.preconditioner.solve(r)
        z += self._boost * r
        z *= self.mask
        return z


def _diagonal(wx: Floats, wy: Floats) -> Floats:
    """Diagonal of D^T w D."""
    total = wx + wy
    total[:, 1:] += wx[:, :-1]
    total[1:] += wy[:-1]
    return total


def _boost(wx: Floats, wy: Floats, columns: ColumnPoisson) -> Floats:
    """What a pixel's own inverse diagonal exceeds that of the preconditioner by: added to it, it covers
    pixels that
    hang on light edges only (noisy border rows), for which the columns' weights are far too stiff.
    """
    full_x, full_y = (
        np.broadcast_to(columns.wx, wx.shape).copy(),
        np.broadcast_to(columns.wy, wy.shape).copy(),
    )
    full_x[:, -1], full_y[-1] = 0.0, 0.0
    own, smooth = _diagonal(wx, wy), _diagonal(full_x, full_y)
    present = own > 0
    boost: Floats = np.where(present, 1.0 / np.where(present, own, 1.0) - 1.0 / smooth, 0.0)
    return np.maximum(boost, 0.0)


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


def _dot(a: Floats, b: Floats) -> float:
    return float(np.dot(a.ravel(), b.ravel()))


def _axpy(y: Floats, a: float, x: Floats) -> None:
    """y += a x"""
    over_rows(lambda start, stop: _add(y, 1.0, a, x, start, stop), y.shape[0])


def _xpby(x: Floats, b: float, y: Floats) -> None:
    """y = x + b y"""
    over_rows(lambda start, stop: _add(y, b, 1.0, x, start, stop), y.shape[0])


@njit(cache=True, nogil=True)
def _add(y, b, a, x, start, stop):  # type: ignore[no-untyped-def]
    for i in range(start, stop):
        for j in range(y.shape[1]):
            y[i, j] = b * y[i, j] + a * x[i, j]


@njit(cache=True, nogil=True)
def _factor(wx, wy, eigenvalues, reverse, inverse_pivot, start, stop):  # type: ignore[no-untyped-def]
    """Pivot = weight of the edge towards the heavy end + excess; the heavy end's own pivot is its excess."""
    cols = wx.size
    for k in range(start, stop):
        excess = 0.0
        for m in range(cols):
            j = m if reverse else cols - 1 - m
            excess += eigenvalues[k] * wy[j]
            if m == cols - 1:
                inverse_pivot[k, j] = 1.0 / excess if excess > 0.0 else 0.0
            else:
                w = wx[j] if reverse else wx[j - 1]
                inverse_pivot[k, j] = 1.0 / (w + excess)
                excess = w * excess / (w + excess)


@njit(cache=True, nogil=True)
def _substitute(wx, inverse_pivot, reverse, b, start, stop):  # type: ignore[no-untyped-def]
    cols = wx.size
    for k in range(start, stop):
        if reverse:
            for j in range(cols - 1):
                b[k, j + 1] += wx[j] * inverse_pivot[k, j] * b[k, j]
            b[k, cols - 1] *= inverse_pivot[k, cols - 1]
            for j in range(cols - 2, -1, -1):
                b[k, j] = (b[k, j] + wx[j] * b[k, j + 1]) * inverse_pivot[k, j]
        else:
            for j in range(cols - 1, 0, -1):
                b[k, j - 1] += wx[j - 1] * inverse_pivot[k, j] * b[k, j]
            b[k, 0] *= inverse_pivot[k, 0]
            for j in range(1, cols):
                b[k, j] = (b[k, j] + wx[j - 1] * b[k, j - 1]) * inverse_pivot[k, j]


@njit(cache=True, nogil=True)
def _inverse_diagonal(wx, wy, eigenvalues, reverse, out, start, stop):  # type: ignore[no-untyped-def]
    cols = wx.size
    for k in range(start, stop):
        if eigenvalues[k] == 0.0:
            variance = 0.0
            for m in range(cols):
                j = cols - 1 - m if reverse else m
                if m > 0:
                    variance += 1.0 / (wx[j] if reverse else wx[j - 1])
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
