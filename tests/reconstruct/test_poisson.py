"""Weighted Poisson solves against dense least squares."""

import numpy as np
import pytest

from optolever.reconstruct.edges import apply_laplacian, divergence
from optolever.reconstruct.masked import MaskedEdges
from optolever.reconstruct.poisson import Accuracy, ColumnPoisson, column_profile

from .dense import dense_solution, incidence

ROWS, COLS = 11, 9
TIGHT = Accuracy(energy=0.0, relative=1e-13)


def weights_on(mask: np.ndarray, wx: np.ndarray, wy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    wx, wy = wx.copy(), wy.copy()
    wx[:, :-1] *= mask[:, :-1] & mask[:, 1:]
    wy[:-1] *= mask[:-1] & mask[1:]
    wx[:, -1] = 0
    wy[-1] = 0
    return wx, wy


def columns(contrast: float, reverse: bool) -> tuple[np.ndarray, np.ndarray]:
    profile = np.geomspace(1.0, contrast, COLS)
    wx, wy = profile * 1.3, profile * (1 + 0.1 * np.arange(COLS))
    return (wx[::-1].copy(), wy[::-1].copy()) if reverse else (wx, wy)


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("contrast", [1.0, 1e-4])
def test_column_weights(contrast: float, reverse: bool) -> None:
    rng = np.random.default_rng(1)
    wx1, wy1 = columns(contrast, reverse)
    full = np.ones((ROWS, COLS), dtype=bool)
    wx, wy = weights_on(full, np.tile(wx1, (ROWS, 1)), np.tile(wy1, (ROWS, 1)))
    gx, gy = rng.standard_normal((2, ROWS, COLS))
    gx[:, -1], gy[-1] = 0, 0
    x = ColumnPoisson(wx1, wy1, ROWS).solve(divergence(gx, gy, wx, wy))
    expected = dense_solution(gx, gy, wx, wy)
    assert np.ptp(x - expected) < 1e-11


@pytest.mark.parametrize("reverse", [False, True])
def test_extreme_contrast_keeps_every_column(reverse: bool) -> None:
    """A potential that grows as the weights fall by 1e14 comes back with relative precision everywhere."""
    rng = np.random.default_rng(2)
    wx1, wy1 = columns(1e-14, reverse)
    x = rng.standard_normal((ROWS, COLS)) / np.sqrt(wx1)
    full = np.ones((ROWS, COLS), dtype=bool)
    wx, wy = weights_on(full, np.tile(wx1, (ROWS, 1)), np.tile(wy1, (ROWS, 1)))
    gx, gy = np.zeros_like(x), np.zeros_like(x)
    gx[:, :-1], gy[:-1] = np.diff(x, axis=1), np.diff(x, axis=0)
    found = ColumnPoisson(wx1, wy1, ROWS).solve(divergence(gx, gy, wx, wy))
    heavy = -1 if reverse else 0
    error = (found - found[:, heavy].mean()) - (x - x[:, heavy].mean())
    assert np.all(np.abs(error) < 1e-12 * np.abs(x).max(axis=0))


@pytest.mark.parametrize("reverse", [False, True])
def test_inverse_diagonal(reverse: bool) -> None:
    """Against the dense inverse of every mode's matrix; mode 0 pinned at the heavy end."""
    wx1, wy1 = columns(1e-3, reverse)
    poisson = ColumnPoisson(wx1, wy1, ROWS)
    found = poisson.inverse_diagonal()
    steps = np.diff(np.eye(COLS), axis=0)
    base = steps.T @ np.diag(wx1[:-1]) @ steps
    for k, eigenvalue in enumerate(poisson.eigenvalues):
        matrix = base + eigenvalue * np.diag(wy1)
        if k == 0:
            keep = np.delete(np.arange(COLS), COLS - 1 if reverse else 0)
            expected = np.zeros(COLS)
            expected[keep] = np.diag(np.linalg.inv(matrix[np.ix_(keep, keep)]))
        else:
            expected = np.diag(np.linalg.inv(matrix))
        np.testing.assert_allclose(found[k], expected, rtol=1e-9, atol=1e-14)


def test_masked_with_two_components_and_uneven_weights() -> None:
    rng = np.random.default_rng(3)
    mask = rng.random((ROWS, COLS)) > 0.15
    mask[:, 4] = False
    wx, wy = weights_on(mask, *np.exp(rng.standard_normal((2, ROWS, COLS))))
    gx, gy = rng.standard_normal((2, ROWS, COLS))
    result = MaskedEdges(wx, wy, mask).solve(gx, gy, TIGHT)
    expected = dense_solution(gx, gy, wx, wy)
    d, w, _ = incidence(wx, wy)
    assert np.abs(np.sqrt(w) * (d @ (result.x - expected).ravel())).max() < 1e-9
    assert not result.x[~mask].any()


def test_masked_from_a_start_needs_nothing_more() -> None:
    rng = np.random.default_rng(4)
    mask = np.hypot(*(np.mgrid[:ROWS, :COLS] - 4.5)) < 4.4
    wx, wy = weights_on(mask, np.ones((ROWS, COLS)), np.ones((ROWS, COLS)))
    gx, gy = rng.standard_normal((2, ROWS, COLS))
    edges = MaskedEdges(wx, wy, mask)
    first = edges.solve(gx, gy, TIGHT)
    again = edges.solve(gx, gy, Accuracy(energy=1e-6), start=first.x)
    assert first.iterations > 3
    assert again.iterations == 0
    np.testing.assert_allclose(again.x, first.x)


def test_iterations_do_not_grow_with_the_size() -> None:
    counts = []
    for size in (64, 256):
        mask = np.hypot(*(np.mgrid[:size, :size] - 0.5 * size)) < 0.45 * size
        wx, wy = weights_on(mask, np.ones((size, size)), np.ones((size, size)))
        gx, gy = np.random.default_rng(5).standard_normal((2, size, size))
        counts.append(MaskedEdges(wx, wy, mask).solve(gx, gy, Accuracy(relative=1e-8)).iterations)
    assert max(counts) <= 16


def test_laplacian_is_its_own_adjoint() -> None:
    rng = np.random.default_rng(6)
    wx, wy = weights_on(rng.random((ROWS, COLS)) > 0.1, *rng.random((2, ROWS, COLS)))
    a, b = rng.standard_normal((2, ROWS, COLS))
    assert np.vdot(a, apply_laplacian(b, wx, wy)[0]) == pytest.approx(
        np.vdot(apply_laplacian(a, wx, wy)[0], b)
    )
    d, w, _ = incidence(wx, wy)
    np.testing.assert_allclose(apply_laplacian(a, wx, wy)[0].ravel(), d.T @ (w * (d @ a.ravel())), atol=1e-12)


def test_column_profile_fills_empty_columns() -> None:
    weights = np.array([[1.0, 0.0, 4.0], [3.0, 0.0, 4.0]])
    np.testing.assert_allclose(column_profile(weights), [2.0, np.sqrt(8.0), 4.0])
