"""Masks that leave few pixels with four neighbours: sigma against repeated noise; pieces cut off."""

from types import SimpleNamespace

import numpy as np
import pytest

from optolever.reconstruct import HeightFlag, reconstruct
from optolever.reconstruct.curl import lone

from .conftest import rms_score, scores


def passage(shape: tuple[int, int]) -> np.ndarray:
    """Halves that two rows of pixels join."""
    lost = np.zeros(shape, dtype=np.bool_)
    lost[:, 30:34] = True
    lost[20:22] = False
    return lost


@pytest.mark.parametrize(("dropouts", "off"), [(0.1, 0.15), (0.3, 0.15), (0.35, 0.2), (None, 0.2)])
def test_sigma_of_a_mask_is_what_repeated_noise_gives(
    exact, noisy, cut, dropouts: float | None, off: float
) -> None:
    """Where a share of all pixels drops out, and behind a passage."""
    scene, truth, _ = exact("paper-simulation", "gaussian", 64, 64)
    shape = truth.u.shape
    lost = passage(shape) if dropouts is None else np.random.default_rng(5).random(shape) < dropouts
    seen = (cut(noisy(truth, 0.05, 0.05, seed), ~lost) for seed in range(12))
    found = np.array([scores(reconstruct(each, scene), truth) for each in seen])
    assert rms_score(found) == pytest.approx(1, abs=off)
    assert np.mean(np.abs(found) > 5) < 5e-4


def test_specks_beside_the_anchor_are_not_guessed(exact, noisy, cut) -> None:
    scene, truth, _ = exact("paper-simulation", "gaussian", 64, 64)
    keep = np.ones(truth.u.shape, dtype=np.bool_)
    keep[18:25, 0:5] = False
    keep[21, 0] = True
    height = reconstruct(cut(noisy(truth, 0.01), keep), scene)
    assert height.flags[21, 0] & HeightFlag.NO_ANCHOR
    assert height.good[30, 30]


def test_a_missing_pixel_flags_none_but_itself(exact, noisy, cut) -> None:
    """Where doubts surround the anchors' edge (slopes change fast there), holes elsewhere change nothing."""
    scene, truth, _ = exact("paper-prototype", "ball:peak=0.075,radius=910", 172, 108)
    share = []
    for hole in (None, (80, 50), (55, 107)):
        keep = np.ones(truth.u.shape, dtype=np.bool_)
        if hole is not None:
            keep[hole] = False
        share.append(reconstruct(cut(noisy(truth, 7e-4), keep), scene).good.mean())
    assert share[0] > 0.9
    np.testing.assert_allclose(share[1:], share[0], atol=1e-3)


def test_a_suspect_without_surroundings_is_not_blamed() -> None:
    nothing = np.full((12, 12), np.nan)
    seen = SimpleNamespace(u=nothing, v=nothing, sigma_u=np.ones((12, 12)), sigma_v=np.ones((12, 12)))
    suspects = np.zeros((12, 12), dtype=np.bool_)
    suspects[6, 6] = True
    assert not lone(suspects, seen).any()
