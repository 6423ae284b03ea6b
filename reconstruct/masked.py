"""Weighted Poisson problems with any mask and any weights: conjugate gradients on multigrid."""

from collections.abc import Callable

import numpy as np

from optolever.blocks import over_image
from optolever.kernels import exact

from .arrays import Floats, Mask
from .edges import apply_laplacian
from .multigrid import Multigrid
from .poisson import Accuracy, PoissonResult, column_profile

__all__ = ["MaskedPoisson"]

_LEAK = 1e-4  # of its column's mean weight: what a missing edge conducts in the preconditioner


class MaskedPoisson:
    """min sum w_e (x_j - x_i - g_e)^2 on the edges whose weight is not zero.

    wx, wy: (rows, cols). The preconditioner sees the whole rectangle, in which missing edges conduct next to
    nothing: its solution, taken in the mask alone, is that of the mask but for this.
    """

    def __init__(self, wx: Floats, wy: Floats, mask: Mask) -> None:
        self.wx, self.wy = wx, wy
        self._mask = mask.astype(np.float64)
        self._cycle: Callable[[Floats], Floats] | None = None

    def solve(
        self, rhs: Floats, accuracy: Accuracy, start: Floats | None = None, limit: int = 500
    ) -> PoissonResult:
        """Solve from start (zero) until the remaining error, as the preconditioner estimates it,
        meets the accuracy.
        """
        x = np.zeros(rhs.shape) if start is None else start * self._mask
        r, image = rhs * self._mask, np.empty(rhs.shape)
        if start is not None:
            r -= apply_laplacian(x, self.wx, self.wy)[0]
        z, energy = self._preconditioned(r)
        first = energy
        direction = z.copy()
        for iteration in range(limit):
            if energy <= 0.0 or accuracy.met(energy, first, z):
                return PoissonResult(x, iteration, float(np.sqrt(max(energy, 0.0))))
            alpha = energy / apply_laplacian(direction, self.wx, self.wy, image)[1]
            over_image(_descent(x, r, alpha, direction, image), rhs.shape)
            before = energy
            z, energy = self._preconditioned(r)
            over_image(_turn(direction, energy / before, z), rhs.shape)
        return PoissonResult(x, limit, float(np.sqrt(max(energy, 0.0))))

    def _preconditioned(self, r: Floats) -> tuple[Floats, float]:
        """About the error that the residual r stands for, zero outside the mask, and its energy."""
        if self._cycle is None:
            self._cycle = Multigrid(_filled(self.wx, 1), _filled(self.wy, 0)).cycle
        z = self._cycle(r)
        sums = np.empty(r.shape[0])
        over_image(lambda start, stop: _masked_dot(z, self._mask, r, sums, start, stop), r.shape)
        return z, float(sums.sum())


def _filled(weights: Floats, axis: int) -> Floats:
    """The weights with a trickle where an edge is missing."""
    filled = np.where(weights > 0, weights, _LEAK * column_profile(weights))
    filled[(slice(None), -1) if axis == 1 else -1] = 0.0
    return filled


def _descent(
    x: Floats, r: Floats, alpha: float, direction: Floats, image: Floats
) -> Callable[[int, int], None]:
    return lambda start, stop: _descend(x, r, alpha, direction, image, start, stop)


def _turn(direction: Floats, beta: float, z: Floats) -> Callable[[int, int], None]:
    return lambda start, stop: _scale_add(direction, beta, z, start, stop)


@exact
def _masked_dot(z, mask, r, sums, start, stop):  # type: ignore[no-untyped-def]
    for i in range(start, stop):
        total = 0.0
        for j in range(z.shape[1]):
            z[i, j] *= mask[i, j]
            total += z[i, j] * r[i, j]
        sums[i] = total


@exact
def _descend(x, r, alpha, direction, image, start, stop):  # type: ignore[no-untyped-def]
    for i in range(start, stop):
        for j in range(x.shape[1]):
            x[i, j] += alpha * direction[i, j]
            r[i, j] -= alpha * image[i, j]


@exact
def _scale_add(direction, beta, z, start, stop):  # type: ignore[no-untyped-def]
    for i in range(start, stop):
        for j in range(z.shape[1]):
            direction[i, j] = z[i, j] + beta * direction[i, j]
