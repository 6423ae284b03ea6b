"""Contacts make the mirror's edge sink, which counts as at rest: that is in the total sigma, by its name."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lab.live.world import BALL, world_of
from optolever.decode import Correspondence
from optolever.reconstruct import TOTAL, budget, reconstruct
from optolever.scene import Layer, Scene, load, resize

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
    ratio = float(np.sqrt(np.mean(np.square((error / height.total_sigma)[good]))))
    assert ratio < 1.3
    assert ratio > 0.7 or not exact  # a typed rig has more errors than this one
    assert np.sqrt(np.mean(np.square((error / height.sigma)[good]))) > 10  # without it
    parts = budget(height)["height (deepest)"]
    assert 0 < parts["anchor_load"] < parts[TOTAL]
    lone = reconstruct(rest, scene, rest=_seen(scene, (), 0.003, 3)[0])
    assert "anchor_load" not in lone.sources
    thin = reconstruct(seen, replace(scene, layer=Layer(0.2, 0.5, thickness_mm=8.0)), rest=rest)
    assert budget(thin)["height (deepest)"]["anchor_load"] == pytest.approx(
        0.25 * parts["anchor_load"], rel=0.02
    )
