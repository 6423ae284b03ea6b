"""A rig that creeps, and a load that pulls at the edge, are in sigma and named; tare at rest."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lab.live.world import BALL, GAUSS, expose
from optolever.live import Live, Prepared

from .conftest import LAYER, NOISE, Rest

PRESSED = ((GAUSS, 30.0, 22.5, 6.0, 0.1),)
Truth = Callable[[Any], Any]
MOVED = "The rig has moved"


@pytest.mark.parametrize("dents", [(), PRESSED], ids=["rest", "pressed"])
@pytest.mark.parametrize("shift", [(0.05, 0.0), (-0.1, 0.0), (0.2, 0.0), (0.0, 0.05), (0.1, -0.1)])
def test_a_camera_that_creeps(
    rest: Rest, prepared: Prepared, truth: Truth, dents: Any, shift: tuple[float, float]
) -> None:
    """Trusted, within five sigma; at rest the notice has the shift, sigma is that of the error."""
    light = rest.world.moved(*shift).lights(dents, rest.fringe, 3)[0]
    reading = Live(prepared).update(expose(light, np.random.default_rng(3), NOISE))
    ratio = ((reading.z - truth(dents)) / reading.sigma)[reading.good]
    assert reading.trusted, reading.reason
    assert np.abs(ratio).max() < 5
    assert reading.tareable == (not dents)
    if not dents:
        assert 0.7 < np.sqrt(np.mean(np.square(ratio))) < 1.4
        assert reading.touches == ()
        (notice,) = (one for one in reading.notices if one.name.startswith(MOVED))
        assert notice.size == pytest.approx(math.hypot(*shift), abs=0.01)


def test_a_rig_that_moved_far_is_not_trusted_and_may_be_tared(rest: Rest, prepared: Prepared) -> None:
    light = rest.world.moved(0.6, 0.3).lights((), rest.fringe, 3)[0]
    reading = Live(prepared).update(expose(light, np.random.default_rng(3), NOISE))
    assert (reading.trusted, reading.tareable) == (False, True)
    assert "edge has moved" in reading.reason


@pytest.mark.parametrize(("x", "radius", "depth"), [(30.0, 4.0, 0.05), (20.0, 3.0, 0.05), (30.0, 6.0, 0.1)])
def test_a_ball_on_a_half_space_pulls_at_the_edge(
    rest: Rest, prepared: Prepared, x: float, radius: float, depth: float
) -> None:
    """The edge sinks too: all is too small, within two sigma; it is no motion of the rig."""
    world, dents = replace(rest.world, fading=False), ((BALL, x, 22.0, radius, depth),)
    true = world.truth(dents)[2].reshape(120, 2, 160, 2).mean((1, 3))
    frame = expose(world.lights(dents, rest.fringe, 3)[0], np.random.default_rng(4), NOISE)
    reading = Live(prepared).update(frame)
    assert reading.trusted, reading.reason
    assert not [one for one in reading.notices if one.name.startswith(MOVED)]
    ratio = ((reading.z - true) / reading.sigma)[reading.good]
    assert np.abs(ratio).max() < 2
    assert np.sqrt(np.mean(np.square(ratio))) > 0.3
    (touch,), (force,) = reading.touches, reading.forces
    assert abs(touch.depth - depth) < 2 * touch.depth_sigma < 0.3 * depth
    newton = 4 / 3 * LAYER.plane_modulus * radius * depth
    assert abs(force.newton - newton) < 2 * force.sigma < 0.6 * newton
    assert not reading.tareable
