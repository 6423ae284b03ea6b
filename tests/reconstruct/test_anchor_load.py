"""Contacts make the mirror's edge sink, which counts as at rest: it is measured and taken off."""

from typing import Any

import numpy as np
import pytest

from lab.live.world import BALL
from optolever.reconstruct import budget, reconstruct
from optolever.scene import load, resize

from .conftest import pressed_half_space

SAG = "sag under the load, motion since rest"
ONE = ((BALL, 30.0, 22.0, 4.0, 0.05),)
TWO = ((BALL, 22.0, 15.0, 3.0, 0.05), (BALL, 38.0, 30.0, 4.0, 0.04))


@pytest.mark.parametrize("exact", [True, False])
@pytest.mark.parametrize("dents", [ONE, TWO], ids=["one", "two"])
def test_balls_on_a_half_space(dents: Any, exact: bool) -> None:
    scene = resize(load("prism48", exact=exact), 120, 160)
    rest, _ = pressed_half_space(scene, (), 0.003, 1)
    seen, true = pressed_half_space(scene, dents, 0.03, 2)
    height = reconstruct(seen, scene, rest=rest)
    good, error = height.good, height.z - true
    assert 0.3 < float(np.sqrt(np.mean(np.square((error / height.total_sigma)[good])))) < 1.3
    assert np.sqrt(np.mean(np.square((error / height.sigma)[good]))) < 2.5  # above 10 with it
    assert budget(height)["height (deepest)"][SAG] > 0
