"""Contacts make the mirror's edge sink, which counts as at rest: it is measured and taken off."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lab.live.world import BALL, world_of
from optolever.decode import Correspondence
from optolever.reconstruct import budget, reconstruct
from optolever.scene import Scene, load, resize

SAG = "sag under the load, motion since rest"
ONE = ((BALL, 30.0, 22.0, 4.0, 0.05),)
TWO = ((BALL, 22.0, 15.0, 3.0, 0.05), (BALL, 38.0, 30.0, 4.0, 0.04))


def _seen(scene: Scene, dents: Any, noise: float, seed: int) -> tuple[Correspondence, Any]:
    """Of an exact half-space, with its true height."""
    u, v, z, _, _ = replace(world_of(scene), fading=False).truth(dents)
    rng, sigma, level = np.random.default_rng(seed), np.full(u.shape, noise), np.full(u.shape, 100.0)
    off = (u < 0) | (u > scene.pattern.cols - 1) | (v < 0) | (v > scene.pattern.rows - 1)
    u, v = (part + noise * rng.standard_normal(u.shape) for part in (u, v))
    return Correspondence(u, v, sigma, sigma.copy(), off.astype(np.uint16), level, level.copy()), z


@pytest.mark.parametrize("exact", [True, False])
@pytest.mark.parametrize("dents", [ONE, TWO], ids=["one", "two"])
def test_balls_on_a_half_space(dents: Any, exact: bool) -> None:
    scene = resize(load("prism48", exact=exact), 120, 160)
    rest, _ = _seen(scene, (), 0.003, 1)
    seen, true = _seen(scene, dents, 0.03, 2)
    height = reconstruct(seen, scene, rest=rest)
    good, error = height.good, height.z - true
    assert 0.3 < float(np.sqrt(np.mean(np.square((error / height.total_sigma)[good])))) < 1.3
    assert np.sqrt(np.mean(np.square((error / height.sigma)[good]))) < 2.5  # above 10 with it
    assert budget(height)["height (deepest)"][SAG] > 0
