"""Sigma against what single pixels do to the height, added up; against draws of noise that lines or frames
share."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.decode import Correspondence, SharedNoise
from optolever.reconstruct import HeightMap, PixelAnchor, reconstruct
from optolever.scene import Scene

from .conftest import rms_score, scores

Floats = NDArray[np.float64]
SIZE, NOISE = 24, 0.003


def scatter(seen: Correspondence, scene: Scene, anchor: PixelAnchor) -> tuple[HeightMap, Floats]:
    """The height, and the standard deviation (H, W) that noise gives it: each place alone moved by its sigma.

    This is the solver's own answer, without any formula for sigma.
    """
    still = reconstruct(seen, scene, anchor=anchor)
    variance = np.zeros(still.z.shape)
    for name in ("u", "v"):
        place, sigma = getattr(seen, name), getattr(seen, f"sigma_{name}")
        for pixel in map(tuple, np.argwhere(still.good)):
            moved = place.copy()
            moved[pixel] += sigma[pixel]
            height = reconstruct(replace(seen, **{name: moved}), scene, anchor=anchor)
            variance += np.nan_to_num(height.z - still.z) ** 2
    return still, np.sqrt(variance)


def uneven(kind: str) -> Floats:
    """Noise over the usual, (SIZE, SIZE)."""
    noise = np.ones((SIZE, SIZE))
    if kind == "row":
        noise[12] = 2.0
    elif kind == "border":
        noise[0] = 2.0
    elif kind == "patch":
        noise[11:13, 11:13] = 2.0
    elif kind == "any":
        noise = np.exp(0.7 * np.random.default_rng(0).standard_normal(noise.shape))
    return noise


@pytest.mark.daily(1)
@pytest.mark.parametrize(
    ("preset", "kind", "off"),
    [
        ("monitor-mirror", "even", 0.03),
        ("monitor-mirror", "row", 0.12),
        ("monitor-mirror", "patch", 0.12),
        ("monitor-mirror", "border", 0.12),
        ("monitor-mirror", "any", 0.12),
        ("paper-simulation", "even", 0.07),
    ],
)
def test_sigma_is_what_the_noise_of_all_pixels_adds_up_to(exact, preset: str, kind: str, off: float) -> None:
    """Weights by columns, in the closed form; others by drawn noise, whose sigma is uncertain by 9 %."""
    scene, truth, seen = exact(preset, "flat", SIZE, SIZE)
    sigma = NOISE * uneven(kind)
    seen = replace(seen, sigma_u=sigma, sigma_v=sigma)
    height, found = scatter(seen, scene, PixelAnchor(12, 12, float(truth.z[12, 12])))
    assert height.good.all()
    found[12, 12] = np.nan  # known
    ratio = height.sigma / found
    inside = ratio[3:-3, 3:-3]
    assert rms_score(inside) == pytest.approx(1.0, abs=off)
    assert np.nanmin(ratio) > (0.8 if kind == "even" else 0.65)


def test_sigma_grows_with_the_noise_and_with_the_anchors_own(exact, noisy) -> None:
    scene, truth, _ = exact("paper-simulation", "raised-cosine", 96, 96)
    value = float(truth.z[48, 48])
    small, large = (
        reconstruct(noisy(truth, sigma=s), scene, anchor=PixelAnchor(48, 48, value)).sigma
        for s in (0.001, 0.003)
    )
    np.testing.assert_allclose(large / small, 3.0, rtol=1e-3)
    loose = reconstruct(noisy(truth, sigma=0.01), scene, anchor=PixelAnchor(48, 48, value, sigma=0.5)).sigma
    assert loose[48, 48] == pytest.approx(0.5, rel=0.01)


SIGMA, SHARE, SIDE = 0.02, 0.3, 96
SHAPES = {"rows": (2, SIDE, 1), "cols": (2, 1, SIDE), "frames": (2, 1, 1)}


@pytest.mark.daily(2)
@pytest.mark.parametrize("turns", [0.125, 0.03])
@pytest.mark.parametrize("common", SHAPES)
@pytest.mark.parametrize("anchor", ["edge", "pixel"])
def test_sigma_of_shared_noise_is_that_of_draws(exact, common: str, turns: float, anchor: str) -> None:
    scene, truth, right = exact("prism48", "raised-cosine:peak=0.2", SIDE, SIDE)
    given = "edge" if anchor == "edge" else PixelAnchor(30, 70, float(truth.z[30, 70]))
    rng, found = np.random.default_rng(1), []

    def seen(at: Floats) -> Floats:
        """With noise of which a share is common, and enters by the cosine of the phase."""
        c, s = rng.standard_normal(SHAPES[common])
        phase = 2 * np.pi * turns * at
        alone = np.sqrt(1 - SHARE) * rng.standard_normal(at.shape)
        return at + SIGMA * (np.sqrt(SHARE) * (c * np.cos(phase) + s * np.sin(phase)) + alone)

    shares = [SHARE * (common == one) for one in ("rows", "cols", "frames", "frames")]
    for _ in range(24):
        u, v = seen(truth.u), seen(truth.v)
        one = replace(right, u=u, v=v, shared_noise=SharedNoise(*shares, turns, turns))
        found.append(scores(reconstruct(one, scene, anchor=given), truth))
    # 1.4 to 4.6 without; in closed form, of one phase's turn and one variance for all of a row
    assert 0.75 < rms_score(*found) < 1.35
