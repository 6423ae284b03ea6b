"""Slopes and curvature against the surface that was traced, their sigmas against scatter."""

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
