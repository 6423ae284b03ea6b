"""Slopes and curvature against the traced surface, sigmas against scatter; grids: exact for quadratics, and a
sigma that knows that points move along slanted rays."""

from dataclasses import replace

import numpy as np
import pytest

from optolever import InputError
from optolever.reconstruct import HeightMap, SlopeMap, curvature_map, reconstruct, slope_map
from optolever.scene import dent_from_text

DENTS = [("paper-simulation", "gaussian"), ("monitor-mirror", "gaussian"), ("prism48", "gaussian")]


@pytest.mark.parametrize(("preset", "dent"), DENTS)
def test_slopes_are_those_of_the_surface(exact, preset: str, dent: str) -> None:
    """At the true points the normals are exact; at the reconstructed ones as good as the height is."""
    scene, truth, correspondence = exact(preset, dent, 64, 64)
    surface = dent_from_text(dent, scene)
    flags = np.where(truth.visible, 0, 16).astype(np.uint16)
    true = HeightMap(truth.x, truth.y, truth.z, np.zeros(truth.z.shape), flags)
    for height, limit in ((true, 1e-12), (reconstruct(correspondence, scene), 1e-6)):
        slopes = slope_map(height, correspondence, scene)
        for found, expected in zip(
            (slopes.slope_x, slopes.slope_y), surface.gradient(height.x, height.y), strict=True
        ):
            assert np.abs(found - expected)[slopes.good].max() < limit


@pytest.mark.daily(1)
@pytest.mark.parametrize(("preset", "dent"), DENTS[:2])
def test_sigma_against_scatter(exact, noisy, preset: str, dent: str) -> None:
    scene, truth, correspondence = exact(preset, dent, 64, 64)
    height = reconstruct(correspondence, scene)
    still = replace(height, sigma=np.zeros(height.z.shape))
    expected = slope_map(still, correspondence, scene)
    draws = [slope_map(still, noisy(truth, 0.02, 0.02, seed), scene) for seed in range(50)]
    for name in "xy":
        scatter = np.std([getattr(draw, f"slope_{name}") for draw in draws], axis=0)
        ratio = (scatter / getattr(expected, f"sigma_{name}"))[expected.good]
        assert np.sqrt(np.mean(ratio**2)) == pytest.approx(1.0, abs=0.02)
    whole = slope_map(height, correspondence, scene)
    assert np.all(whole.sigma_x[height.good] >= expected.sigma_x[height.good])


def quadratic(noise: float = 0.0, seed: int = 0) -> SlopeMap:
    """z = 1/2 (0.03 x^2 + 0.02 x y - 0.05 y^2) on a skewed grid."""
    row, col = np.mgrid[:24, :32].astype(float)
    x, y = 0.5 * col + 0.1 * row, 0.4 * row - 0.05 * col
    error = noise * np.random.default_rng(seed).standard_normal((2, *x.shape))
    sigma = np.full(x.shape, noise or 1e-6)
    flags = np.zeros(x.shape, dtype=np.uint16)
    flags[10, 10] = 1
    return SlopeMap(x, y, 0.03 * x + 0.01 * y + error[0], 0.01 * x - 0.05 * y + error[1], sigma, sigma, flags)


def test_curvature_of_a_quadratic() -> None:
    slopes = quadratic()
    found = curvature_map(slopes)
    inside = slopes.good
    for name, expected in (("xx", 0.03), ("xy", 0.01), ("yy", -0.05)):
        np.testing.assert_allclose(getattr(found, name)[inside], expected, rtol=1e-9)
    p, q = slopes.slope_x, slopes.slope_y
    mean = ((1 + q**2) * 0.03 - 2 * p * q * 0.01 - (1 + p**2) * 0.05) / (2 * (1 + p**2 + q**2) ** 1.5)
    np.testing.assert_allclose(found.mean[inside], mean[inside], rtol=1e-8, atol=1e-12)
    assert np.isnan(found.mean[10, 10])


def test_curvature_sigma_against_scatter() -> None:
    draws = [curvature_map(quadratic(1e-4, seed), 3) for seed in range(60)]
    for name in ("xx", "xy", "yy", "mean"):
        scatter = np.std([getattr(draw, name) for draw in draws], axis=0)
        ratio = scatter / getattr(draws[0], f"sigma_{name}")
        assert np.sqrt(np.nanmean(ratio**2)) == pytest.approx(1.0, abs=0.03)


def test_bad_input(exact) -> None:
    scene, _, correspondence = exact("paper-simulation", "flat", 24, 24)
    other = exact("paper-simulation", "flat", 16, 24)
    height = reconstruct(correspondence, scene)
    with pytest.raises(InputError, match="shape"):
        slope_map(height, other[2], scene)
    with pytest.raises(InputError, match="camera"):
        slope_map(height, correspondence, other[0])
    with pytest.raises(InputError, match="reach"):
        curvature_map(slope_map(height, correspondence, scene), 0)


def height_of(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 1.0 + 0.3 * x - 0.2 * y + 0.05 * x**2 - 0.03 * x * y + 0.02 * y**2


@pytest.fixture
def curved() -> HeightMap:
    """The quadratic on a skewed, mirrored grid, with a hole."""
    row, col = np.mgrid[:20, :30].astype(float)
    x, y = 0.5 * (30 - col) + 0.1 * row, 0.4 * row + 0.05 * col
    flags = np.zeros(x.shape, dtype=np.uint16)
    flags[8:10, 12:14] = 2048
    return HeightMap(x, y, height_of(x, y), 0.01 + 0.001 * x, flags)


def test_quadratics_come_back_exactly(curved: HeightMap) -> None:
    """At the border and beside the hole, too; a linear sigma, likewise; the grid lies on its pitch."""
    grid = curved.resample(0.3)
    x, y = np.meshgrid(grid.x, grid.y)
    error, inside = np.abs(grid.z - height_of(x, y)), np.isfinite(grid.z)
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
