"""Effects of a capture: lag is taken off, a moving mirror is named; nothing is found where there is none."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

from lab.figures.ideal import ideal_level
from optolever.decode import Correspondence, decode
from optolever.patterns import Sequence, sequence
from optolever.reconstruct import PixelAnchor, reconstruct
from optolever.scene import dent_from_text, load, trace

from .conftest import Map, Shoot, scores

F64 = NDArray[np.float64]
BOTH = sequence("gray+phase", 150, 170)
#: White and black, then all of u, then all of v.
BY_AXIS = Sequence(tuple(sorted(BOTH.frames, key=lambda frame: frame.axis or "")), 150, 170)


def camera(light: F64, seed: int = 0) -> NDArray[np.uint8]:
    """Levels with photon noise (30 e/level) and read noise, rounded."""
    noise = np.sqrt(0.7 + light / 30) * np.random.default_rng(seed).standard_normal(light.shape)
    return np.clip(np.rint(light + noise), 0, 255).astype(np.uint8)


def lagging(shown: Sequence, smooth: Map, share: float) -> NDArray[np.uint8]:
    light = np.array([ideal_level(shown, i, *smooth) for i in range(len(shown))])
    light[1:] = (1 - share) * light[1:] + share * light[:-1]
    return camera(10 + 200 * light)


@pytest.mark.parametrize(
    "shown", [BOTH, BY_AXIS, sequence("phase", 150, 170)], ids=["turns", "axes", "phase"]
)
@pytest.mark.parametrize("share", [0.03, 0.1])
def test_a_lag_is_taken_off_and_sigma_holds_the_rest(shown: Sequence, share: float, smooth: Map) -> None:
    still, slow = (decode(lagging(shown, smooth, one), shown) for one in (0.0, share))
    off = scores(slow, *smooth)
    assert slow.good.mean() > 0.95
    assert np.mean(np.abs(off) > 5) < 0.002
    assert np.sqrt(np.mean(off**2)) < 1.4
    assert np.median(slow.sigma_u) < 1.5 * np.median(still.sigma_u)


def seen(shown: Sequence, smooth: Map, rate: float, seed: int = 0) -> NDArray[np.uint8]:
    """Frames of a lens that blurs, while a bump of the map grows by `rate` px a frame."""
    row, col = np.mgrid[: smooth[0].shape[0], : smooth[0].shape[1]]
    x, y = (col - 70) / 25, (row - 60) / 25
    slope = np.exp(0.5 - 0.5 * (x * x + y * y))
    around = [(a, b) for a in (-0.6, -0.2, 0.2, 0.6) for b in (-0.6, -0.2, 0.2, 0.6)]
    light = []
    for i in range(len(shown)):
        u, v = smooth[0] + rate * i * x * slope, smooth[1] + rate * i * y * slope
        light.append(np.mean([ideal_level(shown, i, u + a, v + b) for a, b in around], axis=0))
    return camera(10 + 200 * np.array(light), seed)


def moved(found: Correspondence) -> bool:
    return any("mirror moved" in one.name for one in found.notices)


@pytest.mark.parametrize("rate", [0.05, 0.1])
def test_a_mirror_that_moves_is_named_first_and_widens_sigma(rate: float, smooth: Map) -> None:
    still, found = (decode(seen(BOTH, smooth, one), BOTH) for one in (0.0, rate))
    assert not moved(still)
    assert "mirror moved" in found.notices[0].name
    assert np.median(found.sigma_u) > 3 * np.median(still.sigma_u)


def test_noise_and_gamma_are_no_lag(shoot: Shoot, smooth: Map) -> None:
    for gamma in (1.0, 2.2):
        plain = decode(shoot(BY_AXIS, *smooth, noise=1.0, gain=1 / 30, gamma=gamma, offset=120.0), BY_AXIS)
        assert not any("lag" in one.name for one in plain.notices)


CASES = Path(__file__).parents[3] / "shared/cases/t4"


@pytest.mark.skipif(not CASES.is_dir(), reason="../shared/cases/t4 is absent")
def test_heights_of_a_mirror_that_moves_while_frames_are_taken() -> None:
    """A dent that grows from 195 to 405 um: the depth at the mean time of the fringes, about 370 um."""
    frames = np.load(CASES / "moving10/frames.npz")["frames"]
    rig = load(CASES / "moving10/rig.toml")
    found = decode(frames, sequence("gray+phase", rig.pattern.rows, rig.pattern.cols))
    height = reconstruct(found, rig, anchor=PixelAnchor(frames.shape[1] // 2, 9, 0.0))
    assert found.notices[0].name.startswith("the mirror moved while the frames were taken")
    moved = height.good & (height.z > 0.05)
    assert moved.any()

    def scores(form: F64) -> F64:
        text = "gaussian:peak=0.37,sigma={:.9g},x={:.9g},y={:.9g}".format(*form)
        return np.asarray((trace(rig, dent_from_text(text, rig)).z - height.z)[moved] / height.sigma[moved])

    error = scores(least_squares(scores, [6.0, 25.0, 20.0], diff_step=1e-4).x)
    assert 0.5 < np.sqrt(np.mean(error**2)) < 1.25
    assert np.abs(error).max() < 5
    assert height.z[height.good].max() == pytest.approx(0.37, abs=0.02)
