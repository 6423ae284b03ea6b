"""Contacts over time, and forces against closed forms of contact mechanics."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lab.live.world import BALL
from optolever.live import Forces, Live, Prepared, Reading, Shape, Touches
from optolever.scene import Layer

from .conftest import LAYER

Shot = Callable[..., Any]
Place = tuple[float, float]


@pytest.fixture(scope="session")
def quiet(prepared: Prepared, shot: Shot) -> Reading:
    """A reading at rest, whose height tests replace."""
    return Live(prepared).update(shot())


def _hertz(reading: Reading, at: Place, radius: float, depth: float) -> Any:
    """Height around a ball's contact (K. L. Johnson, Contact Mechanics, 1985, eq. 3.41, 3.42)."""
    q = np.hypot(reading.x - at[0], reading.y - at[1]) / radius
    out = np.maximum(q, 1.0)
    beyond = ((2 - out**2) * np.arcsin(1 / out) + np.sqrt(out**2 - 1)) / math.pi
    return (depth * np.where(q <= 1, 1 - 0.5 * q**2, beyond)).astype(np.float32)


def test_a_sphere_a_cylinder_and_an_oblique_punch(prepared: Prepared, quiet: Reading) -> None:
    """Exact heights: radii within 0.5 %, the cylinder's axis within 0.01 rad, the punch's tilt."""
    x, y = quiet.x.astype(np.float64) - 30, quiet.y.astype(np.float64) - 22
    across = x * math.sin(0.5) - y * math.cos(0.5)
    sphere = 0.05 - 100 + np.sqrt(100**2 - x**2 - y**2)
    punch = np.where(np.hypot(x, y) < 4, 0.05 + 0.002 * x - 0.001 * y, 0.0)

    def shape(z: Any) -> Shape:
        touch = Touches(prepared).update(replace(quiet, z=np.maximum(z, 0).astype(np.float32)))[0]
        assert touch.shape is not None
        return touch.shape

    ball = shape(sphere)
    assert ball.radii == pytest.approx((100, 100), rel=0.005)
    assert np.hypot(*ball.tilt) < 5 * ball.tilt_sigma
    cylinder = shape(0.05 - 100 + np.sqrt(100**2 - across**2))
    assert cylinder.radii[0] == pytest.approx(100, rel=0.005)
    assert cylinder.radii[1] is None
    assert math.remainder(cylinder.axis - 0.5, math.pi) == pytest.approx(0, abs=0.01)
    flat = shape(punch)
    assert flat.tilt == pytest.approx((0.002, -0.001), abs=1e-5)
    assert flat.radii == (None, None)


def test_the_force_of_a_ball_is_that_of_hertz(prepared: Prepared, quiet: Reading) -> None:
    """F = 4/3 E* a d, p0 = 3 F / (2 pi a^2); the area is that of the contact."""
    radius, depth, at = 4.0, 0.08, (30.0, 22.0)
    reading = replace(quiet, z=_hertz(quiet, at, radius, depth))
    (touch,) = Touches(prepared).update(reading)
    (force,) = Forces(prepared, LAYER).update(reading, (touch,))
    newton = 4 / 3 * LAYER.plane_modulus * radius * depth
    assert force.newton == pytest.approx(newton, rel=0.05)
    assert force.peak == pytest.approx(1.5 * newton / (math.pi * radius**2), rel=0.05)
    assert 0 < force.sigma < 0.05 * newton
    (typed,) = Forces(prepared, Layer(0.2, 0.5)).update(reading, (touch,))
    assert typed.sigma == pytest.approx(0.1 * newton, rel=0.1)
    assert math.dist((touch.x, touch.y), at) < 0.05
    assert touch.depth == pytest.approx(depth, rel=0.01)
    assert touch.area == pytest.approx(math.pi * radius**2, rel=0.03)


def test_the_force_on_a_thin_and_on_a_thick_layer(prepared: Prepared, quiet: Reading) -> None:
    """Thin, compressible and bonded it is a Winkler foundation (Johnson, ch. 5.8): F = pi K R d^2,
    K = E (1 - nu) / ((1 + nu) (1 - 2 nu) h); thick it is a half-space."""
    radius, depth = 400.0, 0.02
    r = np.hypot(quiet.x - 30, quiet.y - 22)
    reading = replace(quiet, z=np.maximum(depth - r**2 / (2 * radius), 0).astype(np.float32))
    touches = Touches(prepared).update(reading)
    (thin,) = Forces(prepared, Layer(0.2, 0.3, thickness_mm=0.1)).update(reading, touches)
    stiffness = 0.2 * 0.7 / (1.3 * 0.4 * 0.1)
    assert thin.newton == pytest.approx(math.pi * stiffness * radius * depth**2, rel=0.05)
    reading = replace(quiet, z=_hertz(quiet, (30.0, 22.0), 3.0, 0.05))
    touches = Touches(prepared).update(reading)
    (half,) = Forces(prepared, LAYER).update(reading, touches)
    (thick,) = Forces(prepared, replace(LAYER, thickness_mm=200.0)).update(reading, touches)
    assert thick.newton == pytest.approx(half.newton, rel=0.03)


def test_identities_are_kept_merged_split_and_end(prepared: Prepared, quiet: Reading) -> None:
    """A frame without trust begins no contact and ends none."""
    touches = Touches(prepared)

    def seen(*places: Place, trusted: bool = True) -> Any:
        bumps = (np.exp(-((quiet.x - x) ** 2 + (quiet.y - y) ** 2) / 8) for x, y in places)
        z = 0.05 * sum(bumps, 0 * quiet.z)
        return touches.update(replace(quiet, z=z.astype(np.float32), trusted=trusted))

    first = seen((20, 22), (36, 22))
    names = {round(touch.x): touch.identity for touch in first}
    assert seen((20, 22), (36, 22), trusted=False) == ()
    for step in range(1, 5):
        for touch in seen((20 + step, 22), (36 - step, 22)):
            assert touch.identity == names[20 if touch.x < 28 else 36]
    (merged,) = seen((27.5, 22), (28.5, 22))
    assert merged.identity in names.values()
    assert len(seen((24.8, 22), (31.4, 22))) == 2
    assert seen() == ()
    (new,) = seen((20, 22))
    assert new.identity not in names.values()


@pytest.mark.parametrize(("edge", "depth"), [(4.0, 0.05), (5.0, 0.08)])
def test_a_rolling_ball_is_followed(prepared: Prepared, shot: Shot, edge: float, depth: float) -> None:
    """Rendered frames: one identity, the force of Hertz; R = a^2 / d within 1.5 sigma; no tilt."""
    live, names = Live(prepared), set()
    for k in range(5):
        x, y = 26 + 0.9 * k, 20 + 0.5 * k
        reading = live.update(shot(((BALL, x, y, edge, depth),), k))
        (touch,), (force,) = reading.touches, reading.forces
        names.add(touch.identity)
        assert math.dist((touch.x, touch.y), (x, y)) < 0.05
        assert abs(touch.depth - depth) < 0.02 * depth
        assert force.newton == pytest.approx(4 / 3 * LAYER.plane_modulus * edge * depth, rel=0.05)
        assert touch.shape is not None
        for radius, sigma in zip(touch.shape.radii, touch.shape.radii_sigma, strict=True):
            assert radius == pytest.approx(edge**2 / depth, rel=0.03)
            assert abs(radius - edge**2 / depth) < 1.5 * sigma < 0.15 * radius
        assert np.hypot(*touch.shape.tilt) < 5 * touch.shape.tilt_sigma
    assert len(names) == 1
