"""Differences of two maps of one rest capture and one anchor: their errors count once."""

import numpy as np
import pytest

from optolever.decode import Correspondence
from optolever.reconstruct import HeightMap, reconstruct
from optolever.scene import Surface, dent, load, resize, trace

from .conftest import correspondence_of

SCENE = resize(load("prism48", exact=True), 48, 64)
NOISE = 0.02
DRAWS = 60


def captured(surface: Surface, sigma: float, rng: np.random.Generator) -> Correspondence:
    return correspondence_of(trace(SCENE, surface), sigma, sigma, rng)


def spread(differences: list[HeightMap]) -> float:
    """Rms of the differences' scatter over the draws, over the stated sigma, the sags' included: median."""
    good = np.all([each.good for each in differences], axis=0)
    scatter = np.std([each.z[good] for each in differences], axis=0, ddof=1)
    return float(np.median(scatter / np.median([each.total_sigma[good] for each in differences], axis=0)))


def differences(rest_noise: float, common: bool) -> list[HeightMap]:
    """Of two presses, drawn; common: less one rest capture, else each less its own."""
    rng = np.random.default_rng(5)
    pressed = [dent("gaussian", SCENE, peak=peak, sigma=6.0) for peak in (0.05, 0.08)]
    found = []
    for _ in range(DRAWS):
        rest = captured(dent("flat", SCENE), rest_noise, rng)
        one = reconstruct(captured(pressed[0], NOISE, rng), SCENE, rest=rest)
        rest = rest if common else captured(dent("flat", SCENE), rest_noise, rng)
        found.append(reconstruct(captured(pressed[1], NOISE, rng), SCENE, rest=rest) - one)
    return found


@pytest.mark.parametrize(
    ("rest_noise", "least"), [(NOISE, 0.85), pytest.param(5 * NOISE, 0.5, marks=pytest.mark.slow)]
)
def test_noise_of_a_common_rest_capture_counts_once(rest_noise: float, least: float) -> None:
    """As large as a capture's: sigma was 1.4 times too wide; five times as large (a short exposure): 5."""
    assert least < spread(differences(rest_noise, common=True)) < 1.15


@pytest.mark.parametrize("rest_noise", [NOISE, pytest.param(5 * NOISE, marks=pytest.mark.slow)])
def test_nothing_cancels_of_two_rest_captures(rest_noise: float) -> None:
    assert 0.85 < spread(differences(rest_noise, common=False)) < 1.15
