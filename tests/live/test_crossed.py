"""Single-shot displacement against closed-form warps."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from optolever import InputError
from optolever.decode import Flag
from optolever.live import crossed
from optolever.patterns import sequence

F64 = NDArray[np.float64]
SHOWN = sequence("crossed", 300, 300, period=12.0)
ROW, COL = np.mgrid[:200, :240].astype(np.float64)
REST = SimpleNamespace(u=260 - 0.9 * COL + 0.02 * ROW, v=30 + 1.05 * ROW)


def image(u: F64, v: F64, noise: float, seed: int) -> NDArray[np.uint8]:
    light = 63.75 * (2 + np.cos(2 * np.pi * u / 12) + np.cos(2 * np.pi * v / 12))
    noisy = light + noise * np.random.default_rng(seed).standard_normal(u.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("size", [0.0, 3.0, 25.0])
def test_displacement(size: float) -> None:
    """Up to two periods, with its sign; the map at rest falls along columns."""
    bell = size * np.exp(-((COL - 120) ** 2 + (ROW - 100) ** 2) / (2 * 45**2))
    moved = image(REST.u + bell, REST.v - 0.5 * bell, 1.0, 1)
    found = crossed(moved, image(REST.u, REST.v, 1.0, 2), SHOWN, prior=REST)
    inner = np.s_[20:-20, 20:-20]
    assert found.good[inner].mean() > 0.99
    smoothing = 0.06 * size
    assert np.abs(found.du - bell)[inner].max() < 0.1 + smoothing
    assert np.abs(found.dv + 0.5 * bell)[inner].max() < 0.1 + smoothing


def test_what_is_too_steep_is_flagged_not_guessed() -> None:
    """A cusp of 60 px whose flank is steeper than the fringe: no unflagged pixel is off."""
    cusp = 60.0 * np.exp(-np.hypot(COL - 120, ROW - 100) / 12)
    found = crossed(image(REST.u + cusp, REST.v, 1.0, 1), image(REST.u, REST.v, 1.0, 2), SHOWN, prior=REST)
    assert 0.8 < found.good.mean() < 1
    wrong = np.abs(found.du - cusp) > 5 * found.sigma_u
    assert wrong[found.good].mean() < 1e-3
    assert (found.flags[98:103, 118:123] & Flag.ORDER_DOUBTFUL).any()


@pytest.mark.parametrize("middle", [(0, 120), (199, 239), (100, 0)])
def test_at_the_edge_of_the_frame(middle: tuple[int, int]) -> None:
    """A dome of one period whose flanks the frame cuts: told to its sigma everywhere."""
    distance = np.hypot(ROW - middle[0], COL - middle[1])
    dome = 10.0 * np.cos(np.pi * np.minimum(distance, 160) / 160) ** 2 + 0.04 * (COL + ROW - 280)
    rest = image(REST.u, REST.v, 1.0, 2)
    found = crossed(image(REST.u - dome, REST.v + 0.5 * dome, 1.0, 1), rest, SHOWN, prior=REST)
    assert found.good[1:-1, 1:-1].mean() > 0.99
    for moved, sigma, true in ((found.du, found.sigma_u, -dome), (found.dv, found.sigma_v, 0.5 * dome)):
        ratio = ((moved - true) / sigma)[found.good]
        assert (np.abs(ratio) < 5).mean() > 1 - 1e-4
        assert 0.8 < np.sqrt(np.mean(ratio**2)) < 1.2


def test_what_leaves_the_pattern_is_dark_and_does_not_pull() -> None:
    """The frame looks beside the pattern below row 170 once the mirror is pressed."""
    moved = SimpleNamespace(u=REST.u, v=REST.v + 80.0)
    dark = np.where(moved.v < 299.5, image(moved.u, moved.v, 1.0, 1), 0).astype(np.uint8)
    prior = SimpleNamespace(u=REST.u, v=REST.v + 75.0)
    found = crossed(dark, image(prior.u, prior.v, 1.0, 2), SHOWN, prior=prior)
    assert not found.good[moved.v > 301].any()
    error = np.abs(found.dv - 5.0) / found.sigma_v
    assert (error[found.good] < 5).all()
    assert found.good[moved.v < 296].mean() > 0.98


def test_bad_input() -> None:
    for now, words in ((np.zeros((30, 31)), "must be equal"), (np.full((30, 30), np.inf), "finite")):
        with pytest.raises(InputError, match=words):
            crossed(now, np.zeros((30, 30)), SHOWN)


@pytest.mark.parametrize("around", ["dark", "room", "reflection", "lamp"])
def test_a_mirror_that_fills_a_part_of_the_picture(around: str) -> None:
    """Two islands: displaced on their own, right to their borders; all else is flagged."""
    moved = 4.0 * np.exp(-((COL - 60) ** 2 + (ROW - 100) ** 2) / (2 * 30**2)) + np.where(COL > 130, 3.0, 0.0)
    left, right = (np.hypot(COL - middle, ROW - 100) < 45 for middle in (60, 180))
    beside = 60 + 20 * np.sin(ROW / 37) if around == "room" else 0 * COL
    images = []
    for seed, shift in enumerate((moved, 0 * moved)):
        inside = image(REST.u + shift, REST.v - 0.5 * shift, 0.0, 0).astype(float)
        ghost = 0.04 * image(REST.u + 3.7, REST.v - 2.9, 0.0, 0) if around == "reflection" else beside
        light = cv2.GaussianBlur(np.where(left | right, 0.8 * inside + 20, ghost), (0, 0), 0.6)
        if around == "lamp":
            light[np.hypot(COL - 120, ROW - 20) < 18] = 900
        noisy = light + np.random.default_rng(seed).standard_normal(light.shape)
        images.append(np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
    found = crossed(images[0], images[1], SHOWN, prior=REST)
    distance = cv2.distanceTransform((left | right).astype(np.uint8), cv2.DIST_L2, 5)
    assert found.good[distance > 12].mean() > 0.99
    assert not found.good[cv2.distanceTransform((distance == 0).astype(np.uint8), cv2.DIST_L2, 5) > 20].any()
    for error, sigma in ((found.du - moved, found.sigma_u), (found.dv + 0.5 * moved, found.sigma_v)):
        assert (np.abs(error) > 5 * sigma)[(distance > 0) & found.good].mean() <= 2e-3
    if around == "lamp":
        assert (found.flags[15:25, 115:125] & Flag.SATURATED).all()
