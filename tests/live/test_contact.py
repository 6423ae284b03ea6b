"""Contacts over time, and forces of rendered balls against Hertz."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lab.live.streams import Moment, StreamRig
from lab.live.world import BALL, PUNCH, expose, photons
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


@pytest.mark.parametrize(("radius", "depth", "share"), [(3.0, 0.03, 0.8), (4.0, 0.05, 1.0), (6.0, 0.05, 0.9)])
def test_a_dark_contact_is_a_contact_with_a_hole(
    stream: StreamRig, prepared: Prepared, radius: float, depth: float, share: float
) -> None:
    """An object that wets the silicone ends total reflection where it touches: the cells around are right."""
    moment = Moment(((BALL, 30.0, 22.0, radius, depth),), False, dark=share * radius)
    light, true = stream.shown(moment)
    reading = Live(prepared).update(photons(light, np.random.default_rng(5)))
    assert reading.trusted, reading.reason
    error = (reading.z - true)[reading.good]
    ratio = error / reading.sigma[reading.good]
    assert error.std() < 6e-4
    assert np.sqrt(np.mean(np.square(ratio))) < 1.5
    assert not reading.good[np.unravel_index(true.argmax(), true.shape)]
    (touch,) = reading.touches
    assert touch.hole
    assert math.dist((touch.x, touch.y), (30, 22)) < min(4 * touch.position_sigma, 1.0)
    assert abs(touch.depth - depth) < 3 * touch.depth_sigma


@pytest.mark.parametrize(("radius", "depth"), [(0.7, 0.012), (1.0, 0.012), (1.0, 0.02), (1.5, 0.025)])
def test_what_is_narrower_than_the_window_says_at_least(
    stream: StreamRig, prepared: Prepared, radius: float, depth: float
) -> None:
    """The depth was that of a cell of the flank, 8 to 20 sigma too shallow."""
    light, true = stream.shown(Moment(((BALL, 30.0, 22.0, radius, depth),), False))
    reading = Live(prepared).update(photons(light, np.random.default_rng(5)))
    (touch,) = reading.touches
    assert touch.hole or touch.depth_sigma > 0.3 * touch.depth
    assert abs(touch.depth - true.max()) < 3 * touch.depth_sigma
    assert reading.z[touch.row, touch.col] <= reading.depth < true.max()


@pytest.mark.parametrize(("radius", "depth"), [(3.0, 0.02), (4.0, 0.03), (6.0, 0.03)])
def test_a_sharp_rim_is_in_the_sigma_of_what_it_encloses(
    stream: StreamRig, prepared: Prepared, radius: float, depth: float
) -> None:
    """The window loses slope at the rim: the plateau, 6 to 16 % too shallow, was 3 to 9 sigma off."""
    light, true = stream.shown(Moment(((PUNCH, 30.0, 22.0, radius, depth),), False))
    reading = Live(prepared).update(photons(light, np.random.default_rng(5)))
    inside = np.hypot(reading.x - 30, reading.y - 22) < 0.7 * radius
    ratio = ((reading.z - true) / reading.sigma)[inside]
    assert 0.3 < np.sqrt(np.mean(np.square(ratio))) < 2
    (touch,) = reading.touches
    assert 0.3 < abs(touch.depth - depth) / touch.depth_sigma < 2
    assert touch.depth_sigma < 0.25 * depth
