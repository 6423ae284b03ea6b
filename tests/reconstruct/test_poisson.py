"""Weighted Poisson solves beyond what test_integrate asks of them: extreme weights, few iterations."""

import numpy as np
import pytest

from optolever.reconstruct.solver.poisson import Accuracy, MaskedEdges


def edge_weights(weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The lesser of both pixels' weights."""
    wx, wy = np.zeros((2, *weight.shape))
    wx[:, :-1], wy[:-1] = np.minimum(weight[:, 1:], weight[:, :-1]), np.minimum(weight[1:], weight[:-1])
    return wx, wy


@pytest.mark.daily(2)
@pytest.mark.parametrize("case", ["disk", "slit", "dropouts", "crease", "prism"])
def test_iterations_stay_few(case: str) -> None:
    """Solved to 1e-8 from an exact potential, by few iterations, where a DCT needs 40 to 200; and none from
    there."""
    rng = np.random.default_rng(2)
    rows, cols = 160, 150
    y, x = np.mgrid[:rows, :cols]
    weight = np.ones((rows, cols))
    if case == "disk":
        weight[np.hypot(y - 80, x - 75) > 70] = 0.0
    elif case == "slit":
        weight[rows // 3, :-15] = 0.0
    elif case == "dropouts":
        weight[rng.random((rows, cols)) < 0.2] = 0.0
    elif case == "crease":
        weight[np.abs(np.hypot(y - 80, x - 70) - 40) < 1] = 1e-8
    else:
        weight *= ((x + 0.5) / cols) ** 4
    wx, wy = edge_weights(weight)
    gx, gy = np.zeros((2, rows, cols))
    truth = rng.standard_normal((rows, cols)) * (weight > 0)
    gx[:, :-1], gy[:-1] = np.diff(truth, axis=1), np.diff(truth, axis=0)
    edges = MaskedEdges(wx, wy, weight > 0)
    result = edges.solve(gx, gy, Accuracy(relative=1e-8))
    assert result.iterations <= 25
    left = result.x - truth
    rx, ry = wx[:, :-1] * np.diff(left, axis=1) ** 2, wy[:-1] * np.diff(left, axis=0) ** 2
    assert rx.sum() + ry.sum() < 1e-12 * (np.sum(wx * gx**2) + np.sum(wy * gy**2))
    assert edges.solve(gx, gy, Accuracy(energy=1e-3), start=result.x).iterations == 0
