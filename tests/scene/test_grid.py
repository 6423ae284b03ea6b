"""The bicubic surface: equal to FITPACK's spline, smooth, level beyond its edges."""

import numpy as np
import pytest
from scipy.interpolate import RectBivariateSpline

from optolever import InputError
from optolever.scene import Grid, dent, load, surface_from_array

X0, Y0, DX, DY = 2.0, -1.0, 0.5, 0.25


def random_grid(rows=17, cols=23, seed=1):
    return Grid(np.random.default_rng(seed).normal(size=(rows, cols)), X0, Y0, DX, DY)


def inside(grid, count=500, seed=2):
    rng = np.random.default_rng(seed)
    rows, cols = grid.z.shape
    return rng.uniform(X0, X0 + DX * (cols - 1), count), rng.uniform(Y0, Y0 + DY * (rows - 1), count)


@pytest.mark.parametrize("shape", [(17, 23), (4, 4), (4, 9), (12, 7)])
def test_equals_fitpack(shape):
    """scipy's interpolating spline (not-a-knot too, another basis, another solver)."""
    grid = random_grid(*shape)
    rows, cols = shape
    truth = RectBivariateSpline(Y0 + DY * np.arange(rows), X0 + DX * np.arange(cols), grid.z, s=0)
    x, y = inside(grid)
    assert np.abs(grid.height(x, y) - truth.ev(y, x)).max() < 1e-12
    assert np.abs(grid.gradient(x, y)[0] - truth.ev(y, x, dy=1)).max() < 1e-11
    assert np.abs(grid.gradient(x, y)[1] - truth.ev(y, x, dx=1)).max() < 1e-11


def test_level_and_without_a_step_beyond_the_edges():
    grid = random_grid()
    rows, cols = grid.z.shape
    right, bottom = X0 + DX * (cols - 1), Y0 + DY * (rows - 1)
    x, y = inside(grid, 100)
    for beyond in (right + 1e-9, right + 7.0):
        assert np.allclose(grid.height(0 * x + beyond, y), grid.height(0 * x + right, y), atol=1e-12, rtol=0)
        assert not grid.gradient(0 * x + beyond, y)[0].any()
        along = grid.gradient(0 * x + right, y)[1]
        assert np.array_equal(grid.gradient(0 * x + beyond, y)[1], along)
    assert np.array_equal(grid.height(x, 0 * y - 99), grid.height(x, 0 * y + Y0))
    assert np.array_equal(grid.height(x, 0 * y + 99), grid.height(x, 0 * y + bottom))


def test_sampled_surface_converges_with_the_fourth_power():
    scene = load("paper-simulation")
    exact = dent("raised-cosine", scene)
    x, y = np.random.default_rng(0).uniform(0, 163.7, (2, 3000))
    errors = [np.abs(exact.sampled(scene, p).height(x, y) - exact.height(x, y)).max() for p in (4.0, 2.0)]
    assert 13 < errors[0] / errors[1] < 19
    grid = exact.sampled(scene, 2.0).grid
    assert grid is not None
    assert grid.x0 + grid.dx * (grid.z.shape[1] - 1) == pytest.approx(163.7, abs=1e-12)
    assert grid.dx <= 2.0


def test_surface_from_array_places_rows_on_y():
    z = np.arange(30.0).reshape(5, 6)
    surface = surface_from_array(z, 10.0, 20.0, 2.0)
    assert surface.height(np.array(14.0), np.array(22.0)) == pytest.approx(z[1, 2], abs=1e-13)
    assert surface.formula is None


@pytest.mark.parametrize(
    ("z", "pitch", "message"),
    [
        (np.zeros((3, 9)), 1.0, r"grid\.z has shape \(3, 9\): must be at least 4 x 4"),
        (np.zeros(9), 1.0, r"grid\.z has shape \(9,\)"),
        (np.full((5, 5), np.nan), 1.0, r"grid\.z has 25 heights that are not finite"),
        (np.zeros((5, 5)), 0.0, r"grid\.dx = 0\.0: must be greater than 0"),
    ],
)
def test_bad_arrays(z, pitch, message):
    with pytest.raises(InputError, match=message):
        surface_from_array(z, 0.0, 0.0, pitch)
