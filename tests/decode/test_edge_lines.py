"""Outermost lines of the image behind a camera's filter, which repeats or mirrors pixels beyond its edge."""

import cv2
import numpy as np
import pytest

from optolever.decode import decode
from optolever.experiments.metrics import rms
from optolever.patterns import sequence_from_text

from .conftest import Map, Shoot


@pytest.mark.daily(1)
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", ["phase", "gray+phase"])
def test_behind_an_unsharp_mask(name: str, seed: int, smooth: Map, shoot: Shoot) -> None:
    """What it shifts of fringes along all four sides of a mirror that fills the image is in sigma."""
    shown = sequence_from_text(name, 150, 170)
    frames = shoot(shown, *smooth, noise=1.0, seed=seed, amplitude=60.0).astype(np.float64)
    soft = np.array([cv2.GaussianBlur(frame, (0, 0), 1.5) for frame in frames])
    found = decode(np.clip(np.rint(frames + 0.8 * (frames - soft)), 0, 255).astype(np.uint8), shown)
    outer = found.good.copy()
    outer[2:-2, 2:-2] = False
    error, sigma = (np.array(both) for both in ((found.u, found.v), (found.sigma_u, found.sigma_v)))
    score = ((error - smooth) / sigma)[:, outer]
    # without: 6.6 to 7.5, and 0.35 to 0.37
    assert rms(score) < 2.5
    assert (np.abs(score) > 5).mean() < 0.03
    assert np.median(found.sigma_u[5:-5, 5:-5]) < 0.055
