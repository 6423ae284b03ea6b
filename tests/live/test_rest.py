"""A rig that creeps and a load at the mirror's edge, measured in one frame, come off; what cannot be told
apart from them is named and in total_sigma; tare at rest."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lab.live.world import BALL, GAUSS, expose
from optolever.live import Live, Prepared, Reading

from .conftest import LAYER, NOISE, Rest, Shot

MOVED, ROLLED = "The picture has moved as a whole", "The camera has rolled"
PRESSES = {
    "rest": (),
    "smooth": ((GAUSS, 30.0, 22.5, 6.0, 0.1),),
    "ball": ((BALL, 30.0, 22.0, 4.0, 0.06),),
    "two balls": ((BALL, 20.0, 15.0, 4.0, 0.06), (BALL, 42.0, 32.0, 3.0, 0.04)),
}


def _read(rest: Rest, prepared: Prepared, dents: Any, **moved: Any) -> tuple[Reading, Any]:
    """A frame on a half-space of a camera that moved; errors of its heights."""
    world = replace(rest.world.moved(**moved), fading=False)
    frame = expose(world.lights(dents, rest.fringe, 3)[0], np.random.default_rng(3), NOISE)
    reading = Live(prepared).update(frame)
    true = world.truth(dents)[2].reshape(120, 2, 160, 2).mean((1, 3))
    return reading, (reading.z - true)[reading.good]


def _named(reading: Reading, name: str) -> list[float]:
    return [one.size for one in reading.notices if one.name.startswith(name)]


@pytest.mark.parametrize("press", PRESSES)
@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.05, 0.0), (-0.3, 0.0), (0.0, 0.1)])
def test_creep_and_load_come_off_and_only_creep_is_named(
    rest: Rest, prepared: Prepared, press: str, shift: tuple[float, float]
) -> None:
    """A load of 60 um pulls the picture at the edge as .1 px of creep does: they do not cancel."""
    reading, error = _read(rest, prepared, PRESSES[press], along=shift[0], down=shift[1])
    assert reading.trusted, reading.reason
    ratio = error / reading.sigma[reading.good]
    flat = reading.good & (np.abs(reading.z) < 0.005)
    assert (0.25 if press == "smooth" else 0.5) < np.sqrt(np.mean(np.square(ratio))) < 2
    assert abs(np.mean(error[flat[reading.good]])) < 5e-4
    assert reading.figures.shift == pytest.approx(shift, abs=5 * reading.figures.shift_sigma)
    assert reading.figures.shift_sigma < 0.004
    named = _named(reading, MOVED)
    assert named == (pytest.approx([math.hypot(*shift)], abs=0.01) if any(shift) else [])
    assert not _named(reading, ROLLED)
    assert len(reading.touches) == len(PRESSES[press])
    assert reading.tareable == (not PRESSES[press])


def test_a_dent_as_wide_as_the_mirror_is_one_contact(prepared: Prepared, shot: Shot) -> None:
    """Its flank ends at the edge, unlike any load's: cells that do not fit weigh less."""
    exact = replace(prepared, error=0.0)  # of the rig's numbers, which are the truth's here
    (touch,) = Live(exact).update(shot(((GAUSS, 33.9, 27.4, 8.8, 0.346),))).touches
    assert abs(touch.depth - 0.346) < 3 * touch.depth_sigma < 0.15 * 0.346


def test_depth_and_force_of_a_small_ball_on_a_half_space(rest: Rest, prepared: Prepared) -> None:
    """The edge sinks by 2 um with it."""
    radius, depth = 3.0, 0.036
    exact = replace(prepared, error=0.0)  # of the rig's numbers, which are the truth's here
    reading, _ = _read(rest, exact, ((BALL, 30.0, 22.0, radius, depth),))
    (touch,), (force,) = reading.touches, reading.forces
    assert abs(touch.depth - depth) < 3 * touch.depth_sigma < 0.15 * depth
    assert touch.depth == pytest.approx(depth, rel=0.03)  # the window spans twice what it does at 480 x 640
    newton = 4 / 3 * LAYER.plane_modulus * radius * depth
    assert abs(force.newton - newton) < 3 * force.sigma < 0.15 * newton


@pytest.mark.parametrize("sunk", [0.0005, -0.002, 0.005])
def test_a_mirror_that_sinks_is_named_and_in_total_sigma(rest: Rest, prepared: Prepared, sunk: float) -> None:
    """Its picture is that of a camera that moved: heights are of that, total_sigma of both."""
    level = ((GAUSS, 30.0, 22.0, 3000.0, -sunk),)
    for dents in ((), PRESSES["ball"]):
        reading, error = _read(rest, prepared, (*dents, *level))
        (size,) = _named(reading, MOVED)
        assert reading.figures.sinking == pytest.approx(sunk, abs=3e-4)
        assert size == pytest.approx(abs(sunk) / 0.0844, abs=0.004)
        ratio = error / reading.total_sigma[reading.good]
        assert np.abs(ratio).max() < 5
        assert np.mean(error) == pytest.approx(sunk, abs=4e-4)


def test_the_edge_counts_as_still_within_its_accuracy(rest: Rest, prepared: Prepared) -> None:
    reading, _ = _read(rest, prepared, ())
    by_rig = np.square((prepared.error or 0.0) * reading.z)
    more = np.sqrt(np.square(reading.total_sigma) - np.square(reading.sigma) - by_rig)[reading.good]
    assert more == pytest.approx(rest.scene.accuracy.edge, rel=1e-3)


@pytest.mark.parametrize("roll", [0.02, -0.05, 0.2])
def test_a_camera_that_rolls_is_named_and_may_be_tared(rest: Rest, prepared: Prepared, roll: float) -> None:
    for press in ("rest", "ball"):
        reading, error = _read(rest, prepared, PRESSES[press], roll=math.radians(roll))
        assert _named(reading, ROLLED) == pytest.approx([abs(roll)], abs=1e-3)
        assert reading.trusted == (abs(roll) < 0.1)
        assert ("rolled" in reading.reason) == (not reading.trusted)
        assert reading.tareable == (press == "rest")
        if reading.trusted:
            assert np.abs(error / reading.total_sigma[reading.good]).max() < 5


@pytest.mark.parametrize("shift", [(0.6, 0.3), (0.0, 1.0), (2.0, 0.0)])
def test_a_rig_that_moved_far_is_not_trusted_and_may_be_tared(
    rest: Rest, prepared: Prepared, shift: tuple[float, float]
) -> None:
    reading, _ = _read(rest, prepared, (), along=shift[0], down=shift[1])
    assert (reading.trusted, reading.tareable) == (False, True)
    assert "moved as a whole" in reading.reason
    assert not _read(rest, prepared, PRESSES["ball"], along=shift[0], down=shift[1])[0].tareable
