"""Probes: single cells over time, their spectra against closed forms, and the noise floor."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from lab.live.figures import trembling, vibration
from lab.live.streams import StreamRig
from optolever import InputError
from optolever.live import Live, Prepared, Probes, Spectrum, noise_floor, spectrum_of

from .conftest import NOISE, Shot

RATE, SECONDS = 60.0, 12.0


def _frames(skipped: float, seed: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Times of exposures of which a share is missing, and arrivals up to 5 ms later."""
    rng = np.random.default_rng(seed)
    times = np.flatnonzero(rng.random(round(RATE * SECONDS)) >= skipped) / RATE
    return times, times + 0.005 * rng.random(times.size)


@pytest.mark.parametrize("skipped", [0.0, 0.05, 0.2, 0.4])
def test_a_line_by_arrivals_of_which_some_are_missing(skipped: float) -> None:
    """Without a counter: amplitude and frequency within their sigmas, the floor that of so many frames."""
    found, floors, errors = [], [], []
    for seed in range(12):
        times, arrivals = _frames(skipped, seed)
        noise = 40e-6 * np.random.default_rng(seed).standard_normal(times.size)
        spectrum = spectrum_of(arrivals, 0.5 + 1e-3 * times + 1e-4 * np.sin(14 * np.pi * times + 1) + noise)
        assert spectrum is not None
        (line,) = spectrum.lines
        assert line.hz == pytest.approx(7.0, abs=5 * line.hz_sigma)
        assert line.folds == pytest.approx((53.0, 67.0), abs=0.01)
        found.append(line.amplitude)
        errors.append((line.amplitude - 1e-4) / line.sigma)
        floors.append(spectrum.floor)
        assert spectrum.density == pytest.approx(40e-6 * np.sqrt(2 / RATE / (1 - skipped)), rel=0.2)
    assert np.mean(found) == pytest.approx(1e-4, rel=0.02)
    assert 0.5 < np.sqrt(np.mean(np.square(errors))) < 1.6


@pytest.mark.parametrize("exposure_s", [0.0, 0.008, 1 / RATE])
def test_a_sine_is_corrected_for_the_exposure_and_the_scatter_of_arrivals(exposure_s: float) -> None:
    """Closed forms: sinc(f T); exp(-2 pi^2 f^2 s^2) of times, undone by what the rate itself lost."""
    rng, k = np.random.default_rng(2), np.arange(720)
    sine = 1e-4 * np.sinc(17.3 * exposure_s) * np.sin(2 * np.pi * 17.3 * k / RATE + 1)
    heights = sine + 1e-6 * rng.standard_normal(k.size)
    for times, numbers in (
        (k / RATE + 0.003 * rng.standard_normal(k.size), None),
        (k / RATE + 0.02 * rng.random(k.size), k),
    ):
        found = spectrum_of(times, heights, exposure_s, numbers)
        assert found is not None
        hertz, amplitude = found.peak
        assert hertz == pytest.approx(17.3, abs=0.005)
        assert amplitude == pytest.approx(1e-4, rel=0.03)
    assert spectrum_of(k[:8] / RATE, heights[:8]) is None


def test_two_lines_in_one_resolution_and_a_press_between_them() -> None:
    """A press is no noise: its edges are left out, the level before and after is free."""
    times = np.arange(720) / RATE
    noise = 1e-6 * np.random.default_rng(0).standard_normal(times.size)
    waves = 1e-4 * np.sin(14 * np.pi * times) + 5e-5 * np.sin(14.2 * np.pi * times)
    still, pressed = (spectrum_of(times, noise + waves + 0.1 * on) for on in (0, (times > 4) & (times < 8)))
    assert still is not None
    assert pressed is not None
    for spectrum in (still, pressed):
        assert [line.hz for line in spectrum.lines] == pytest.approx([7.0, 7.1], abs=0.005)
        assert [line.amplitude for line in spectrum.lines] == pytest.approx([1e-4, 5e-5], rel=0.01)
    assert (still.moving, pressed.moving) == pytest.approx((0.0, 1.0), abs=0.1)
    assert pressed.floor == pytest.approx(still.floor, rel=0.2)


def test_noise_alone_has_no_line_and_its_floor() -> None:
    for seed in range(20):
        times, _ = _frames(0.3, seed)
        found = spectrum_of(times, np.random.default_rng(seed).standard_normal(times.size))
        assert found is not None
        assert not found.lines
        assert "no line" in str(found)


def test_a_surface_that_vibrates(stream: StreamRig) -> None:
    """Microscopic, of a rendered surface, in one cell: the sine within four sigma, 5 % at most."""
    found = vibration(stream, 1.0, {7.0: 1000.0})
    assert found.read_nm[7.0] == pytest.approx(1000.0, abs=min(4 * found.floor_nm, 50.0))


def test_a_camera_that_trembles_comes_off(stream: StreamRig) -> None:
    """By .02 pixels: the floor less the picture's shift is nearly that of a still camera. What is taken off
    with it is named: a mirror that sinks as a whole."""
    still, trembles = (trembling(stream, 64, pixels) for pixels in (0.0, 0.02))
    assert trembles["raw"].floor > 5 * still["raw"].floor
    assert trembles["steady"].floor < 2.5 * still["raw"].floor
    assert still["steady"].floor < 1.3 * still["raw"].floor
    sinks = trembling(stream, 64, 0.0, sunk_nm=2000.0)
    assert sinks["raw"].peak[1] > 5 * sinks["steady"].peak[1]


def test_a_probe_is_a_cell_with_its_sigma(prepared: Prepared, shot: Shot) -> None:
    probes = Probes(prepared)
    probe = probes.add(30.0, 22.0)
    reading = Live(prepared).update(shot())
    (probed,) = probes.read(reading)
    at = probe.row, probe.col
    assert (probed.steady, probed.sigma) == (reading.z[at], reading.noise[at])
    assert probed.z == pytest.approx(reading.z[at] - reading.moved[at])
    assert np.hypot(probed.x - 30, probed.y - 22) < np.sqrt(prepared.area)
    (lost,) = probes.read(replace(reading, trusted=False))
    assert lost.z is lost.steady is lost.sigma is None
    with pytest.raises(InputError, match="trace: 'x', must be one of raw, steady, difference"):
        probes.spectra(trace="x")
    with pytest.raises(InputError, match=r"probe 99,22: must be on .* x 1.3. to 58.7 mm"):
        probes.add(99.0, 22.0)


def test_a_difference_of_probes_has_nothing_in_common(prepared: Prepared, shot: Shot) -> None:
    probes, reading = Probes(prepared), Live(prepared).update(shot())
    probes.add(20.0, 15.0)
    other = probes.add(40.0, 28.0)
    at = np.zeros_like(reading.z)
    at[other.row, other.col] = 1e-4
    rng = np.random.default_rng(0)
    for k in range(120):
        waves = 1e-3 * np.sin(14 * np.pi * k / RATE) + at * np.sin(30 * np.pi * k / RATE)
        waves = waves + 1e-6 * rng.standard_normal(at.shape)
        probes.read(replace(reading, z=(reading.z + waves).astype(np.float32), time=k / RATE))
    assert [line.hz for line in _known(probes.spectra()[1]).lines] == pytest.approx([7.0, 15.0], abs=0.01)
    first, found = probes.spectra(trace="difference")
    assert first is None
    (line,) = _known(found).lines
    assert (line.hz, line.amplitude) == (pytest.approx(15.0, abs=0.01), pytest.approx(1e-4, rel=0.02))


def _known(spectrum: Spectrum | None) -> Spectrum:
    assert spectrum is not None
    return spectrum


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
