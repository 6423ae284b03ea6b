"""Aim and focus: drawn pictures with known reflection, blur and noise."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.camera import Aim, aim

SHAPE = (120, 160)


def _seen(
    box: tuple[slice, slice] = (slice(None), slice(None)),
    blur: float = 0.3,
    gain: float = 180.0,
    noise: float = 1.5,
    seed: int = 0,
) -> Aim:
    """Aim of a camera that sees a white display in a box of its picture, on a mirror with dust."""
    random = np.random.default_rng(seed)
    dust = np.ones(SHAPE)
    dust[random.integers(0, SHAPE[0], 60), random.integers(0, SHAPE[1], 60)] = 0.3
    light = np.zeros(SHAPE)
    light[box] = gain
    white = cv2.GaussianBlur(light * dust, (0, 0), blur) + 5.0

    def taken(levels: NDArray[np.float64]) -> NDArray[np.uint8]:
        return np.asarray(np.clip(np.rint(levels + random.normal(0, noise, SHAPE)), 0, 255), np.uint8)

    return aim(taken(white), taken(white), taken(np.full(SHAPE, 5.0)), 8)


def test_sharpness_falls_with_blur_and_ignores_exposure_and_noise() -> None:
    sharp = [_seen(blur=blur).sharpness for blur in (0.3, 0.8, 1.6, 3.0)]
    assert np.all(np.diff(sharp) < -0.2 * np.array(sharp[:-1]))
    assert _seen(gain=90.0).sharpness == pytest.approx(sharp[0], rel=0.15)
    assert _seen(noise=6.0).sharpness == pytest.approx(sharp[0], rel=0.15)


def test_where_the_reflection_lies() -> None:
    found = _seen((slice(None), slice(0, 80)))
    assert found.seen == pytest.approx(0.5, abs=0.02)
    assert found.centre == pytest.approx((-0.5, 0.0), abs=0.03)
    corners = np.concatenate(found.outline)
    assert corners[:, 0].max() == pytest.approx(80, abs=2)


@pytest.mark.parametrize(
    ("box", "words"),
    [
        ((slice(0, 0), slice(0, 0)), "does not see"),
        ((slice(None), slice(0, 80)), "turn the camera to the left"),
        ((slice(None), slice(80, 160)), "turn the camera to the right"),
        ((slice(0, 40), slice(None)), "turn the camera up"),
        ((slice(80, 120), slice(None)), "turn the camera down"),
        ((slice(40, 80), slice(50, 110)), "fills 1"),
    ],
)
def test_one_sentence_says_what_to_turn(box: tuple[slice, slice], words: str) -> None:
    found = _seen(box)
    assert words in found.advice(found.sharpness)


def test_saturation_focus_and_a_good_view() -> None:
    assert "saturated" in _seen(gain=400.0).advice(1.0)
    best = _seen().sharpness
    assert "turn the focus back" in _seen(blur=1.6).advice(best)
    assert _seen().advice(best) == ""
