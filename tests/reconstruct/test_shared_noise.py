"""Heights under noise that rows, columns or whole frames share: error bars against draws of it."""

from dataclasses import replace

import numpy as np
import pytest

from optolever.decode import SharedNoise
from optolever.reconstruct import PixelAnchor, exact_correspondence, reconstruct
from optolever.scene import dent, load, resize, trace

from .conftest import rms_score, scores

SIGMA, SHARE, SIZE = 0.02, 0.3, 96
SHAPES = {"rows": (2, SIZE, 1), "cols": (2, 1, SIZE), "frames": (2, 1, 1)}


@pytest.mark.parametrize("turns", [0.125, 0.03])
@pytest.mark.parametrize("common", SHAPES)
@pytest.mark.parametrize("anchor", ["edge", "pixel"])
def test_sigma_is_that_of_draws(common: str, turns: float, anchor: str) -> None:
    scene = resize(load("prism48"), SIZE, SIZE)
    truth = trace(scene, dent("raised-cosine", scene, peak=0.2))
    given = "edge" if anchor == "edge" else PixelAnchor(30, 70, float(truth.z[30, 70]))
    exact, rng, found = exact_correspondence(truth, SIGMA), np.random.default_rng(1), []
    shares = [SHARE * (common == one) for one in ("rows", "cols", "frames", "frames")]

    def seen(at: np.ndarray) -> np.ndarray:
        """With noise of which a share is common, and enters by the cosine of the phase."""
        c, s = rng.standard_normal(SHAPES[common])
        phase = 2 * np.pi * turns * at
        alone = np.sqrt(1 - SHARE) * rng.standard_normal(at.shape)
        return at + SIGMA * (np.sqrt(SHARE) * (c * np.cos(phase) + s * np.sin(phase)) + alone)

    for _ in range(24):
        noise = SharedNoise(*shares, turns, turns)
        one = replace(exact, u=seen(truth.u), v=seen(truth.v), shared_noise=noise)
        found.append(scores(reconstruct(one, scene, anchor=given), truth))
    # 1.5 to 3 without; in closed form, of one phase's turn and one variance for all of a row
    assert 0.75 < rms_score(np.array(found)) < 1.35


@pytest.mark.parametrize("anchor", ["edge", "pixel"])
def test_all_places_off_by_the_same(anchor: str) -> None:
    """As a camera that shakes leaves them."""
    scene = resize(load("prism48"), SIZE, SIZE)
    truth = trace(scene, dent("raised-cosine", scene, peak=0.2))
    given = "edge" if anchor == "edge" else PixelAnchor(30, 70, float(truth.z[30, 70]))
    exact, rng, found = exact_correspondence(truth, SIGMA), np.random.default_rng(1), []
    for _ in range(24):
        u, v = (
            at + SIGMA * rng.standard_normal(at.shape) + SIGMA * rng.standard_normal()
            for at in (truth.u, truth.v)
        )
        noise = SharedNoise(0.0, 0.0, 0.0, 0.0, 0.125, 0.125, SIGMA, SIGMA)
        seen = replace(exact, u=u, v=v, shared_noise=noise)
        found.append(scores(reconstruct(seen, scene, anchor=given), truth))
    # 6 and more without; 48 numbers tell it to 10 %
    assert 0.75 < rms_score(np.array(found)) < 1.35
