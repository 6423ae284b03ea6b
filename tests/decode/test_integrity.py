"""Swapped, lost, repeated and torn frames are named; whole captures are not."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever import InputError
from optolever.decode import check
from optolever.patterns import sequence

F64 = NDArray[np.float64]
Shoot = Callable[..., NDArray[Any]]
CASES: tuple[tuple[str, dict[str, Any]], ...] = (
    ("phase", {"steps": 4}),
    ("phase", {"steps": 8, "periods": (190.0, 16.0)}),
    ("gray", {}),
    ("gray", {"references": False}),
    ("gray+phase", {"inverses": True}),
)


@pytest.mark.parametrize(("name", "params"), CASES)
def test_nothing_is_found_in_whole_captures(
    name: str, params: dict[str, Any], shoot: Shoot, smooth: tuple[F64, F64]
) -> None:
    shown = sequence(name, 150, 170, **params)
    for noise in (0.0, 1.0, 8.0):
        report = check(shoot(shown, *smooth, noise=noise), shown)
        assert report.findings == ()
        assert report.constraints > 0


@pytest.mark.parametrize(("name", "params"), CASES)
def test_neighbours_in_each_others_place_are_named(
    name: str, params: dict[str, Any], shoot: Shoot, smooth: tuple[F64, F64]
) -> None:
    shown = sequence(name, 150, 170, **params)
    frames = shoot(shown, *smooth, noise=1.0)
    first = len(shown) // 2 + len(shown) % 2 - 1
    frames[[first, first + 1]] = frames[[first + 1, first]]
    report = check(frames, shown)
    same_pair = shown.frames[first].bit is not None and shown.frames[first].bit == shown.frames[first + 1].bit
    if same_pair:
        assert report.findings == ()  # a bit and its inverse: nothing tells
    else:
        assert report.findings[0].kind == "swapped"
        assert {first, first + 1} <= set(report.findings[0].frames)


def test_a_lost_frame_is_named(shoot: Shoot, smooth: tuple[F64, F64]) -> None:
    shown = sequence("phase", 150, 170, steps=8, periods=(190.0, 16.0))
    frames = shoot(shown, *smooth, noise=1.0)
    frames[11:-1] = frames[12:].copy()
    found = check(frames, shown).findings
    assert found[0].kind == "lost"
    assert 11 in found[0].frames


def test_a_repeated_frame_is_named(shoot: Shoot, smooth: tuple[F64, F64]) -> None:
    shown = sequence("phase", 150, 170, steps=8, periods=(190.0, 16.0))
    frames = shoot(shown, *smooth, noise=1.0)
    frames[12:] = frames[11:-1].copy()
    found = check(frames, shown).findings
    assert found[0].kind == "repeated"
    assert {11, 12} & set(found[0].frames)


def test_a_torn_frame_is_named(shoot: Shoot, smooth: tuple[F64, F64]) -> None:
    shown = sequence("phase", 150, 170, steps=8, periods=(190.0, 16.0))
    frames = shoot(shown, *smooth, noise=1.0)
    frames[20, 70:] = frames[21, 70:]
    found = check(frames, shown).findings
    assert found[0].kind == "torn"
    assert 20 in found[0].frames


def test_three_steps_tell_nothing(shoot: Shoot, smooth: tuple[F64, F64]) -> None:
    shown = sequence("phase", 150, 170, steps=3)
    assert check(shoot(shown, *smooth), shown).constraints == 0


def test_frames_that_do_not_fit_are_refused() -> None:
    with pytest.raises(InputError, match="describes"):
        check(np.zeros((2, 4, 4), np.uint8), sequence("phase", 150, 170))
