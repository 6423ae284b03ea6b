"""Wrong pixels are told from creases, rims and curved fields by the curl of their slopes."""

from dataclasses import replace

import numpy as np
import pytest

from optolever.reconstruct import HeightFlag, reconstruct

SIGMA = 0.05


def curled(height) -> np.ndarray:
    return np.asarray((height.flags & HeightFlag.CURL) > 0)


def test_large_errors_are_found_in_pairs_too_and_little_else(exact, noisy) -> None:
    """Beside a missing pixel, too: what was interpolated from a wrong one is no witness."""
    scene, truth, _ = exact("monitor-mirror", "gaussian", 60, 70)
    clean = noisy(truth, SIGMA, SIGMA)
    places = [(5, 5), (0, 30), (20, 69), (21, 69), (40, 40), (40, 41), (30, 12)]
    u, flags = clean.u.copy(), clean.flags.copy()
    for k, place in enumerate(places):
        u[place] += (-1) ** k * (4.0 + 2 * k)
    flags[30, [11, 13]] = flags[29, 12] = 1
    height = reconstruct(replace(clean, u=u, flags=flags), scene)
    found = curled(height)
    assert all(found[place] for place in places)
    assert found.sum() <= 3 * len(places)
    score = np.where(height.good, (height.z - truth.z) / height.sigma, 0.0)
    assert np.abs(score).max() < 5


@pytest.mark.parametrize("dent", ["ridge:angle_deg=30", "ball", "needle"])
def test_a_crease_a_rim_and_a_tip_are_no_outliers(exact, noisy, dent: str) -> None:
    """But for pixels of their very edge."""
    scene, truth, _ = exact("paper-simulation", dent, 60, 70)
    assert curled(reconstruct(noisy(truth, SIGMA, SIGMA), scene)).mean() < 0.002
    assert curled(reconstruct(noisy(truth, 1e-4, 1e-4), scene)).mean() < 0.03
