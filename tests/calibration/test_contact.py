"""The contact of a ball: found in traced captures, against where the ball was put."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from numpy.typing import NDArray

from lab.calibration.rigs import Rig, ball_cap, correspondence_of, prism, shape_surface
from optolever import InputError
from optolever.calibration import Observation, calibrate, contact
from optolever.decode import Correspondence
from optolever.scene import trace

Floats = NDArray[np.float64]
Height = Callable[[Floats, Floats], Floats]


def hertz(under: Height, x0: float, y0: float, depth: float, radius: float) -> Height:
    """A ball on an elastic half-space: a parabola, depth a^2 / R; K. L. Johnson, Contact Mechanics, 3.42a."""
    a = np.sqrt(radius * depth)

    def height(x: Floats, y: Floats) -> Floats:
        square = (x - x0) ** 2 + (y - y0) ** 2
        inside = np.real(square) < a * a
        r = np.sqrt(np.where(inside, a * a * (1 + 1e-9), square))
        beside = ((2 * a * a - r * r) * np.arcsin(a / r) + a * np.sqrt(r * r - a * a)) / (np.pi * radius)
        total: Floats = under(x, y) + np.where(inside, depth - square / (2 * radius), beside)
        return total

    return height


def pressed(rig: Rig, shape, ball, take) -> tuple[Correspondence, NDArray[np.bool_]]:  # type: ignore[no-untyped-def]
    """Capture of a ball (radius, depth, x, y), and the pixels that see its contact."""
    radius, depth, x, y = ball
    surface = shape_surface(shape(rig.rest.height, x, y, depth, radius))
    seen = trace(rig.truth, surface)
    with np.errstate(invalid="ignore"):
        inside = np.hypot(seen.x - x, seen.y - y) < np.sqrt(radius * depth)
    return take(rig.truth, surface, 1), np.asarray(inside)


@lru_cache
def drawn(seed: int, noise: float = 0.005, pinhole: bool = False, size: int = 250):  # type: ignore[no-untyped-def]
    """A rig with a capture at rest, a ball of 25 to 40 mm somewhere on it, and what takes captures."""
    rng = np.random.default_rng([7, seed])
    take = correspondence_of(noise, rng)
    rig = prism(rng, 0, take, pinhole, size)
    mirror = rig.truth.mirror
    place = mirror.length * rng.uniform(0.2, 0.8), mirror.width * rng.uniform(0.1, 0.9)
    return rig, (rng.uniform(25, 40), rng.uniform(0.15, 0.3), *place), take


def require_inside(found: NDArray[np.bool_], true: NDArray[np.bool_], good: NDArray[np.bool_]) -> None:
    assert np.count_nonzero(found & ~true) <= 0.02 * np.count_nonzero(found)
    assert np.count_nonzero(found) >= 0.5 * np.count_nonzero(true & good)


@pytest.mark.parametrize("shape", [ball_cap, hertz])
@pytest.mark.parametrize(
    ("seed", "noise", "pinhole"),
    [(0, 0.005, False), (1, 0.005, True), (2, 0.05, False)]
    + [pytest.param(seed, 0.005, seed % 2 == 1, marks=pytest.mark.slow) for seed in range(3, 9)],
)
def test_drawn_balls(shape, seed: int, noise: float, pinhole: bool) -> None:  # type: ignore[no-untyped-def]
    rig, ball, take = drawn(seed, noise, pinhole)
    c, true = pressed(rig, shape, ball, take)
    require_inside(contact(c, rig.observations[0].correspondence), true, c.good)


@pytest.mark.parametrize(
    ("x", "y"), [(0.02, 0.5), (0.05, 0.5), (0.1, 0.5), (0.97, 0.5), (0.5, 0.01), (0.9, 0.95)]
)
def test_balls_at_the_border(x: float, y: float) -> None:
    rig, ball, take = drawn(0)
    place = x * rig.truth.mirror.length, y * rig.truth.mirror.width
    c, true = pressed(rig, ball_cap, (*ball[:2], *place), take)
    require_inside(contact(c, rig.observations[0].correspondence), true, c.good)


def without_masks(rig: Rig) -> list[Observation]:
    return [replace(each, mask=None) for each in rig.observations]


@pytest.mark.slow  # two adjustments
def test_calibration_with_what_is_found_is_as_with_the_true_contact() -> None:
    rng = np.random.default_rng(8)
    rig = prism(rng, 1, correspondence_of(0.005, rng), size=200)
    found = calibrate(rig.given, without_masks(rig))
    true = calibrate(rig.given, rig.observations)
    for one, other in zip(found.parameters, true.parameters, strict=True):
        assert abs(one["value"] - other["value"]) < 3 * other["sigma"]
        assert one["sigma"] < 1.3 * other["sigma"]
    assert found.adjustment.chi < 1.1


@pytest.mark.parametrize("shape", ["none", "cylinder"])
def test_no_contact_is_one_line_that_asks_for_a_mask(shape: str) -> None:
    rng = np.random.default_rng(8)
    rig = prism(rng, 1, correspondence_of(0.005, rng), size=100)
    under = rig.rest.height

    def roll(x: Floats, y: Floats) -> Floats:
        total: Floats = under(x, y) + 0.2 * np.exp(-((x - 30.0) ** 2) / 50.0)
        return total

    surface = rig.rest if shape == "none" else shape_surface(roll)
    c = correspondence_of(0.005, rng)(rig.truth, surface, 1)
    rest, ball = without_masks(rig)
    with pytest.raises(InputError, match=r"'ball0': beside 'rest' \d+ pixels .*@MASK\.png"):
        calibrate(rig.given, [rest, replace(ball, correspondence=c)])
