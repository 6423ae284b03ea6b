"""The solve against the Cramer-Rao bound: sparse algebra on the law of reflection, nothing of the solver."""

import numpy as np
import pytest

from optolever.experiments.solver_bound import EVERY, least_variance
from optolever.reconstruct import reconstruct

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
