"""Codes captured under several exposures: right where one of them clips and another one is dark."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.decode import Flag, decode
from optolever.patterns import Sequence, sequence

from .conftest import F64, Map, Shoot

LONG = 40.0


def bracketed(shown: Sequence, *exposures: float) -> Sequence:
    frames = tuple(replace(frame, exposure=e) for e in exposures for frame in shown.frames)
    return replace(shown, frames=frames)


def shot(
    shoot: Shoot, shown: Sequence, smooth: Map, light: F64, noise: float = 1.5, black: float = 0.0
) -> NDArray[Any]:
    """Every frame under its exposure: 4 % of the light where it is dark, clipped at 255; black: level that a
    camera adds whatever the exposure."""
    frames = []
    for k, frame in enumerate(shown.frames):
        bright = light * frame.exposure
        one = replace(shown, frames=(frame,))
        offset, amplitude = black + 0.52 * bright, 0.48 * bright
        frames.append(shoot(one, *smooth, offset=offset, amplitude=amplitude, noise=noise, seed=k)[0])
    return np.array(frames)


@pytest.mark.daily(2)
@pytest.mark.parametrize(
    ("name", "limit"), [("gray", 0.501), ("gray:inverses=off", 0.501), ("binary", 0.501), ("gray+phase", 0.2)]
)
def test_right_where_one_clips_and_another_is_dark(
    shoot: Shoot, smooth: Map, name: str, limit: float
) -> None:
    code, _, plain = name.partition(":")
    both = bracketed(sequence(code, 150, 170, **({"inverses": False} if plain else {})), 1.0, LONG)
    light = np.where(np.arange(140) < 70, 3.0, 180.0)[None, :] * np.ones((120, 1))
    frames = shot(shoot, both, smooth, light)
    half = len(both) // 2
    alone = [
        decode(frames[part], replace(both, frames=both.frames[:half]), on_cells=False)
        for part in (slice(0, half), slice(half, None))
    ]
    found = decode(frames, both, on_cells=False)
    inner = np.s_[:, 8:-8]
    assert all(one.good[inner].mean() < 0.7 for one in alone)
    assert found.good[inner].mean() > 0.97
    for coord, sigma, truth in zip((found.u, found.v), (found.sigma_u, found.sigma_v), smooth, strict=True):
        error = np.abs(coord - truth)[found.good]
        assert error.max() <= limit
        assert 0.8 < np.sqrt(np.mean((error / sigma[found.good]) ** 2)) < 1.15


def test_only_what_every_exposure_clips_is_saturated(shoot: Shoot, smooth: Map) -> None:
    """Light of 3, 180 and 90000 levels: the last clips under both exposures, black included."""
    both = bracketed(sequence("gray", 150, 170), 1.0, LONG)
    light = np.repeat([3.0, 180.0, 90000.0], [50, 50, 40])[None, :] * np.ones((120, 1))
    found = decode(shot(shoot, both, smooth, light), both)
    clipped = found.flags & Flag.SATURATED > 0
    assert clipped[:, 100:].all()
    assert not clipped[:, :100].any()
    assert found.good[:, 8:92].mean() > 0.97


def test_one_exposure_for_all_is_that_of_none(shoot: Shoot, smooth: Map) -> None:
    shown = sequence("gray+phase", 150, 170)
    frames = shoot(shown, *smooth, noise=1.0)
    plain, found = decode(frames, shown), decode(frames, bracketed(shown, 0.3))
    for name in ("u", "v", "sigma_u", "flags", "amplitude"):
        np.testing.assert_array_equal(getattr(found, name), getattr(plain, name))


def test_what_moved_between_exposures_is_flagged(shoot: Shoot, smooth: Map) -> None:
    both = bracketed(sequence("gray", 150, 170), 1.0, 1.2)
    half = len(both) // 2
    light = np.full(smooth[0].shape, 150.0)
    still = shot(shoot, both, smooth, light)
    moved = shot(shoot, both, (smooth[0] + 6, smooth[1]), light)
    found = decode(np.concatenate([still[:half], moved[half:]]), both)
    assert (found.flags & Flag.MOVED > 0).mean() > 0.95
    assert (decode(still, both).flags & Flag.MOVED > 0).mean() < 1e-3


@pytest.mark.daily(1)
@pytest.mark.parametrize("name", ["phase", "micro-phase"])
def test_fringes_of_a_camera_whose_black_is_a_level(shoot: Shoot, smooth: Map, name: str) -> None:
    """It does not grow with the exposure, so that no fringe fits the samples of both."""
    both = bracketed(sequence(name, 150, 170), 1.0, 8.0)
    light = np.where(np.arange(140) < 70, 24.0, 180.0)[None, :] * np.ones((120, 1))
    found = decode(shot(shoot, both, smooth, light, black=8.0), both, on_cells=False)
    assert found.good[:, 8:-8].mean() > 0.97
    ratio = ((found.u - smooth[0]) / found.sigma_u)[found.good]
    assert 0.8 < np.sqrt(np.mean(ratio**2)) < 1.15
    assert not [one for one in found.notices if "contradict" in one.name]
