"""Errors that neighbours share: found by the slopes' circulation around blocks, and in sigma."""

from dataclasses import replace

import numpy as np

from optolever.decode import Correspondence
from optolever.reconstruct import reconstruct
from optolever.reconstruct.correlation import correlation_excess

from .conftest import rms_score, scores


def test_independent_noise_has_no_excess_and_shared_noise_has() -> None:
    rng = np.random.default_rng(3)
    shape, block = (256, 256), 8
    mask = np.ones(shape, dtype=bool)
    variances = np.ones(shape), np.ones(shape)
    p, q = rng.standard_normal((2, *shape))
    assert correlation_excess(p, q, variances, mask, None) == 1.0
    coarse = rng.standard_normal((2, shape[0] // block, shape[1] // block))
    p, q = np.kron(coarse, np.ones((1, block, block)))
    found = correlation_excess(p, q, variances, mask, None)
    assert 0.5 * block**2 < found < 2 * block**2


def test_slopes_that_tell_nothing_do_not_hide_the_others() -> None:
    """At a needle's tip variances have no bound: sums over an image then did not hold the usual one."""
    rng = np.random.default_rng(4)
    shape, block = (256, 256), 8
    mask, unknown = np.ones(shape, dtype=bool), np.ones(shape)
    unknown[100, 100:103] = 1e22
    coarse = rng.standard_normal((2, shape[0] // block, shape[1] // block))
    p, q = np.kron(coarse, np.ones((1, block, block)))
    usual = correlation_excess(p, q, (np.ones(shape), np.ones(shape)), mask, None)
    found = correlation_excess(p, q, (unknown, unknown.copy()), mask, None)
    assert abs(found / usual - 1) < 0.15


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
