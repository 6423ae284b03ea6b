"""Errors that neighbours share: found by the slopes' circulation around blocks, and in sigma."""

from dataclasses import replace

import numpy as np

from optolever.decode import Correspondence
from optolever.reconstruct import reconstruct

from .conftest import rms_score, scores


def test_sigma_holds_errors_that_neighbours_share(exact) -> None:
    """Noise that blocks of 8 x 8 pixels share: the scatter over draws."""
    scene, truth, correspondence = exact("paper-simulation", "raised-cosine", 128, 128)
    rng, block, sigma = np.random.default_rng(3), np.ones((8, 8)), np.full(truth.u.shape, 0.02)
    found = []
    for _ in range(8):
        u, v = (part + 0.02 * np.kron(rng.standard_normal((16, 16)), block) for part in (truth.u, truth.v))
        height = reconstruct(replace(correspondence, u=u, v=v, sigma_u=sigma, sigma_v=sigma), scene)
        assert height.diagnostics.correlation > 16
        found.append(scores(height, truth))
    assert 0.5 < rms_score(*found) < 1.5


def whole_cells(seen: Correspondence) -> Correspondence:
    """Rounded to whole pattern pixels, with their sigma."""
    sigma = np.full(seen.u.shape, 1 / np.sqrt(12))
    return replace(seen, u=np.rint(seen.u), v=np.rint(seen.v), sigma_u=sigma, sigma_v=sigma.copy())


def test_quantised_coordinates_get_a_wider_sigma(exact) -> None:
    """Whole pattern pixels, as a Gray code tells them; without the factor the ratio is 3 and more."""
    scene, truth, correspondence = exact("paper-simulation", "raised-cosine", 192, 192)
    height = reconstruct(whole_cells(correspondence), scene)
    assert height.diagnostics.correlation > 1.5
    assert 0.5 < rms_score(scores(height, truth)) < 1.2


def test_whole_cells_on_a_smooth_mirror_are_no_creases(exact) -> None:
    """Rounding errors are those of neighbours: a curl without noise, steps that had looked like creases."""
    scene, truth, correspondence = exact("monitor-mirror", "raised-cosine:peak=0.24", 96, 115)
    height = reconstruct(whole_cells(correspondence), scene)
    assert height.good[truth.visible].mean() > 0.99
    assert np.sqrt(np.nanmean((height.z - truth.z) ** 2)) < 0.03 * 0.24
