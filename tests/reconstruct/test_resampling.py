"""The regular grid: exact for quadratics, and a sigma that knows that points move along slanted rays."""

import numpy as np
import pytest

from optolever.reconstruct import HeightMap


def quadratic(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 1.0 + 0.3 * x - 0.2 * y + 0.05 * x**2 - 0.03 * x * y + 0.02 * y**2


@pytest.fixture
def curved() -> HeightMap:
    """The quadratic on a skewed, mirrored grid, with a hole."""
    row, col = np.mgrid[:20, :30].astype(float)
    x, y = 0.5 * (30 - col) + 0.1 * row, 0.4 * row + 0.05 * col
    flags = np.zeros(x.shape, dtype=np.uint16)
    flags[8:10, 12:14] = 2048
    return HeightMap(x, y, quadratic(x, y), 0.01 + 0.001 * x, flags)


def test_quadratics_come_back_exactly(curved: HeightMap) -> None:
    """At the border and beside the hole, too; a linear sigma, likewise; the grid lies on its pitch."""
    grid = curved.resample(0.3)
    x, y = np.meshgrid(grid.x, grid.y)
    error, inside = np.abs(grid.z - quadratic(x, y)), np.isfinite(grid.z)
    assert np.nanmedian(error) < 1e-12
    assert np.nanmax(error) < 1e-10
    assert 0.6 < inside.mean() < 1
    np.testing.assert_allclose(grid.sigma[inside], (0.01 + 0.001 * x)[inside], atol=1e-12)
    assert grid.x[0] == pytest.approx(0.3 * round(grid.x[0] / 0.3))
    middle = [part[8:10, 12:14].mean() for part in (curved.x, curved.y)]
    hole = np.hypot(x - middle[0], y - middle[1]) < 0.25
    assert hole.any()
    assert not inside[hole].any()


def test_a_tilted_plane_under_slanted_rays() -> None:
    """The closed form: z = s x, points move along (l, 0, 1), so that the plane rises by dz (1 - s l)."""
    slope, lean, step = 0.4, 0.7, 1e-3
    row, col = np.mgrid[:8, :8].astype(float)
    flags = np.zeros(row.shape, dtype=np.uint16)
    leans = np.array([lean, 0.0]).reshape(2, 1, 1)

    def plane(move: float) -> HeightMap:
        x, z = col + move * lean, slope * col + move
        return HeightMap(x, row, z, np.full(x.shape, step), flags, lean=leans)

    before, after = (plane(move).resample(0.5) for move in (0.0, step))
    first = round((after.x0 - before.x0) / 0.5)
    assert first == 1  # the first column has moved past its grid point
    moved = after.z[:, : before.z.shape[1] - first] - before.z[:, first : first + after.z.shape[1]]
    np.testing.assert_allclose(moved, step * (1 - slope * lean), rtol=1e-9)
    np.testing.assert_allclose(before.sigma, step * (1 - slope * lean), rtol=1e-9)
