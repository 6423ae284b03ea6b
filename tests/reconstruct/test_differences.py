"""Differences of two maps of one rest capture and one anchor: their errors count once."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optolever.decode import Correspondence
from optolever.reconstruct import HeightMap, PixelAnchor, exact_correspondence, reconstruct
from optolever.scene import Surface, dent, load, resize, trace

SCENE = resize(load("prism48", exact=True), 48, 64)
NOISE = 0.02
DRAWS = 60


def captured(surface: Surface, sigma: float, rng: np.random.Generator) -> Correspondence:
    seen = exact_correspondence(trace(SCENE, surface), sigma)
    u, v = (part + sigma * rng.standard_normal(part.shape) for part in (seen.u, seen.v))
    return replace(seen, u=u, v=v)


def spread(differences: list[HeightMap]) -> float:
    """Rms of the differences' scatter over the draws, over the stated sigma: median of the pixels."""
    good = np.all([each.good for each in differences], axis=0)
    scatter = np.std([each.z[good] for each in differences], axis=0, ddof=1)
    return float(np.median(scatter / np.median([each.sigma[good] for each in differences], axis=0)))


@pytest.mark.parametrize("rest_noise", [NOISE, pytest.param(5 * NOISE, marks=pytest.mark.slow)])
def test_noise_of_a_common_rest_capture_counts_once(rest_noise: float) -> None:
    """As large as a capture's: sigma was 1.4 times too wide; five times as large (a short exposure): 5."""
    rng = np.random.default_rng(5)
    pressed = [dent("gaussian", SCENE, peak=peak, sigma=6.0) for peak in (0.05, 0.08)]
    found, apart = [], []
    for _ in range(DRAWS):
        rest = captured(dent("flat", SCENE), rest_noise, rng)
        one, two = (reconstruct(captured(each, NOISE, rng), SCENE, rest=rest) for each in pressed)
        found.append(two - one)
        other = captured(dent("flat", SCENE), rest_noise, rng)
        apart.append(two - reconstruct(captured(pressed[0], NOISE, rng), SCENE, rest=other))
    assert 0.85 < spread(found) < 1.15
    assert 0.85 < spread(apart) < 1.15  # of two rest captures nothing cancels


@pytest.mark.slow
def test_error_of_a_common_anchor_counts_once(tmp_path: Path) -> None:
    """An anchor known to 10 um moves both maps alike; another one does not, and files keep that."""
    rng, found, apart = np.random.default_rng(6), [], []
    pressed = [dent("gaussian", SCENE, peak=peak, sigma=6.0) for peak in (0.05, 0.08)]
    for _ in range(DRAWS):
        anchors = [PixelAnchor(4, 40, 0.01 * rng.standard_normal(), 0.01) for _ in range(2)]
        one, two, three = (
            reconstruct(captured(pressed[k], NOISE, rng), SCENE, anchor=anchors[which])
            for k, which in ((0, 0), (1, 0), (0, 1))
        )
        found.append(two - one)
        apart.append(two - three)
    one.save(tmp_path / "one.npz")
    kept = HeightMap.load(tmp_path / "one.npz")
    np.testing.assert_allclose(
        (two - kept).sigma, (two - one).sigma, rtol=1e-4, atol=1e-6
    )  # maps are float32
    assert 0.85 < spread(found) < 1.2
    assert 0.8 < spread(apart) < 1.2
    good = two.good & one.good
    assert np.median(found[-1].sigma[good]) < 0.1 * np.median(one.sigma[good])
