"""Weighted Poisson solves beyond what test_integrate asks of them: extreme weights, few iterations."""

import numpy as np
import pytest

from optolever.reconstruct.solver.edges import divergence
from optolever.reconstruct.solver.poisson import Accuracy, ColumnPoisson, MaskedEdges, column_profile

ROWS, COLS = 11, 9


def columns(contrast: float, reverse: bool) -> tuple[np.ndarray, np.ndarray]:
    profile = np.geomspace(1.0, contrast, COLS)
    wx, wy = profile * 1.3, profile * (1 + 0.1 * np.arange(COLS))
    return (wx[::-1].copy(), wy[::-1].copy()) if reverse else (wx, wy)


@pytest.mark.parametrize("reverse", [False, True])
def test_extreme_contrast_keeps_every_column(reverse: bool) -> None:
    """A potential that grows as the weights fall by 1e14 comes back with relative precision everywhere."""
    rng = np.random.default_rng(2)
    wx, wy = columns(1e-14, reverse)
    x = rng.standard_normal((ROWS, COLS)) / np.sqrt(wx)
    gx, gy = np.zeros_like(x), np.zeros_like(x)
    gx[:, :-1], gy[:-1] = np.diff(x, axis=1), np.diff(x, axis=0)
    found = ColumnPoisson(wx, wy, ROWS).solve(divergence(gx, gy, wx[None], wy[None]))
    heavy = -1 if reverse else 0
    error = (found - found[:, heavy].mean()) - (x - x[:, heavy].mean())
    assert np.all(np.abs(error) < 1e-12 * np.abs(x).max(axis=0))


def edge_weights(weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The lesser of both pixels' weights."""
    wx, wy = np.zeros((2, *weight.shape))
    wx[:, :-1], wy[:-1] = np.minimum(weight[:, 1:], weight[:, :-1]), np.minimum(weight[1:], weight[:-1])
    return wx, wy


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


def test_column_profile_fills_empty_columns() -> None:
    weights = np.array([[1.0, 0.0, 4.0], [3.0, 0.0, 4.0]])
    np.testing.assert_allclose(column_profile(weights), [2.0, np.sqrt(8.0), 4.0])
