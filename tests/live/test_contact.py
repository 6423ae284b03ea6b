"""Contacts over time, and forces of rendered balls against Hertz."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lab.live.world import BALL, expose
from optolever.contact import Contact
from optolever.live import Live, Prepared, Touches

from .conftest import LAYER, NOISE, Rest

Place = tuple[float, float]


def test_identities_are_kept_merged_split_and_end() -> None:
    touches = Touches()

    def seen(*places: Place) -> Any:
        plain = Contact(0, 0, 0.01, 0.05, 1e-4, 1e-4, 3.0, 0.1, 0.1, 0.01, None, None, False, False, 0, 0)
        return touches.named([replace(plain, x=x, y=y) for x, y in places])

    first = seen((20, 22), (36, 22))
    names = {round(touch.x): touch.identity for touch in first}
    for step in range(1, 5):
        for touch in seen((20 + step, 22), (36 - step, 22)):
            assert touch.identity == names[20 if touch.x < 28 else 36]
    (merged,) = seen((27.5, 22))
    assert merged.identity in names.values()
    assert len(seen((24.8, 22), (31.4, 22))) == 2
    assert seen() == ()
    (new,) = seen((20, 22))
    assert new.identity not in names.values()


@pytest.mark.parametrize(("edge", "depth"), [(4.0, 0.064), (5.0, 0.1)])
def test_a_rolling_ball_is_followed(rest: Rest, prepared: Prepared, edge: float, depth: float) -> None:
    """On a half-space: one identity, the force of Hertz, R = a^2 / d."""
    live, names, world = Live(prepared), set(), replace(rest.world, fading=False)
    for k in range(5):
        x, y = 26 + 0.9 * k, 20 + 0.5 * k
        light = world.lights(((BALL, x, y, edge, depth),), rest.fringe, 3)[0]
        reading = live.update(expose(light, np.random.default_rng(k), NOISE))
        (touch,), (force,) = reading.touches, reading.forces
        names.add(touch.identity)
        assert math.dist((touch.x, touch.y), (x, y)) < 0.05
        assert touch.depth == pytest.approx(depth, rel=0.02)
        assert abs(touch.depth - depth) < 5 * touch.depth_sigma < 0.1 * depth
        newton = 4 / 3 * LAYER.plane_modulus * edge * depth
        assert force.newton == pytest.approx(newton, rel=0.02)
        assert abs(force.newton - newton) < 5 * force.sigma < 0.1 * newton
        assert touch.indenter_radius == pytest.approx(edge**2 / depth, rel=0.05)
        assert touch.indenter_radius is not None
        assert touch.indenter_radius_sigma is not None
        assert abs(touch.indenter_radius - edge**2 / depth) < 2 * touch.indenter_radius_sigma
    assert len(names) == 1
