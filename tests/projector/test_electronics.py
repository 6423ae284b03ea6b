"""Noise statistics, response, quantisation, exposure and flicker of the sensor: uniform frames."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.patterns import Frame, Sequence
from optolever.projector import WHITE_NOISE_SENSOR, capture
from optolever.scene import Sensor, dent, load, resize

SCENE = resize(load("paper-simulation"), 200, 200)
SHADES = (0, 51, 128, 200, 255)


def digits(
    sensor: Sensor | None, *levels: int, noise: float = 0.0, bits: int = 8, seed: int = 1
) -> NDArray[np.float64]:
    """Frames (N, 150, 150) of even light, away from the pattern's border."""
    shown = Sequence(
        tuple(Frame("uniform", level=one) for one in levels), SCENE.pattern.rows, SCENE.pattern.cols
    )
    scene = replace(SCENE, sensor=sensor)
    seen = capture(scene, dent("flat", scene), shown, noise=noise, bits=bits, seed=seed, renderer="numpy")
    return seen.frames[:, 25:175, 25:175].astype(np.float64)


@pytest.mark.parametrize("bits", [8, 12, 16])
def test_quantisation_rounds_and_clips_at_full_scale(bits: int) -> None:
    white, light = 2**bits - 1, np.array(SHADES)[:, None, None] / 255
    found = digits(Sensor(exposure=0.618), *SHADES, bits=bits)
    assert np.abs(found - 0.618 * light * white).max() < 0.501
    assert (digits(Sensor(exposure=1.7), 200, 255, bits=bits) == white).all()
    assert (digits(Sensor(offset=-30.0), 0, 10, bits=bits) == 0).all()


def test_read_noise_has_the_given_rms_and_no_bias_and_is_seeded() -> None:
    (values,) = digits(WHITE_NOISE_SENSOR, 128, noise=3.0, bits=16) * 255 / 65535
    count = values.size
    assert values.mean() == pytest.approx(16 + 0.85 * 128, abs=4 * 3.0 / np.sqrt(count))
    assert values.std() == pytest.approx(3.0, rel=4 / np.sqrt(2 * count))
    centred = values - values.mean()
    assert abs((centred[:, 1:] * centred[:, :-1]).mean()) < 4 * 9 / np.sqrt(count)
    assert ((centred / 3) ** 4).mean() == pytest.approx(3.0, abs=4 * np.sqrt(96 / count))
    first, again, other = (digits(Sensor(gain_e=20.0), 128, noise=2.0, seed=seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first, again)
    assert (first != other).mean() > 0.5


@pytest.mark.parametrize("electrons", [0.5, 4.0, 40.0])
def test_shot_noise_is_poisson(electrons: float) -> None:
    """Variance = mean / electrons per level; skewness 1/sqrt(mean electrons); the offset has none."""
    dark, values = digits(Sensor(gain_e=electrons, offset=20.0), 0, 64, bits=16) * 255 / 65535 - 20
    assert values.mean() == pytest.approx(64, abs=0.3)
    assert values.var() == pytest.approx(64 / electrons, rel=0.04)
    skewness = ((values - values.mean()) ** 3).mean() / values.std() ** 3
    assert skewness == pytest.approx(1 / np.sqrt(64 * electrons), abs=0.06)
    assert np.abs(dark).max() < 1e-9


def test_flicker_is_the_mean_over_the_shutter() -> None:
    sensor = Sensor(flicker=0.3, flicker_hz=100.0, shutter_s=0.007, frame_s=0.0113)
    for index, values in enumerate(digits(sensor, 128, 128, 128, bits=16)):
        instants = 0.0113 * index + 0.007 * ((np.arange(20000) + 0.5) / 20000 - 0.5)
        mean = (1 + 0.3 * np.sin(2 * np.pi * 100 * instants)).mean()
        np.testing.assert_allclose(values / 65535, mean * 128 / 255, rtol=1e-4)


def test_a_scene_without_a_sensor_has_photon_noise_and_room_for_more() -> None:
    """30 electrons a level, 0.2 levels of read noise, rounding (1/12)."""
    light = 216.75 * np.array([200, 100]) / 255
    seen = digits(None, 200, 100, noise=1.0)
    np.testing.assert_allclose(seen.mean(axis=(1, 2)), 16 + light, atol=0.1)
    np.testing.assert_allclose(seen.var(axis=(1, 2)), light / 30 + 0.04 + 1.0 + 1 / 12, rtol=0.05)
