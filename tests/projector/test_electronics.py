"""Noise statistics, response, quantisation, exposure and flicker of the sensor."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.patterns import Frame, Sequence
from optolever.projector import NOMINAL_SENSOR, WHITE_NOISE_SENSOR, capture
from optolever.projector.electronics import FrameElectronics, flicker_factor
from optolever.scene import Scene, Sensor, dent, load, resize

LINEAR = Sensor()


def digits(
    sensor: Sensor, light: float, *, noise: float = 0.0, bits: int = 8, gain: float = 1.0, seed: int = 1
) -> NDArray[np.float64]:
    """300 x 400 pixels of even light."""
    out = np.empty((300, 400), np.uint8 if bits == 8 else np.uint16)
    electronics = FrameElectronics.of_frame(sensor, gain, noise, bits, seed, 0)
    electronics.expose(np.full(out.shape, light, np.float32), out)
    return out.astype(np.float64)


@pytest.mark.parametrize("bits", [8, 12, 16])
def test_quantisation_rounds_and_clips_at_full_scale(bits: int) -> None:
    white = 2**bits - 1
    for light in (0.0, 0.2, 0.6180339, 1.0):
        assert (digits(LINEAR, light, bits=bits) == round(np.float32(light) * white)).all()
    assert (digits(LINEAR, 1.7, bits=bits) == white).all()
    assert (digits(replace(LINEAR, offset=-30.0), 0.0, bits=bits) == 0).all()


def test_read_noise_has_the_given_rms_and_no_bias() -> None:
    values = digits(LINEAR, 0.5, noise=3.0, bits=16) * 255 / 65535
    count = values.size
    assert values.mean() == pytest.approx(127.5, abs=4 * 3.0 / np.sqrt(count))
    assert values.std() == pytest.approx(3.0, rel=4 / np.sqrt(2 * count))
    centred = values - values.mean()
    assert abs((centred[:, 1:] * centred[:, :-1]).mean()) < 4 * 9 / np.sqrt(count)
    assert ((centred / 3) ** 4).mean() == pytest.approx(3.0, abs=4 * np.sqrt(96 / count))


@pytest.mark.parametrize("electrons", [0.5, 4.0, 40.0])
def test_shot_noise_is_poisson(electrons: float) -> None:
    """Variance = mean / electrons per level; skewness 1/sqrt(mean electrons); the offset has none."""
    sensor = Sensor(gain_e=electrons, offset=20.0)
    values = digits(sensor, 0.25, bits=16) * 255 / 65535 - 20
    assert values.mean() == pytest.approx(63.75, abs=0.15)
    assert values.var() == pytest.approx(63.75 / electrons, rel=0.03)
    skewness = ((values - values.mean()) ** 3).mean() / values.std() ** 3
    assert skewness == pytest.approx(1 / np.sqrt(63.75 * electrons), abs=0.03)
    assert (digits(sensor, 0.0) == 20).all()


def test_flicker_is_the_mean_over_the_shutter() -> None:
    sensor = Sensor(flicker=0.3, flicker_hz=100.0, shutter_s=0.007, frame_s=0.01)
    for time in (0.0, 0.0013, 0.4):
        instants = time + 0.007 * ((np.arange(20000) + 0.5) / 20000 - 0.5)
        expected = (1 + 0.3 * np.sin(2 * np.pi * 100 * instants)).mean()
        assert flicker_factor(sensor, time) == pytest.approx(expected, abs=1e-8)
    assert flicker_factor(LINEAR, 0.3) == 1.0


def small() -> tuple[Scene, Sequence]:
    """A scene whose mirror is flat and whose sensor has no noise, and three uniform frames."""
    scene = replace(resize(load("paper-simulation"), 40, 40), sensor=WHITE_NOISE_SENSOR)
    frames = tuple(Frame("uniform", level=level) for level in (200, 100, 100))
    return scene, Sequence(frames, scene.pattern.rows, scene.pattern.cols)


def inner(frames: NDArray[np.uint8] | NDArray[np.uint16]) -> NDArray[np.float64]:
    """Away from the pattern's border."""
    return frames[:, 10:30, 10:30].astype(np.float64)


def test_a_scene_without_a_sensor_has_photon_noise_and_room_for_more() -> None:
    """30 electrons a level, 0.2 levels of read noise, rounding (1/12); 400 pixels: 7 % of a variance."""
    scene, shown = small()
    light = 216.75 * np.array([200, 100, 100]) / 255
    seen = inner(capture(scene, dent("flat", scene), shown, renderer="numpy").frames)
    assert (seen == np.round(16 + light)[:, None, None]).all()
    plain = replace(scene, sensor=None)
    seen = inner(capture(plain, dent("flat", scene), shown, renderer="numpy", noise=1.0).frames)
    np.testing.assert_allclose(seen.mean(axis=(1, 2)), 16 + light, atol=0.6)
    np.testing.assert_allclose(seen.var(axis=(1, 2)), light / 30 + 0.04 + 1.0 + 1 / 12, rtol=0.25)


def test_noise_is_seeded() -> None:
    scene, shown = small()
    noisy = replace(scene, sensor=replace(NOMINAL_SENSOR, gain_e=20.0))
    flat = dent("flat", scene)
    first = capture(noisy, flat, shown, renderer="numpy", noise=2.0, seed=5)
    other = capture(noisy, flat, shown, renderer="numpy", noise=2.0, seed=6)
    assert (first.frames != other.frames).mean() > 0.5
    again = capture(noisy, flat, shown, renderer="numpy", noise=2.0, seed=5)
    np.testing.assert_array_equal(first.frames, again.frames)
