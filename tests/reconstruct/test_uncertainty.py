"""Error bars grow with the noise; errors at the Cramer-Rao bound."""

import numpy as np
import pytest

from lab.figures.solver_bound import EVERY, least_variance
from optolever.reconstruct import PixelAnchor, reconstruct


def test_sigma_grows_with_the_noise_and_with_the_anchors_own(exact, noisy) -> None:
    scene, truth, _ = exact("paper-simulation", "raised-cosine", 96, 96)
    value = float(truth.z[48, 48])
    small, large = (
        reconstruct(noisy(truth, sigma=s), scene, anchor=PixelAnchor(48, 48, value)).sigma
        for s in (0.001, 0.003)
    )
    np.testing.assert_allclose(large / small, 3.0, rtol=1e-3)
    loose = reconstruct(noisy(truth, sigma=0.01), scene, anchor=PixelAnchor(48, 48, value, sigma=0.5)).sigma
    assert loose[48, 48] == pytest.approx(0.5, rel=0.01)


SIZE, NOISE, SEEDS = 24, 1e-3, 150


@pytest.mark.parametrize("cut", [1.0, pytest.param(0.9, marks=pytest.mark.slow)])
def test_error_at_the_bound(exact, noisy, cut: float) -> None:
    """Whole prism and cut prism (x >= 0.1 L0): rms error over 150 seeds within 5 % of the bound,
    but for chance.
    """
    scene, truth, _ = exact("paper-simulation", "raised-cosine", SIZE, SIZE)
    cols = round(cut * SIZE)
    mask = np.broadcast_to(np.arange(SIZE) < cols, (SIZE, SIZE))
    total = np.zeros((SIZE, SIZE))
    for seed in range(SEEDS):
        height = reconstruct(noisy(truth, NOISE, NOISE, seed), scene, mask=mask)
        total += (height.z - truth.z) ** 2 / SEEDS
    least = NOISE**2 * least_variance(scene, truth, cols)
    found = total[::EVERY, :cols:EVERY]
    assert 0.95 < np.sqrt(found.mean() / least.mean()) < 1.05
    # And in units of the bound, so that the pattern's edge does not rule the sum.
    assert 0.95 < np.sqrt(np.mean(found / np.maximum(least, 0.05 * np.median(least)))) < 1.05
