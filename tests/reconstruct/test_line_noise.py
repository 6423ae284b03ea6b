"""Heights under noise that rows or columns of the frames share: error bars against draws of it."""

from dataclasses import replace

import numpy as np
import pytest

from optolever.decode import LineNoise
from optolever.reconstruct import PixelAnchor, exact_correspondence, reconstruct
from optolever.scene import dent, load, resize, trace

from .conftest import rms_score, scores

SIGMA, SHARE = 0.02, 0.3


def wave(rng: np.random.Generator, size: int, phase: np.ndarray, axis: int) -> np.ndarray:
    """An error of unit variance that lines share, which enters by the cosine of the phase."""
    c, s = rng.standard_normal((2, size)).reshape((2, size, 1) if axis == 0 else (2, 1, size))
    return c * np.cos(phase) + s * np.sin(phase)


@pytest.mark.parametrize("turns", [0.125, 0.03])
@pytest.mark.parametrize("lines", ["rows", "cols"])
@pytest.mark.parametrize("anchor", ["edge", "pixel"])
def test_sigma_is_that_of_draws(lines: str, turns: float, anchor: str) -> None:
    scene = resize(load("prism48"), 96, 96)
    truth = trace(scene, dent("raised-cosine", scene, peak=0.2))
    given = "edge" if anchor == "edge" else PixelAnchor(30, 70, float(truth.z[30, 70]))
    axis, rng, found = ("rows", "cols").index(lines), np.random.default_rng(1), []
    exact = exact_correspondence(truth, SIGMA)
    noise = LineNoise(SHARE * (axis == 0), SHARE * (axis == 1), turns, turns)
    for _ in range(24):
        u, v = (
            at
            + SIGMA * np.sqrt(SHARE) * wave(rng, 96, 2 * np.pi * turns * at, axis)
            + SIGMA * np.sqrt(1 - SHARE) * rng.standard_normal(at.shape)
            for at in (truth.u, truth.v)
        )
        seen = replace(exact, u=u, v=v, line_noise=noise)
        found.append(scores(reconstruct(seen, scene, anchor=given), truth))
    # 1.5 to 2.1 without; in closed form, of one phase's turn and one variance for all of a row
    assert 0.75 < rms_score(np.array(found)) < 1.35
