"""What is decoded does not depend on how it is cut: rows into blocks, blocks among threads."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.blocks import THREADS_VARIABLE
from optolever.decode import Correspondence, decode
from optolever.decode.records import Near
from optolever.decode.rows import Maps, near_step
from optolever.patterns import Sequence, sequence

F64 = NDArray[np.float64]
Shoot = Callable[..., NDArray[Any]]
FIELDS = ("u", "v", "sigma_u", "sigma_v", "flags", "amplitude", "offset", "order_error")


def shown_as(name: str) -> Sequence:
    """Two periods of four steps are fitted in one go, where nothing of a tile is clipped or in doubt."""
    return sequence("phase", 120, 135, periods=(160.0, 20.0)) if name == "pair" else sequence(name, 120, 135)


@pytest.mark.parametrize("name", ["phase", "pair", "gray", "gray+phase"])
@pytest.mark.parametrize("rows", [7, 16, 32, 200])
def test_blocks_change_nothing(
    name: str, rows: int, shoot: Shoot, smooth: tuple[F64, F64], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A hole, a bright spot and the border are in view, so that neighbours tell of them across blocks."""
    shown = shown_as(name)
    row, col = np.mgrid[:120, :140]
    light = np.where((row - 60) ** 2 + (col - 50) ** 2 < 90, 1.0, 90.0)
    light[np.hypot(row - 30, col - 100) < 6] = 150.0
    frames = shoot(shown, *smooth, noise=1.5, offset=light + 10, amplitude=light)

    def run(block: int, threads: int) -> Correspondence:
        monkeypatch.setattr("optolever.decode.decoder._BLOCK", block)
        monkeypatch.setenv(THREADS_VARIABLE, str(threads))
        return decode(frames, shown)

    one, other = run(120, 1), run(rows, 3)
    assert 0.5 < one.good.mean() < 0.99
    for field in FIELDS:
        assert np.array_equal(getattr(one, field), getattr(other, field), equal_nan=True), field


@pytest.mark.parametrize("noise", [1.5, 14.0])
def test_two_periods_in_one_go(noise: float, shoot: Shoot, smooth: tuple[F64, F64]) -> None:
    """A clipped pixel leaves its tile to the loops that take one period after the other: the same answers,
    with orders that are certain and with such that are not."""
    shown = sequence("phase", 120, 135, periods=(160.0, 20.0), steps=4)
    frames = shoot(shown, *smooth, noise=noise)
    frames[:, ::16] = np.minimum(frames[:, ::16], 254)
    other = frames.copy()
    other[0, ::16, 0] = 255
    one, two = (decode(each, shown, noise=noise, blur_px=0.4) for each in (frames, other))
    assert (one.order_error.max() > 1e-3) == (noise > 10)
    same = np.ones(one.flags.shape, bool)
    for row in range(0, 120, 16):  # and what these tell their neighbours
        same[max(row - 4, 0) : row + 5, :8] = False
    assert one.good[same].mean() > 0.5
    assert (two.flags[::16, 0] == one.flags[::16, 0]).all()  # three samples are enough
    for field in FIELDS:
        np.testing.assert_allclose(getattr(one, field)[same], getattr(two, field)[same], rtol=2e-6, atol=1e-6)


@pytest.mark.parametrize("size", [(1, 64), (64, 1), (1, 9), (6, 6), (8, 40), (40, 8)])
@pytest.mark.parametrize("name", ["phase", "gray", "gray+phase"])
@pytest.mark.parametrize("lit", [True, False])
def test_small_images(name: str, size: tuple[int, int], lit: bool, shoot: Shoot) -> None:
    """One line, a handful of pixels or no light: decoded or flagged, without a warning."""
    shown = sequence(name, 120, 135)
    v, u = np.mgrid[: size[0], : size[1]] + 30.3
    light = 90.0 if lit else 0.0
    found = decode(shoot(shown, u, v, noise=0.5, offset=light + 2, amplitude=light), shown)
    if lit:
        assert found.good.mean() > 0.7
        assert np.abs(found.u - u)[found.good].max() < 1
    else:
        assert not found.good.any()


@pytest.mark.parametrize("name", ["phase", "gray"])
@pytest.mark.parametrize("rows", [16, 40])
def test_shadows_reach_across_blocks(
    name: str, rows: int, shoot: Shoot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether a dim pixel lies in the border's shadow is told by all pixels between it and the border."""
    shown = sequence(name, 90, 135)
    v, u = np.mgrid[:120, :130] + 2.3
    inside = 89.5 - v
    # the border's shadow, and a band that is dim for another reason
    dim = np.where((inside < 3) | (np.abs(inside - 9) < 2), 0.7, 1.0) * (inside > 0)
    light = np.where(u > 60, dim, np.where(inside < 14, 0.7 * (inside > 0), 1.0)) * 90
    frames = shoot(shown, u, v, noise=1.0, offset=light + 10, amplitude=light)

    def run(block: int, threads: int) -> Correspondence:
        monkeypatch.setattr("optolever.decode.decoder._BLOCK", block)
        monkeypatch.setenv(THREADS_VARIABLE, str(threads))
        return decode(frames, shown)

    one = run(120, 1)
    edge = (inside > 11) & (inside < 14)
    assert one.good[edge & (u < 55)].mean() < 0.2
    assert one.good[(np.abs(inside - 9) < 2) & (u > 65)].mean() > 0.8
    for _ in range(3):
        other = run(rows, 3)
        for field in FIELDS:
            assert np.array_equal(getattr(one, field), getattr(other, field), equal_nan=True), field


def test_neighbours_are_compared_in_blocks_of_any_size() -> None:
    """More rows at once than a thread keeps, a hole, a dim border: as few at a time."""
    rows, cols = 150, 140
    v, u = np.mgrid[:rows, :cols].astype(np.float64)

    def compared(block: int) -> Maps:
        rng, maps = np.random.default_rng(3), Maps((rows, cols), {"u", "v"})
        maps.coord["u"][...] = u + 2.3 + 30 * (u > 70)
        maps.coord["v"][...] = v - 6 + 3e-4 * (u - 70) ** 2
        for chart in (*maps.sigma.values(), maps.order_error):
            chart[...] = 0.1
        maps.flags[...] = rng.random((rows, cols)) < 0.01
        maps.amplitude[...], maps.offset[...] = np.where(v % 37 < 5, 60, 90) + rng.random((rows, cols)), 100
        near = Near(
            shown=(True, True),
            steep=(None, None),
            least=(np.float32(5), np.float32(5)),
            read2=np.float32(0.1),
            gain=np.float32(0),
            extents=(np.inf, 130.0),
            bands=((np.inf, -np.inf), (-np.inf, 8.0)),
            u=maps.coord["u"],
            v=maps.coord["v"],
            sigma_u=maps.sigma["u"],
            sigma_v=maps.sigma["v"],
            dim=np.zeros(rows, np.uint8),
        )
        step = near_step(near, maps)
        for row in range(0, rows, block):
            step(row, min(row + block, rows))
        maps.order_error[:, 0] = near.dim
        return maps

    whole, few = compared(rows), compared(4)
    assert 2 < whole.order_error[:, 0].sum() < 40
    for one, other in zip(
        (*whole.sigma.values(), *whole.common), (*few.sigma.values(), *few.common), strict=True
    ):
        assert np.array_equal(one, other)
