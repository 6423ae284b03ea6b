"""Sigma against what single pixels do to the height, added up; at creases, against the truth."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.decode import Correspondence
from optolever.reconstruct import HeightMap, PixelAnchor, reconstruct
from optolever.scene import Scene

from .conftest import rms_score

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
        ("monitor-mirror", "row", 0.03),
        ("monitor-mirror", "patch", 0.03),
        ("monitor-mirror", "border", 0.05),
        ("monitor-mirror", "any", 0.12),
        ("paper-simulation", "even", 0.07),
    ],
)
def test_sigma_is_what_the_noise_of_all_pixels_adds_up_to(exact, preset: str, kind: str, off: float) -> None:
    """Weights by columns, and noise beside that of the columns (in the closed form); or drawn noise (any)."""
    scene, truth, seen = exact(preset, "flat", SIZE, SIZE)
    sigma = NOISE * uneven(kind)
    seen = replace(seen, sigma_u=sigma, sigma_v=sigma)
    height, found = scatter(seen, scene, PixelAnchor(12, 12, float(truth.z[12, 12])))
    assert height.good.all()
    found[12, 12] = np.nan  # known
    ratio = height.sigma / found
    inside = ratio[3:-3, 3:-3]
    assert rms_score(inside) == pytest.approx(1.0, abs=off)
    assert np.nanmin(ratio) > 0.8
