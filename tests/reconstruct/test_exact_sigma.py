"""Sigma against what single pixels do to the height, added up; at creases, against the truth."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.decode import Correspondence
from optolever.reconstruct import HeightMap, PixelAnchor, reconstruct
from optolever.scene import Scene, Surface, load, resize, trace

from .conftest import correspondence_of, rms_score, scores

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


def roof(scene: Scene, crease: float) -> Surface:
    """Level but for a crease along the rows, where the slope by y changes by 0.02."""

    def height(x: Floats, y: Floats) -> Floats:
        return -0.01 * np.abs(y - crease) + 0 * x

    def gradient(x: Floats, y: Floats) -> tuple[Floats, Floats]:
        return 0 * (x + y), -0.01 * np.sign(y - crease) + 0 * x

    return Surface(height, gradient)


@pytest.mark.daily(1)
def test_a_crease_between_pixels_is_in_sigma() -> None:
    """Wherever it lies between two rows: all of the far side is off by the slopes' jump times the way from
    the middle, which is evenly drawn. Without noise."""
    scene = resize(load("paper-simulation", exact=True), 40, 48)
    pitch = scene.mirror.width / 40
    off = []
    for share in (0.1, 0.3, 0.5, 0.7, 0.9):
        crease = (20 + share) * pitch
        truth = trace(scene, roof(scene, crease))
        seen = correspondence_of(truth, 1e-3)
        height = reconstruct(seen, scene, anchor=PixelAnchor(32, 24, float(truth.z[32, 24])))
        off.append(scores(height, truth)[truth.y < crease - 2 * pitch])
    far = np.concatenate(off)
    assert np.isfinite(far).mean() > 0.9
    assert rms_score(np.nan_to_num(far)) < 1.0
