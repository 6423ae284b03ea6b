"""What is decoded does not depend on how it is cut: rows into blocks, blocks among threads."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.blocks import THREADS_VARIABLE
from optolever.decode import Correspondence, decode
from optolever.patterns import Sequence, sequence, sequence_from_text

from .conftest import Map, Shoot

FIELDS = ("u", "v", "sigma_u", "sigma_v", "flags", "amplitude", "offset", "order_error")


@pytest.fixture
def cut(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Correspondence]:
    """decode, in blocks of so many rows among so many threads."""

    def run(frames: NDArray[Any], shown: Sequence, block: int, threads: int) -> Correspondence:
        size = 4 * frames.shape[2] * 6 * block  # bytes that two axes of a block take
        monkeypatch.setattr("optolever.decode.pipeline._CACHE", size)
        monkeypatch.setenv(THREADS_VARIABLE, str(threads))
        return decode(frames, shown)

    return run


def assert_same(one: Correspondence, other: Correspondence) -> None:
    for field in FIELDS:
        assert np.array_equal(getattr(one, field), getattr(other, field), equal_nan=True), field


@pytest.mark.daily(3)
@pytest.mark.parametrize(
    "name", ["phase", "phase:periods=20/22/25", "gray", "gray+phase", "stripe", "micro-phase"]
)
def test_blocks_change_nothing(
    name: str, shoot: Shoot, smooth: Map, cut: Callable[..., Correspondence]
) -> None:
    """A hole, a bright spot and the border are in view, so that neighbours tell of them across blocks."""
    shown = sequence_from_text(name, 150, 170)
    row, col = np.mgrid[:120, :140]
    light = np.where((row - 60) ** 2 + (col - 50) ** 2 < 90, 1.0, 90.0)
    light[np.hypot(row - 30, col - 100) < 6] = 150.0
    frames = shoot(shown, *smooth, noise=1.5, offset=light + 10, amplitude=light)
    one = cut(frames, shown, 128, 1)
    assert 0.5 < one.good.mean() < 0.99
    for rows in (16, 23, 32, 64):
        assert_same(one, cut(frames, shown, rows, 3))


@pytest.mark.daily(6)
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
