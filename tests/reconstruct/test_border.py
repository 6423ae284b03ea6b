"""Holes, ragged masks and noisy border lines: bridged, left out, reached again, sigma by repeated noise."""

from dataclasses import replace

import numpy as np
import pytest

from optolever.reconstruct import reconstruct

from .conftest import rms_score, scores


@pytest.mark.parametrize("peak", [0.21, pytest.param(0.44, marks=pytest.mark.slow)])
def test_an_island_behind_narrow_slits_stands_where_it_should(exact, noisy, cut, peak: float) -> None:
    """A ring of missing pixels, two wide in a few places only; no noise, and yet sigma 0.01 px."""
    scene, truth, _ = exact("prism48", f"gaussian:peak={peak},sigma=8.2,x=39,y=22.5", 148, 117)
    row, col = np.mgrid[:148, :117]
    lost = np.abs(np.hypot(row - 74, col - 58.5) - 37) < 1.5
    height = reconstruct(cut(noisy(truth, 0.01), ~lost), scene)
    assert height.good[74, 58]
    assert np.nanmax(np.abs(scores(height, truth))) < 1.0


@pytest.fixture(scope="module")
def blurred(exact, noisy):
    """Noise as at a pattern's end: the outer rows and columns twenty times worse, some of them flagged."""
    scene, truth, _ = exact("paper-simulation", "raised-cosine", 128, 128)
    rng = np.random.default_rng(0)
    sigma = np.full(truth.u.shape, 0.01)
    sigma[[0, -1]] = 0.2
    sigma[:, 0] = 0.1
    u, v = (value + sigma * rng.standard_normal(sigma.shape) for value in (truth.u, truth.v))
    correspondence = replace(noisy(truth), u=u, v=v, sigma_u=sigma, sigma_v=sigma.copy())
    flags = correspondence.flags.copy()
    flags[0, 30:90] = 16
    flags[:, -1] = 16
    flags[rng.random(flags.shape) < 0.002] = 8
    return scene, truth, replace(correspondence, flags=flags)


def test_noisy_borders_keep_their_pixels(blurred) -> None:
    scene, truth, correspondence = blurred
    height = reconstruct(correspondence, scene)
    assert np.array_equal(height.good, correspondence.good)
    assert np.isnan(height.z[~correspondence.good]).all()
    assert 0.7 < rms_score(scores(height, truth)) < 1.4
    assert 0.4 < rms_score(scores(height, truth)[0]) < 1.6


def test_outliers_among_good_pixels_are_left_out(exact, noisy) -> None:
    """1 % of wrong fringe orders: flagged, and the rest as good as without them."""
    scene, truth, _ = exact("paper-simulation", "raised-cosine", 128, 128)
    clean = noisy(truth, noise=0.02, seed=1)
    rng = np.random.default_rng(2)
    wrong = rng.random(truth.u.shape) < 0.01
    u = clean.u + np.where(wrong, rng.choice([-1.0, 1.0], wrong.shape) * 9.0, 0.0)
    height = reconstruct(replace(clean, u=u), scene)
    heavy = np.zeros_like(wrong)
    heavy[:, :100] = True  # near the pattern's edge 9 px are no more than noise
    assert height.flags[wrong & heavy].astype(bool).mean() > 0.97
    unspoilt = reconstruct(clean, scene)
    good = height.good & ~wrong & heavy
    errors = [np.sqrt(np.mean((h.z - truth.z)[good] ** 2)) for h in (height, unspoilt)]
    assert errors[0] < 2 * errors[1]
    assert (height.flags[heavy & ~wrong] == 0).mean() > 0.97


def passage(shape: tuple[int, int]) -> np.ndarray:
    """Halves that two rows of pixels join."""
    lost = np.zeros(shape, dtype=np.bool_)
    lost[:, 30:34] = True
    lost[20:22] = False
    return lost


@pytest.mark.daily(2)
@pytest.mark.parametrize(
    ("dropouts", "off"), [(0.0, 0.05), (0.1, 0.15), (0.3, 0.15), (0.35, 0.2), (None, 0.2)]
)
def test_sigma_of_a_mask_is_what_repeated_noise_gives(
    exact, noisy, cut, dropouts: float | None, off: float
) -> None:
    """Where a share of all pixels drops out, and behind a passage; at every distance from the anchor."""
    scene, truth, _ = exact("paper-simulation", "gaussian", 64, 64)
    shape = truth.u.shape
    lost = passage(shape) if dropouts is None else np.random.default_rng(5).random(shape) < dropouts
    seen = (cut(noisy(truth, 0.05, 0.05, seed), ~lost) for seed in range(60 if dropouts == 0 else 12))
    found = np.array([scores(reconstruct(each, scene), truth) for each in seen])
    assert rms_score(found) == pytest.approx(1, abs=off)
    for third in np.array_split(found, 3, axis=2):
        assert rms_score(third) == pytest.approx(1, abs=2.4 * off)
    assert np.mean(np.abs(found) > 5) < 5e-4
