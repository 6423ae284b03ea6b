"""Edge increments against integrals in closed form."""

import numpy as np
import pytest

from optolever.reconstruct.edges import curl, defects, edge_weights, factor_increments, increments

ROWS, COLS = 8, 10


def cubic(x: np.ndarray) -> np.ndarray:
    return 1.0 - 0.7 * x + 0.3 * x**2 - 0.02 * x**3


def integral(x: np.ndarray) -> np.ndarray:
    return x - 0.35 * x**2 + 0.1 * x**3 - 0.005 * x**4


@pytest.mark.parametrize("transpose", [False, True])
def test_cubic_slopes_are_integrated_exactly(transpose: bool) -> None:
    """Inside, at the ends, and beside a masked pixel with four neighbours left."""
    x = np.tile(np.arange(COLS, dtype=float), (ROWS, 1))
    mask = np.ones((ROWS, COLS), dtype=bool)
    mask[2, 5] = False
    slope = cubic(x)
    rise = integral(x[:, 1:]) - integral(x[:, :-1])
    zero = np.zeros_like(x)
    if transpose:
        gy = increments(zero.T.copy(), slope.T.copy(), mask.T.copy())[1]
        found = gy.T
    else:
        found = increments(slope, zero, mask)[0]
    cut = np.zeros((ROWS, COLS), dtype=bool)
    cut[2, 4:6] = True
    np.testing.assert_array_equal(found[2, 4:6], 0.0)
    assert not found[:, -1].any()
    np.testing.assert_allclose(found[:, :-1][~cut[:, :-1]], rise[~cut[:, :-1]], rtol=1e-12)


def test_three_pixels_fall_back_to_the_trapezoid() -> None:
    p = np.array([[1.0, 4.0, 2.0]])
    gx, _ = increments(p, np.zeros_like(p), np.ones((1, 3), dtype=bool))
    np.testing.assert_allclose(gx, [[2.5, 3.0, 0.0]])


def test_masked_values_never_enter() -> None:
    rng = np.random.default_rng(0)
    mask = rng.random((ROWS, COLS)) > 0.3
    p, q, w = rng.standard_normal((3, ROWS, COLS))
    spoilt = [np.where(mask, f, np.nan) for f in (p, q, w)]
    root = np.ones((1, 1))
    for clean, found in zip(defects(p, q, w, root, mask), defects(*spoilt, root, mask), strict=True):
        np.testing.assert_array_equal(clean, found)


def test_defect_of_a_surface_with_its_own_slopes_vanishes() -> None:
    y, x = np.mgrid[:ROWS, :COLS].astype(float)
    w = integral(x) + 0.2 * x * y - 0.1 * y**2
    p, q = cubic(x) + 0.2 * y, 0.2 * x - 0.2 * y
    for g in defects(p, q, w, np.exp(0.05 * x), np.ones(x.shape, dtype=bool)):
        np.testing.assert_allclose(g, 0.0, atol=1e-12)


def test_factor_increments_are_exact_for_a_factor_c_x() -> None:
    """grad log x = 1/x, from half a pixel beside the singularity."""
    x = np.tile(np.arange(COLS) + 0.5, (ROWS, 1))
    zero = np.zeros_like(x)
    gx, gy = factor_increments(1 / x, zero, np.ones(x.shape, dtype=bool))
    np.testing.assert_allclose(gx[:, :-1], np.diff(np.log(x), axis=1), rtol=1e-12)
    assert not gy.any()
    mirrored = factor_increments(-1 / x[:, ::-1].copy(), zero, np.ones(x.shape, dtype=bool))[0]
    np.testing.assert_allclose(mirrored[:, :-1], np.diff(np.log(x[:, ::-1]), axis=1), rtol=1e-12)


def test_edge_weights() -> None:
    var_p, var_q = np.array([[1.0, 3.0], [1.0, 1.0]]), np.full((2, 2), 0.5)
    root = np.array([[1.0, 2.0], [1.0, 1.0]])
    wx, wy = edge_weights(var_p, var_q, root, np.ones((2, 2), dtype=bool))
    np.testing.assert_allclose(wx, [[2.0, 0.0], [1.0, 0.0]])
    np.testing.assert_allclose(wy, [[2.0, 8.0], [0.0, 0.0]])


def test_curl_of_a_rotation_and_of_a_gradient() -> None:
    y, x = np.mgrid[:ROWS, :COLS].astype(float)
    full = np.ones(x.shape, dtype=bool)
    np.testing.assert_allclose(curl(-y, x, full)[:-1, :-1], 2.0)
    np.testing.assert_allclose(curl(2 * x + y, x - y, full)[:-1, :-1], 0.0, atol=1e-12)
    assert np.isnan(curl(x, y, full)[-1]).all()
