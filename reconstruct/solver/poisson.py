"""Weighted Poisson problems on pixel edges: min sum_e w_e (x_j - x_i - g_e)^2, i.e. D^T w D x = D^T w g.

Weights that depend on the column alone separate: a DCT-II along the rows diagonalises that axis (the Neumann
Laplacian needs no boundary terms), one tridiagonal M-matrix per mode remains along the columns.
Its elimination is written in Schur excesses (Grassmann, Taksar, Heyman, doi:10.1287/opre.33.5.1107): sums of
positive numbers only,
so that weight ratios of 1e14 cost no digits.
Anything else - weights of both axes, masks - by conjugate gradients on multigrid.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from optolever.arrays import Floats, Mask
from optolever.blocks import over_image, threads
from optolever.kernels import F32, exact

from .edges import apply_laplacian, divergence
from .multigrid import Multigrid

__all__ = [
    "Accuracy", "ColumnPoisson", "EdgeProblem", "MaskedEdges", "PoissonResult", "SeparableEdges",
    "column_profile", "edge_problem",
]  # fmt: skip

SEPARABLE_SPREAD = (
    0.4  # rms of the log weights about their columns' mean: a loss of 1 to 2 % in sigma at most
)
_LEAK = 1e-4  # of its column's mean weight: what a missing edge conducts in the preconditioner
#: What a solve in float32 leaves of its peak, at most (4 Mpx: 5e-7, of pure noise 2e-5).
_SINGLE = 1e-4
_PEAK = 1e-3  # of a logarithm, whose range is some 10
_ABREAST = 8  # modes
_MOST = 500  # iterations
_BORROWED = 60  # of them with the preconditioner of other weights
_ROWS = 64  # whose spread is about that of all


@dataclass(frozen=True, slots=True)
class PoissonResult:
    """A solution (free constant arbitrary) and the iterations it took."""

    x: Floats
    iterations: int


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
        return self.relative >= _SINGLE or (self.peak or 0.0) >= _PEAK

    def met(self, energy: float, first: float, error: F32) -> bool:
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

    def solve(self, rhs: NDArray[np.floating[Any]], single: bool = False) -> Floats:
        """x with D^T w D x = rhs (..., rows, cols); the mean over the rows is zero at the heavy end's column.

        single: x too is float32, half the time.
        """
        rhs = rhs[..., self._order].astype(np.float32 if single else np.float64, "C")  # frees the one given
        modes = scipy.fft.dct(rhs, axis=-2, norm="ortho", overwrite_x=True, workers=threads())
        flat = modes.reshape(-1, modes.shape[-1])
        over_image(
            lambda start, stop: _substitute(self._elimination[0], self._inverse_pivot, flat, start, stop),
            flat.shape,
        )
        x = scipy.fft.idct(
            flat.reshape(rhs.shape), axis=-2, norm="ortho", overwrite_x=True, workers=threads()
        )
        return np.ascontiguousarray(x[..., self._order])

    def inverse_diagonal(self) -> Floats:
        """Diagonal of every mode's inverse, (modes, cols);
        mode 0 is pinned to zero at the heavy end's column.
        """
        (along, across, eigenvalues), out = self._elimination, np.empty((self.wx.size, self.rows))
        flow = np.outer(across, eigenvalues)
        with np.errstate(invalid="ignore"):  # mode 0: no excess beyond the last column
            excess = np.zeros(self.rows)
            for j in range(len(out)):  # of the columns before
                out[j] = excess
                excess += flow[j]
                excess *= along[j] / (along[j] + excess)
            excess[:] = 0.0
            for j in reversed(range(len(out))):  # of those behind
                out[j] += flow[j] + excess
                excess += flow[j]
                excess *= along[j - 1] / (along[j - 1] + excess)
        out[:, 1:] = 1.0 / out[:, 1:]
        out[:, 0] = np.append(0.0, np.cumsum(1.0 / along[:-1]))
        return out.T[:, self._order]


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


class SeparableEdges:
    """min sum w_e (x_j - x_i - g_e)^2 for edge data g on a full rectangle, weights by columns: exact.

    columns: the separable problem; weights: None where the columns' say it all; closed: whether its variance
    has a closed form: least squares, on the columns' weights alone.
    """

    weights = None
    closed = True

    def __init__(self, wx: Floats, wy: Floats) -> None:
        self._wx = _mean_profile(wx)[None, :]
        self._wy = _mean_profile(wy)[None, :]
        self._wx[0, -1] = 0.0
        self.columns = ColumnPoisson(self._wx[0], self._wy[0], wx.shape[0])

    def solve(self, gx: Floats, gy: Floats, accuracy: Accuracy, start: Floats | None = None) -> PoissonResult:
        """One direct solve; gx, gy may be stacks (..., rows, cols)."""
        x = self.columns.solve(divergence(gx, gy, self._wx, self._wy), accuracy.single)
        return PoissonResult(x, 1)

    def energy(self, gx: Floats, gy: Floats) -> float:
        """sum w_e g_e^2."""
        return float(
            np.einsum("ij,ij,j->", gx, gx, self._wx[0]) + np.einsum("ij,ij,j->", gy, gy, self._wy[0])
        )


class MaskedEdges:
    """min sum w_e (x_j - x_i - g_e)^2 on the edges whose weight is not zero.

    wx, wy: (rows, cols). The preconditioner solves the full rectangle, in which missing edges conduct next to
    nothing: its solution, restricted to the mask, is that of the mask but for this. near: a problem whose
    weights are nearly these, and whose preconditioner serves.
    """

    closed = False

    def __init__(self, wx: Floats, wy: Floats, mask: Mask, near: "EdgeProblem | None" = None) -> None:
        self.weights = wx, wy
        self._mask = mask
        self._cycle: Callable[[Floats], F32] | None = near._cycle if isinstance(near, MaskedEdges) else None
        self._borrowed = self._cycle is not None

    @cached_property
    def columns(self) -> ColumnPoisson:
        """The separable problem with the columns' mean weights."""
        wx, wy = (column_profile(weight) for weight in self.weights)
        return ColumnPoisson(wx, wy, len(self._mask))

    def energy(self, gx: Floats, gy: Floats) -> float:
        """sum w_e g_e^2."""
        return sum(
            float(np.einsum("ij,ij,ij->", g, g, w)) for g, w in zip((gx, gy), self.weights, strict=True)
        )

    def solve(self, gx: Floats, gy: Floats, accuracy: Accuracy, start: Floats | None = None) -> PoissonResult:
        """Solve from start (zero) until the remaining error, as the preconditioner estimates it, meets the
        accuracy; each of a stack (m, rows, cols) by itself.
        """
        if gx.ndim > 2:
            each = [self.solve(*pair, accuracy) for pair in zip(gx, gy, strict=True)]
            return PoissonResult(np.stack([one.x for one in each]), sum(one.iterations for one in each))
        x = np.zeros(gx.shape) if start is None else start * self._mask
        r, image = divergence(gx, gy, *self.weights), np.empty(gx.shape)
        r *= self._mask
        if start is not None:
            r -= apply_laplacian(x, *self.weights, image)[0]
        z, energy = self._preconditioned(r)
        first = energy
        direction = z.astype(np.float64)
        for iteration in range(_MOST):
            if energy <= 0.0 or accuracy.met(energy, first, z):
                return PoissonResult(x, iteration)
            if iteration == _BORROWED and self._borrowed:  # it does not serve: its own, from here
                self._cycle, self._borrowed = None, False
                z, energy = self._preconditioned(r)
                direction = z.astype(np.float64)
            curvature = apply_laplacian(direction, *self.weights, image)[1]
            if not curvature > 0.0:  # the direction is all rounding
                return PoissonResult(x, iteration)
            alpha = energy / curvature
            r -= np.multiply(alpha, image, out=image)
            x += np.multiply(alpha, direction, out=image)
            before = energy
            z, energy = self._preconditioned(r)
            direction *= energy / before
            direction += z
        return PoissonResult(x, _MOST)

    def _preconditioned(self, r: Floats) -> tuple[F32, float]:
        """About the error that the residual r stands for, zero outside the mask, and its energy."""
        if self._cycle is None:
            wx, wy = self.weights
            self._cycle = Multigrid(_filled(wx, 1), _filled(wy, 0)).cycle
        z = self._cycle(r) * self._mask
        return z, float(np.einsum("ij,ij->", z, r))


EdgeProblem = SeparableEdges | MaskedEdges


def edge_problem(
    wx: Floats, wy: Floats, mask: Mask, separable: bool = True, near: EdgeProblem | None = None
) -> EdgeProblem:
    """Separable where the mask is the full rectangle and the weights go by columns closely enough
    (not if single edges are to count less). near: see `MaskedEdges`.
    """
    if separable and mask.all() and max(_spread(wx), _spread(wy)) < SEPARABLE_SPREAD:
        return SeparableEdges(wx, wy)
    return MaskedEdges(wx, wy, mask, near)


def _spread(weights: Floats) -> float:
    """rms of log(weights / their column's profile) over the edges that exist;
    estimated from some of the rows.
    """
    sample = weights[:: max(1, len(weights) // _ROWS)]
    present = sample > 0
    if not present.any():
        return 0.0
    ratio = np.log(np.where(present, sample, 1.0) / column_profile(sample))
    return float(np.sqrt(np.mean(ratio[present] ** 2)))


def _mean_profile(weights: Floats) -> Floats:
    """Inverse of the columns' mean variance: the weights under which the error bar stays true on average."""
    present = weights > 0
    inverse = np.divide(1.0, weights, out=np.zeros(weights.shape), where=present).sum(axis=0)
    count = np.count_nonzero(present, axis=0)
    profile: Floats = np.divide(count, inverse, out=np.ones(count.shape), where=count > 0)
    return profile


def _filled(weights: Floats, axis: int) -> Floats:
    """The weights with a trickle where an edge is missing."""
    filled = np.where(weights > 0, weights, _LEAK * column_profile(weights))
    filled[(slice(None), -1) if axis == 1 else -1] = 0.0
    return filled


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
    """Each mode waits for its last column: several at once keep the processor busy. Images may lie below each
    other."""
    rows, cols = inverse_pivot.shape
    first = start
    while first < stop:
        above = first - first % rows
        last = min(first + _ABREAST, stop, above + rows)
        for j in range(cols - 1, 0, -1):
            for k in range(first, last):
                b[k, j - 1] += wx[j - 1] * inverse_pivot[k - above, j] * b[k, j]
        for k in range(first, last):
            b[k, 0] *= inverse_pivot[k - above, 0]
        for j in range(1, cols):
            for k in range(first, last):
                b[k, j] = (b[k, j] + wx[j - 1] * b[k, j - 1]) * inverse_pivot[k - above, j]
        first = last
