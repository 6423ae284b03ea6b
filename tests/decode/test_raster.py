"""A spot at a raster of places, decoded to both coordinates."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.decode import Flag, Response, decode
from optolever.experiments.ideal import camera_frames, ideal_level
from optolever.experiments.metrics import rms
from optolever.patterns import Sequence, sequence
from optolever.projector import capture
from optolever.scene import dent, load, resize, trace

from .conftest import F64, Map, scores
from .light import camera


def spots(shown: Sequence, u: F64, v: F64, noise: float, seed: int = 0, bright: float = 190) -> NDArray[Any]:
    """Spots `bright` above 12 levels."""
    levels = (12 + bright / 2, bright / 2)
    return camera_frames(shown, (u, v), levels, noise, np.random.default_rng(seed))


@pytest.fixture(scope="module")
def places() -> Map:
    row, col = np.mgrid[:60, :70].astype(np.float64)
    return 3 + 0.97 * col + 3 * np.sin(row / 21), 4 + 0.93 * row + 3 * np.cos(col / 17)


@pytest.mark.daily(1)
@pytest.mark.parametrize("params", [{"step": 8}, {"step": 6, "width": 9}, {"step": 5, "width": 15}])
def test_spot_has_true_error_bars(places: Map, params: dict[str, float]) -> None:
    shown = sequence("spot", 66, 78, **params)
    found = [decode(spots(shown, *places, 3.0, seed=seed), shown) for seed in range(3)]
    assert min(each.good.mean() for each in found) > 0.999
    score = np.abs(np.concatenate([scores(each, *places) for each in found]))
    assert np.mean(score < 1) == pytest.approx(0.683, abs=0.02)
    assert np.mean(score < 2) == pytest.approx(0.954, abs=0.01)


def test_response_is_inverted_before_sums(places: Map) -> None:
    shown = sequence("spot", 66, 78)
    light = np.array([ideal_level(shown, i, *places) for i in range(len(shown))])
    frames = camera(255 * (0.1 + 0.8 * light) ** (1 / 2.2), 1.0, 2)
    inverse = Response.from_gamma(1 / 2.2)
    bent, straight = decode(frames, shown), decode(frames, shown, response=inverse)
    error = [np.sqrt(np.mean((found.u - places[0]) ** 2)) for found in (bent, straight)]
    assert straight.good.mean() > 0.99
    assert error[1] < 0.5 * error[0]
    assert rms(scores(straight, *places)) == pytest.approx(1, abs=0.2)


def test_two_places_in_one_pixel_are_flagged(places: Map) -> None:
    """A fold, or a ghost: the second place in other rows and columns of the raster."""
    shown = sequence("spot", 66, 78)
    u, v = np.full((9, 9), 12.0), np.full((9, 9), 15.0)
    both = 0.5 * spots(shown, u, v, 0) + 0.5 * spots(shown, u + 45, v + 40, 0)
    found = decode(np.rint(both).astype(np.uint8), shown)
    assert (found.flags & Flag.ORDER_DOUBTFUL).all()


def test_virtual_sensor() -> None:
    """End to end: what the simulated camera sees of spots is where its rays meet the pattern."""
    scene = resize(load("paper-simulation", exact=True), 32, 32)
    surface = dent("tilt", scene)
    shown = sequence("spot", scene.pattern.rows, scene.pattern.cols, step=3)
    found = decode(capture(scene, surface, shown, renderer="numpy", noise=1.0).frames, shown)
    truth = trace(scene, surface)
    inside = (np.abs(truth.u - (shown.cols - 1) / 2) < shown.cols / 2 - 2) & (
        np.abs(truth.v - (shown.rows - 1) / 2) < shown.rows / 2 - 2
    )
    assert inside.sum() > 500
    assert found.good[inside].mean() > 0.99
    score = scores(found, truth.u, truth.v)
    assert rms(score) < 1.1
    assert np.abs(score).max() < 5
