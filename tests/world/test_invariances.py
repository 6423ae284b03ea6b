"""Changes that leave a pixel's answer as it is, on drawn and real captures: they need no truth."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.decode import Correspondence, decode
from optolever.patterns import Sequence
from optolever.projector import Capture

from ..conftest import ROOT
from .light import World, shoot
from .rigs import draw_rig

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")
REAL = ROOT.parent / "shared" / "real" / "refused"
#: Captures, drawn by code or real, and the width of a resolved cell, px.
CELLS = {
    "gray+phase": 0.0,
    "phase": 0.0,
    "gray": 1.0,
    "zeng_left_crop": 8.0,
    "slstudio_skull_gray": 2.0,
    "visualma_V1": 2.0,
}
FIELDS = ("u", "v", "sigma_u", "sigma_v", "flags")
# Processors cut a row into vectors at other places, so that its sums round otherwise: differences over sigma.
PLACES, SIGMAS = 1e-2, 1e-4
NEAR = 10  # pixels from a cut, which miss neighbours: five, and five more beside unlit pixels
#: Of an estimated noise, where it differs most: median of sigma in a window; share of sigmas a fifth apart.
WINDOWS, SHARES = {"gray+phase": 0.12, "phase": 0.06}, {"slstudio_skull_gray": 0.05}
Frames = NDArray[np.generic]
Maps = dict[str, NDArray[np.generic]]


@lru_cache(maxsize=8)
def given(name: str) -> tuple[Frames, Sequence]:
    if "_" not in name:
        shot = shoot(draw_rig(3), name, World())
        return shot.frames, shot.sequence
    if not REAL.is_dir():
        pytest.skip(f"{REAL} is absent: no real captures to test with")
    capture = Capture.load(REAL / name)
    return np.asarray(capture.frames), capture.sequence


def maps(found: Correspondence) -> Maps:
    return {name: getattr(found, name) for name in FIELDS}


@lru_cache(maxsize=16)
def whole(name: str, noise: float | None) -> Maps:
    return maps(decode(*given(name), noise=noise))


def same(name: str, one: Maps, two: Maps, exact: bool = False) -> None:
    """To the roundings of float32, or within the limits for an estimated noise: places by a sigma or half a
    cell, sigma by a fifth."""
    if exact:
        np.testing.assert_array_equal(one["flags"], two["flags"])
        for axis in "uv":
            place, other, sigma, second = (
                each[key] for key in (axis, f"sigma_{axis}") for each in (one, two)
            )
            np.testing.assert_allclose(sigma, second, rtol=SIGMAS)
            assert not (np.abs(place - other) > PLACES * np.minimum(sigma, 1.0)).any()
        return
    good = one["flags"] == 0
    both = good & (two["flags"] == 0)
    assert both.sum() >= 0.95 * good.sum()
    for axis in "uv":
        place, other, sigma, second = (
            each[key][both] for key in (axis, f"sigma_{axis}") for each in (one, two)
        )
        if np.isfinite(sigma).any():
            assert np.mean(np.abs(other - place) > np.maximum(sigma, 0.5 * CELLS[name])) <= 0.01
            assert np.mean(np.abs(second / sigma - 1) > 0.2) <= SHARES.get(name, 0.03)
            assert abs(np.median(second / sigma) - 1) <= WINDOWS.get(name, 0.05)


def part(of: Maps, rows: slice, cols: slice) -> Maps:
    return {name: value[rows, cols] for name, value in of.items()}


OFF_CUT = slice(NEAR, -NEAR), slice(NEAR, -NEAR)


@pytest.mark.daily(4)
@pytest.mark.parametrize("noise", [None, 1.0])
@pytest.mark.parametrize("cut", [(slice(0, 90), slice(0, 90)), (slice(15, 108), slice(15, 108))])
@pytest.mark.parametrize("name", CELLS)
def test_a_window(name: str, cut: tuple[slice, slice], noise: float | None) -> None:
    frames, shown = given(name)
    found = maps(decode(np.ascontiguousarray(frames[:, *cut]), shown, noise=noise))
    before = part(whole(name, noise), *cut)
    same(name, part(before, *OFF_CUT), part(found, *OFF_CUT), noise is not None)


@pytest.mark.daily(4)
@pytest.mark.parametrize("noise", [None, 1.0])
@pytest.mark.parametrize("name", CELLS)
def test_a_mask(name: str, noise: float | None) -> None:
    frames, shown = given(name)
    cut = slice(10, 105), slice(12, 106)
    mask = np.zeros(frames.shape[1:], np.bool_)
    mask[cut] = True
    found = part(maps(decode(frames, shown, noise=noise, mask=mask)), *cut)
    before = part(whole(name, noise), *cut)
    same(name, part(before, *OFF_CUT), part(found, *OFF_CUT), noise is not None)


@pytest.mark.daily(4)
@pytest.mark.parametrize("noise", [None, 1.0])
@pytest.mark.parametrize("name", CELLS)
def test_a_dark_margin(name: str, noise: float | None) -> None:
    """Three times as many dark pixels as there are."""
    frames, shown = given(name)
    pad = frames.shape[1] // 2
    shape = len(frames), *(count + 2 * pad for count in frames.shape[1:])
    around = np.clip(np.rint(np.random.default_rng(0).normal(5, 1, shape)), 0, 255).astype(frames.dtype)
    inside = slice(pad, -pad), slice(pad, -pad)
    around[:, *inside] = frames
    found = part(part(maps(decode(around, shown, noise=noise)), *inside), *OFF_CUT)
    same(name, part(whole(name, noise), *OFF_CUT), found, noise is not None)


@pytest.mark.daily(3)
@pytest.mark.parametrize(
    "move", [lambda image: image[..., ::-1], lambda image: np.rot90(image, axes=(-2, -1))]
)
@pytest.mark.parametrize("name", CELLS)
def test_a_turned_image(name: str, move: Callable[[Frames], Frames]) -> None:
    frames, shown = given(name)
    found = decode(np.ascontiguousarray(move(frames)), shown)
    same(name, {key: move(value) for key, value in whole(name, None).items()}, maps(found))


@pytest.mark.daily(2)
@pytest.mark.parametrize("name", CELLS)
def test_another_order_of_description(name: str) -> None:
    frames, shown = given(name)
    order = np.random.default_rng(1).permutation(len(frames))
    mixed = replace(shown, frames=tuple(shown.frames[i] for i in order))
    same(name, whole(name, None), maps(decode(frames[order], mixed)))


def agree(one: Correspondence, two: Correspondence) -> NDArray[np.bool_]:
    """Pixels (H, W) good in both, whose places agree within both sigmas."""
    both = one.good & two.good
    assert both.sum() > 0.97 * one.good.sum()
    off = np.abs(one.u - two.u)[both] > 5 * np.hypot(one.sigma_u, two.sigma_u)[both]
    assert off.mean() <= 1e-3
    return both


@pytest.mark.parametrize("codes", [("gray:cell=2", "gray"), ("gray+phase:period=16", "gray+phase")])
def test_one_more_fine_bit_costs_no_pixel(codes: tuple[str, str]) -> None:
    shots = [shoot(draw_rig(3), code, World(lens=0.4)) for code in codes]
    agree(*(decode(shot.frames, shot.sequence) for shot in shots))


@pytest.mark.parametrize("code", ["gray+phase", "phase", "gray"])
def test_twice_the_light_makes_no_sigma_larger(code: str) -> None:
    shots = [shoot(draw_rig(3), code, World(white=white)) for white in (100.0, 200.0)]
    dim, bright = (decode(shot.frames, shot.sequence) for shot in shots)
    both = agree(dim, bright)
    assert 0.4 < np.median(bright.sigma_u[both] / dim.sigma_u[both]) < 1.05
