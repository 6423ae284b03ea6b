"""Where the pattern meets the mirror there is no normal: its pixels are flagged first, the rest is solved."""

from dataclasses import replace

import numpy as np
import pytest

from optolever.reconstruct import HeightFlag, PixelAnchor, PointAnchor, exact_correspondence, reconstruct
from optolever.scene import dent_from_text, load, resize, trace


@pytest.mark.parametrize("dent", ["flat", "gaussian:peak=0.3,sigma=4"])
@pytest.mark.parametrize("noise", [0.02, 0.0])
def test_a_pattern_that_touches_the_mirror_costs_its_pixels_alone(noisy, dent: str, noise: float) -> None:
    """The pattern's plane meets the resting mirror in the middle of pixels of one column, just beside it."""
    base = resize(load("prism48", exact=True), 48, 64)
    shift = trace(base, dent_from_text("flat", base)).x[24, 57] - 0.002
    scene = replace(base, pattern=replace(base.pattern, origin=base.pattern.origin + np.array([shift, 0, 0])))
    truth = trace(scene, dent_from_text(dent, scene))
    height = reconstruct(noisy(truth, noise=noise), scene, anchor=PixelAnchor(24, 30, float(truth.z[24, 30])))
    touching = truth.visible & (truth.x < shift + 0.01)
    assert touching.any()
    assert np.all(height.flags[touching] == HeightFlag.SINGULAR)
    assert np.isnan(height.z[touching]).all()
    good = height.good
    assert good.sum() > 0.95 * truth.visible.sum()
    error = np.abs(height.z - truth.z)[good]
    assert np.all(error < 5 * height.sigma[good] + 1e-9 * scene.mirror.length)


def test_a_sigma_as_large_as_the_mirror_is_no_measurement() -> None:
    """Of a mirror 60 mm long, by an anchor that is known to 1 or to 30 mm."""
    scene = resize(load("prism48", exact=True), 24, 32)
    seen = exact_correspondence(trace(scene, dent_from_text("flat", scene)))
    for sigma, flagged in ((1.0, False), (30.0, True)):
        height = reconstruct(seen, scene, anchor=PointAnchor(45, 22, 0, sigma=sigma))
        farther = height.sigma > 15
        assert farther.any() == flagged
        assert np.array_equal((height.flags & HeightFlag.SINGULAR) > 0, farther)
