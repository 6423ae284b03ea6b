"""Weighted Poisson problems with any mask and any weights: conjugate gradients on multigrid."""

from collections.abc import Callable
from functools import cached_property

import numpy as np

from ..arrays import Floats, Mask
from .edges import apply_laplacian, divergence
from .multigrid import Multigrid
from .poisson import Accuracy, ColumnPoisson, PoissonResult, column_profile

__all__ = ["MaskedEdges"]

_LEAK = 1e-4  # of its column's mean weight: what a missing edge conducts in the preconditioner


class MaskedEdges:
    """min sum w_e (x_j - x_i - g_e)^2 on the edges whose weight is not zero.

    wx, wy: (rows, cols). The preconditioner solves the full rectangle, in which missing edges conduct next to
    nothing: its solution, restricted to the mask, is that of the mask but for this.
    """

    closed = False

    def __init__(self, wx: Floats, wy: Floats, mask: Mask) -> None:
        self.weights = wx, wy
        self._mask = mask
        self._cycle: Callable[[Floats], Floats] | None = None

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

    def solve(
        self, gx: Floats, gy: Floats, accuracy: Accuracy, start: Floats | None = None, limit: int = 500
    ) -> PoissonResult:
        """Solve from start (zero) until the remaining error, as the preconditioner estimates it,
        meets the accuracy, in `limit` iterations at most.
        """
        x = np.zeros(gx.shape) if start is None else start * self._mask
        r, image = divergence(gx, gy, *self.weights), np.empty(gx.shape)
        r *= self._mask
        if start is not None:
            r -= apply_laplacian(x, *self.weights, image)[0]
        z, energy = self._preconditioned(r)
        first = energy
        direction = z.copy()
        for iteration in range(limit):
            if energy <= 0.0 or accuracy.met(energy, first, z):
                return PoissonResult(x, iteration, float(np.sqrt(max(energy, 0.0))))
            curvature = apply_laplacian(direction, *self.weights, image)[1]
            if not curvature > 0.0:  # the direction is all rounding
                return PoissonResult(x, iteration, float(np.sqrt(energy)))
            alpha = energy / curvature
            r -= np.multiply(alpha, image, out=image)
            x += np.multiply(alpha, direction, out=image)
            before = energy
            z, energy = self._preconditioned(r)
            direction *= energy / before
            direction += z
        return PoissonResult(x, limit, float(np.sqrt(max(energy, 0.0))))

    def _preconditioned(self, r: Floats) -> tuple[Floats, float]:
        """About the error that the residual r stands for, zero outside the mask, and its energy."""
        if self._cycle is None:
            wx, wy = self.weights
            self._cycle = Multigrid(_filled(wx, 1), _filled(wy, 0)).cycle
        z = self._cycle(r)
        z *= self._mask
        return z, float(np.einsum("ij,ij->", z, r))


def _filled(weights: Floats, axis: int) -> Floats:
    """The weights with a trickle where an edge is missing."""
    filled = np.where(weights > 0, weights, _LEAK * column_profile(weights))
    filled[(slice(None), -1) if axis == 1 else -1] = 0.0
    return filled
