"""The linear problem of one step: weighted edges in, potential out;
the cheapest solver that fits the weights.
"""

from typing import Protocol

import numpy as np

from ..arrays import Floats, Mask
from .edges import divergence
from .masked import MaskedEdges
from .poisson import Accuracy, ColumnPoisson, PoissonResult, column_profile

__all__ = ["EdgeProblem", "SeparableEdges", "edge_problem", "spread"]

SEPARABLE_SPREAD = (
    0.4  # rms of the log weights about their columns' mean: a loss of 1 to 2 % in sigma at most
)


class EdgeProblem(Protocol):
    """min sum w_e (x_j - x_i - g_e)^2 for edge data g."""

    @property
    def columns(self) -> ColumnPoisson:
        """The separable problem: itself, or its counterpart without mask and jumps."""

    @property
    def weights(self) -> tuple[Floats, Floats] | None:
        """The edges' weights (rows, cols), None where the columns' say it all."""

    @property
    def closed(self) -> bool:
        """Whether the solution's variance has a closed form: least squares, on the columns' weights alone."""

    def solve(self, gx: Floats, gy: Floats, accuracy: Accuracy, start: Floats | None = None) -> PoissonResult:
        """Potential up to a constant per component; iterations begin at start and stop at the accuracy."""

    def energy(self, gx: Floats, gy: Floats) -> float:
        """sum w_e g_e^2."""


class SeparableEdges:
    """Full rectangle, weights by columns: exact."""

    weights = None
    closed = True

    def __init__(self, wx: Floats, wy: Floats) -> None:
        self._wx = _mean_profile(wx)[None, :]
        self._wy = _mean_profile(wy)[None, :]
        self._wx[0, -1] = 0.0
        self.columns = ColumnPoisson(self._wx[0], self._wy[0], wx.shape[0])

    def solve(self, gx: Floats, gy: Floats, accuracy: Accuracy, start: Floats | None = None) -> PoissonResult:
        """One direct solve."""
        rhs = divergence(gx, gy, self._wx, self._wy)
        return PoissonResult(self.columns.solve(rhs, accuracy.single), 1, 0.0)

    def energy(self, gx: Floats, gy: Floats) -> float:
        """sum w_e g_e^2."""
        return float(
            np.einsum("ij,ij,j->", gx, gx, self._wx[0]) + np.einsum("ij,ij,j->", gy, gy, self._wy[0])
        )


def edge_problem(wx: Floats, wy: Floats, mask: Mask, separable: bool = True) -> EdgeProblem:
    """Separable where the mask is the full rectangle and the weights go by columns closely enough
    (not if single edges are to count less).
    """
    if separable and mask.all() and max(spread(wx), spread(wy)) < SEPARABLE_SPREAD:
        return SeparableEdges(wx, wy)
    return MaskedEdges(wx, wy, mask)


def spread(weights: Floats) -> float:
    """rms of log(weights / their column's profile) over the edges that exist;
    estimated from at most 512 rows.
    """
    sample = weights[:: max(1, weights.shape[0] // 512)]
    present = sample > 0
    if not present.any():
        return 0.0
    ratio = np.log(np.where(present, sample, 1.0) / column_profile(sample))
    return float(np.sqrt(np.mean(ratio[present] ** 2)))


def _mean_profile(weights: Floats) -> Floats:
    """Inverse of the columns' mean variance: the weights under which the error bar stays true on average."""
    present = weights > 0
    inverse = np.where(present, 1.0 / np.where(present, weights, 1.0), 0.0).sum(axis=0)
    count = np.count_nonzero(present, axis=0)
    profile: Floats = np.divide(count, inverse, out=np.ones(count.shape), where=count > 0)
    return profile
