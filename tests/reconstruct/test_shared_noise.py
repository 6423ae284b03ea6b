"""Heights under noise that rows, columns or whole frames share: error bars against draws of it."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from optolever.decode import SharedNoise
from optolever.reconstruct import PixelAnchor, exact_correspondence, reconstruct
from optolever.scene import dent, load, resize, trace

from .conftest import rms_score, scores

SIGMA, SHARE, SIZE = 0.02, 0.3, 96
SHAPES = {"rows": (2, SIZE, 1), "cols": (2, 1, SIZE), "frames": (2, 1, 1)}


Seen = Callable[[np.ndarray, np.random.Generator], np.ndarray]


def score(anchor: str, noise: SharedNoise, seen: Seen) -> float:
    """rms(error / sigma) of 24 draws of what is seen of u and v."""
    scene = resize(load("prism48", exact=True), SIZE, SIZE)
    truth = trace(scene, dent("raised-cosine", scene, peak=0.2))
    given = "edge" if anchor == "edge" else PixelAnchor(30, 70, float(truth.z[30, 70]))
    exact, rng, found = exact_correspondence(truth, SIGMA), np.random.default_rng(1), []
    for _ in range(24):
        one = replace(exact, u=seen(truth.u, rng), v=seen(truth.v, rng), shared_noise=noise)
        found.append(scores(reconstruct(one, scene, anchor=given), truth))
    return rms_score(np.array(found))


@pytest.mark.daily(2)
@pytest.mark.parametrize("turns", [0.125, 0.03])
@pytest.mark.parametrize("common", SHAPES)
@pytest.mark.parametrize("anchor", ["edge", "pixel"])
def test_sigma_is_that_of_draws(common: str, turns: float, anchor: str) -> None:
    def seen(at: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """With noise of which a share is common, and enters by the cosine of the phase."""
        c, s = rng.standard_normal(SHAPES[common])
        phase = 2 * np.pi * turns * at
        alone = np.sqrt(1 - SHARE) * rng.standard_normal(at.shape)
        return at + SIGMA * (np.sqrt(SHARE) * (c * np.cos(phase) + s * np.sin(phase)) + alone)

    shares = [SHARE * (common == one) for one in ("rows", "cols", "frames", "frames")]
    # 1.4 to 4.6 without; in closed form, of one phase's turn and one variance for all of a row
    assert 0.75 < score(anchor, SharedNoise(*shares, turns, turns), seen) < 1.35
