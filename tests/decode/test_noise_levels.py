"""Photon noise: error over sigma of places is near one, and a window of a capture gives the same places."""

import dataclasses

import numpy as np
import pytest

from optolever.decode import decode
from optolever.patterns import sequence
from optolever.projector import capture
from optolever.scene import Sensor, dent, load, resize, trace


@pytest.fixture(scope="module", params=["gray+phase", "phase"])
def taken(request: pytest.FixtureRequest) -> tuple:
    """Frames of prism48 with 20 electrons a level, sequence, truth."""
    rig = resize(load("prism48", exact=True), 120, 160)
    rig = dataclasses.replace(rig, sensor=Sensor(noise=1.0, gain_e=20.0, exposure=0.8, offset=6.0))
    surface = dent("gaussian", rig, peak=0.2, sigma=8.0)
    shown = sequence(request.param, rig.pattern.rows, rig.pattern.cols)
    return capture(rig, surface, shown, noise=1.0, seed=3).frames, shown, trace(rig, surface)


def test_sigma_is_the_error(taken: tuple) -> None:
    frames, shown, truth = taken
    found = decode(frames, shown)
    good = found.good & truth.visible
    ratio = np.concatenate(
        [((found.u - truth.u) / found.sigma_u)[good], ((found.v - truth.v) / found.sigma_v)[good]]
    )
    assert good.sum() > 0.95 * truth.visible.sum()
    assert 0.8 < np.sqrt(np.mean(ratio**2)) < 1.15
    assert np.mean(np.abs(ratio) > 5) < 1e-3


def test_a_window_gives_the_same_places(taken: tuple) -> None:
    frames, shown, _ = taken
    whole = decode(frames, shown, noise=1.0, gain=0.05)
    part = decode(np.ascontiguousarray(frames[:, 20:110, 30:120]), shown, noise=1.0, gain=0.05)
    inner, same = slice(5, -5), (slice(25, 105), slice(35, 115))
    assert np.array_equal(whole.flags[same], part.flags[inner, inner])
    good = whole.good[same]
    assert np.array_equal(whole.u[same][good], part.u[inner, inner][good])
