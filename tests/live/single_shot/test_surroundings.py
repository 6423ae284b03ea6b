"""A mirror that fills a part of the picture: darkness, a lit room, a second reflection, a lamp beside it.

The light is closed form: a crossed fringe of what each pixel sees, averaged over 4 x 4 rays a pixel.
"""

from functools import lru_cache
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.decode import Displacement, Flag
from optolever.live import crossed
from optolever.patterns import sequence

F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]
PERIOD = 10.0
SHOWN = sequence("crossed", 420, 420, period=PERIOD)
ROWS, COLS = 300, 360
RAYS = (np.arange(4) - 1.5) / 4


def at_rest(row: F64, col: F64) -> tuple[F64, F64]:
    return 380 - 0.95 * col + 0.03 * row, 40 + 1.05 * row + 3 * np.sin(col / 90)


def bump(row: F64, col: F64) -> F64:
    """Under half a period of median in every mirror, nearly one at its top."""
    return 8.0 * np.exp(-((col - 170) ** 2 + (row - 140) ** 2) / (2 * 25**2)) + 0.8 * np.sin(col / 40)


def fringe(u: F64, v: F64) -> F64:
    return 0.5 + 0.25 * (np.cos(2 * np.pi * u / PERIOD) + np.cos(2 * np.pi * v / PERIOD))


def mirror(shape: str, share: float, row: F64, col: F64) -> Mask:
    """Round, oblong or two separate islands that fill a share of the picture."""
    area = share * ROWS * COLS
    y, x = row - 140, col - 170
    if shape == "round":
        return np.asarray(np.hypot(y, x) < np.sqrt(area / np.pi))
    if shape == "oblong":
        return np.asarray((np.abs(y) < np.sqrt(area / 8)) & (np.abs(x + 0.2 * y) < np.sqrt(area / 2)))
    size = np.sqrt(area / 8)
    return np.asarray((np.abs(np.abs(x) - 1.5 * size) < size) & (np.abs(y) < size))


@lru_cache(maxsize=4)
def picture(
    shape: str, share: float, around: str, pressed: bool, noise: float, seed: int
) -> NDArray[np.uint8]:
    """What an 8-bit camera takes; outside the mirror what stands `around` it."""
    light = np.zeros((ROWS, COLS))
    for dy in RAYS:
        for dx in RAYS:
            row, col = np.mgrid[:ROWS, :COLS].astype(float)
            row, col = row + dy, col + dx
            u, v = at_rest(row, col)
            moved = bump(row, col) if pressed else 0.0
            outside = np.zeros(u.shape)
            if around == "room":
                outside = 60 + 20 * np.sin(row / 37) + 25 * (col > 300)
            elif around == "reflection":
                outside = 0.04 * 200 * fringe(u + 3.7, v - 2.9)
            elif around == "lamp":
                outside = np.where(np.hypot(row - 40, col - 310) < 32, 900.0, 4.0)
            inside = 20 + 200 * fringe(u + moved, v - 0.5 * moved)
            light += np.where(mirror(shape, share, row, col), inside, outside)
    light = cv2.GaussianBlur(light / RAYS.size**2, (0, 0), 0.6)
    noisy = light + noise * np.random.default_rng(seed).standard_normal(light.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def inner(shape: str, share: float) -> Mask:
    """Pixels of the mirror two fringe periods and more away from its border and the picture's."""
    row, col = np.mgrid[:ROWS, :COLS].astype(float)
    inside = np.pad(mirror(shape, share, row, col).astype(np.uint8), 1)
    distance = cv2.distanceTransform(inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    return np.asarray(distance > 2 * PERIOD / 0.95)


def decoded(shape: str, share: float, around: str, noise: float, cut: bool) -> Displacement:
    """cut: the prior is NaN beside the mirror; else it goes on, as that of a larger mirror."""
    row, col = np.mgrid[:ROWS, :COLS].astype(float)
    u, v = at_rest(row, col)
    seen = mirror(shape, share, row, col) if cut else np.ones(u.shape, bool)
    prior = SimpleNamespace(u=np.where(seen, u, np.nan), v=np.where(seen, v, np.nan))
    frame, rest = (picture(shape, share, around, pressed, noise, 7 + pressed) for pressed in (True, False))
    return crossed(frame, rest, SHOWN, prior=prior)


def errors(found: Displacement) -> tuple[F64, F64]:
    row, col = np.mgrid[:ROWS, :COLS].astype(float)
    moved = bump(row, col)
    return found.du - moved, found.dv + 0.5 * moved


@pytest.fixture(scope="module")
def full() -> dict[float, Displacement]:
    return {noise: decoded("round", 9.0, "dark", noise, False) for noise in (0.3, 1.0, 2.5)}


@pytest.mark.parametrize(
    ("shape", "share", "cut"),
    [("round", 0.3, False), ("oblong", 0.1, True), ("islands", 0.3, False)]
    + [
        pytest.param(*case, marks=pytest.mark.slow)
        for case in (("round", 0.3, True), ("oblong", 0.1, False), ("islands", 0.3, True))
    ],
)
@pytest.mark.parametrize("around", ["dark", "room", "reflection", "lamp"])
@pytest.mark.parametrize("noise", [1.0, pytest.param(2.5, marks=pytest.mark.slow)])
def test_two_periods_from_the_border_as_in_the_full_picture(
    full: dict[float, Displacement], shape: str, share: float, around: str, noise: float, cut: bool
) -> None:
    found, whole, lit = decoded(shape, share, around, noise, cut), full[noise], inner(shape, share)
    assert lit.sum() > 1000
    assert found.good[lit].mean() > whole.good[lit].mean() - 0.03
    for error, other, sigma in zip(errors(found), errors(whole), (found.sigma_u, found.sigma_v), strict=True):
        good = lit & found.good
        assert np.sqrt(np.mean(error[good] ** 2)) <= 1.1 * np.sqrt(np.mean(other[lit] ** 2)) + 5e-4
        assert (np.abs(error) > 5 * sigma)[good].mean() <= 1e-4
        score = np.sqrt(np.mean((error[good] / sigma[good]) ** 2))
        assert 0.3 < score < 1.3


@pytest.mark.parametrize("around", ["dark", "room", "reflection", "lamp"])
def test_nothing_in_the_mirror_is_wrong_without_a_flag(around: str) -> None:
    """To the mirror's very border; darkness and lamp are flagged."""
    row, col = np.mgrid[:ROWS, :COLS].astype(float)
    inside = mirror("round", 0.1, row, col)
    found = decoded("round", 0.1, around, 1.0, False)
    for error, sigma in zip(errors(found), (found.sigma_u, found.sigma_v), strict=True):
        assert (np.abs(error) > 5 * sigma)[inside & found.good].mean() <= 2e-3
    beyond = cv2.distanceTransform((~inside).astype(np.uint8), cv2.DIST_L2, 5) > 2 * PERIOD
    assert not found.good[beyond].any()
    if around == "lamp":
        assert (found.flags[35:45, 305:315] & Flag.SATURATED).all()


def test_an_island_has_its_own_median_and_its_parts_hang_together() -> None:
    """Two mirrors: the right one displaced by 0.4 periods all over; in the left one a plateau of 1.5 periods
    behind a wall that is too steep: a part that nothing connects, flagged, while the other mirror is good.
    """
    row, col = np.mgrid[:ROWS, :COLS].astype(float)
    u, v = at_rest(row, col)
    left = (np.abs(row - 150) < 90) & (np.abs(col - 100) < 80)
    right = (np.abs(row - 150) < 60) & (np.abs(col - 270) < 50)
    moved = np.where(right, 4.0, 0.0)
    moved += 7.5 * (1 - np.tanh((np.hypot(row - 150, col - 100) - 30) / 3))
    frames = []
    for k, shift in enumerate((moved, 0.0)):
        light = np.where(left | right, 20 + 200 * fringe(u + shift, v), 0.0)
        noisy = light + np.random.default_rng(k).standard_normal(u.shape)
        frames.append(np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
    found = crossed(*frames, SHOWN, prior=SimpleNamespace(u=u, v=v))
    assert found.good[120:180, 250:290].all()
    error = np.abs(found.du - moved)[found.good]
    assert error.max() < 0.2 * PERIOD
    assert (error < 0.5).mean() > 1 - 1e-3
    assert (found.flags[140:160, 90:110] & Flag.ORDER_DOUBTFUL).all()
    assert found.good[80:220, 30:45].all()
