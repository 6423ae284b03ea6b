"""Probes: single cells over time, their spectra against closed forms, and the noise floor."""

from dataclasses import replace

import numpy as np
import pytest

from lab.live.figures import vibration
from lab.live.streams import StreamRig
from optolever import InputError
from optolever.live import Live, Prepared, Probes, noise_floor, spectrum_of

from .conftest import NOISE, Rest, Shot

RATE, SECONDS = 60.0, 4.0


@pytest.mark.parametrize("exposure_s", [0.0, 0.008, 1 / RATE])
def test_a_sine_in_noise_of_frames_that_are_lost(exposure_s: float) -> None:
    """Closed form: the exposure lowers a sine of f by sinc(f T); the floor is that of white noise."""
    rng, count = np.random.default_rng(2), round(RATE * SECONDS)
    number = np.flatnonzero(rng.random(count) > 0.05 * (exposure_s > 0))  # of 20 one is lost
    times = number / RATE + 0.004 * rng.random(number.size)  # arrival
    sine = 1e-4 * np.sinc(17.3 * exposure_s) * np.sin(2 * np.pi * 17.3 * number / RATE + 1)
    noise = 1e-5 * rng.standard_normal(number.size)
    found = spectrum_of(times, 0.5 + 1e-3 * times + sine + noise, exposure_s, number)
    assert found is not None
    hertz, amplitude = found.peak
    assert found.rate == pytest.approx(RATE, rel=1e-3)
    assert hertz == pytest.approx(17.3, abs=0.5 / SECONDS)
    assert amplitude == pytest.approx(1e-4, rel=0.05)
    if exposure_s == 0:
        assert found.density == pytest.approx(1e-5 * np.sqrt(2 / RATE), rel=0.3)
    assert spectrum_of(times[:8], sine[:8]) is None


def test_a_surface_that_vibrates(rest: Rest, prepared: Prepared) -> None:
    """Microscopic, of a rendered surface, in one cell: the sine within four sigma, 5 % at most."""
    rig = StreamRig(rest.scene, rest.world, rest.fringe, prepared)
    found = vibration(rig, 1.0, {7.0: 1000.0})
    assert found.read_nm[7.0] == pytest.approx(1000.0, abs=min(4 * found.floor_nm, 50.0))


def test_a_probe_is_a_cell_with_its_sigma(prepared: Prepared, shot: Shot) -> None:
    probes = Probes(prepared)
    probe = probes.add(30.0, 22.0)
    reading = Live(prepared).update(shot())
    (probed,) = probes.read(reading)
    at = probe.row, probe.col
    assert (probed.z, probed.sigma) == (reading.z[at], reading.noise[at])
    assert np.hypot(probed.x - 30, probed.y - 22) < np.sqrt(prepared.area)
    (lost,) = probes.read(replace(reading, trusted=False))
    assert lost.z is lost.sigma is None
    with pytest.raises(InputError, match=r"probe 99,22: must be on .* x 1.3. to 58.7 mm"):
        probes.add(99.0, 22.0)


def test_the_floor_is_that_of_frames_at_rest(prepared: Prepared, shot: Shot) -> None:
    """Frames of noise alone have no deepest cell."""
    live, heights = Live(prepared), []
    for seed in range(12):
        reading = live.update(shot(seed=seed, noise=NOISE))
        heights.append(reading.z[prepared.rig.lit])
        assert reading.deepest is None
        assert np.isnan(reading.depth)
    frame, density = noise_floor(prepared, 50.0)
    assert np.median(np.std(heights, axis=0)) == pytest.approx(frame, rel=0.5)
    assert density == pytest.approx(frame / 5)
