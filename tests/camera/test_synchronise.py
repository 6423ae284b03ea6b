"""Synchronisation and capture in simulated time: no wrong frame, what is measured is what is, in time."""

from dataclasses import replace

import numpy as np
import pytest

from lab.hardware.simulated import (
    Setting,
    SimulatedCamera,
    SimulatedDisplay,
    SimulatedTime,
    codes,
    drawn_setting,
)
from lab.hardware.synchronisation import measured, run_setting, run_sync
from optolever import InputError
from optolever.camera import ClockMap, FlipRecord, Timing, acquire, fit_timing, sync_notices, synchronise
from optolever.projector import Accepted, Image, Wanted


@pytest.mark.slow
def test_drawn_rigs_give_no_wrong_frame() -> None:
    """20 drawn settings: all recovered within 0.5 ms and 3 %, none wrong, mixed or incomplete, in time; as
    `python -m lab sync` in 100,000."""
    figures = run_sync(20_000, seed=0)
    assert sum(one.frames for one in figures) == 20_000
    assert [one.errors for one in figures if not one.recovered] == []
    assert sum(one.wrong + one.mixed + one.incomplete for one in figures) == 0
    assert max(one.ratio for one in figures) <= 1.1


def test_drawn_rigs_of_every_day() -> None:
    figures = [run_setting(drawn_setting(np.random.default_rng(seed)), 60, seed) for seed in (100, 101)]
    assert all(one.recovered for one in figures)
    assert sum(one.wrong + one.mixed + one.incomplete for one in figures) == 0


def test_noise_and_late_arrivals_do_not_mislead() -> None:
    """Noise of 2 levels, arrivals 3 ms late in the mean, every tenth swap a refresh late."""
    found = measured(Setting(noise=2.0, transfer=0.003, late=0.1), seed=3)
    assert abs(found.errors["latency"]) < 5e-4
    assert max(abs(found.errors[name]) for name in ("rise", "fall", "shutter")) < 5e-4
    assert found.timing.jitter_s == pytest.approx(1 / 60, abs=1e-3)


@pytest.mark.parametrize(
    "setting",
    [
        Setting(behind=3),
        Setting(lost=0.2, incomplete=0.2, buffers=2),
        Setting(trigger="software", lost=0.02, incomplete=0.02),
        Setting(offset=-86400.0),
    ],
)
def test_stale_and_lost_images_cost_time_not_truth(setting: Setting) -> None:
    """Behind by three; a fifth lost, and half of what waits; triggered; a clock that began at power-up."""
    figure = run_setting(setting, 100, seed=1)
    assert figure.recovered
    assert (figure.wrong, figure.mixed, figure.incomplete, figure.frames) == (0, 0, 0, 100)


@pytest.mark.parametrize("setting", [Setting(noise=2.0), Setting(hiccup=0.1), Setting(hiccup=0.3, rate=30)])
def test_images_without_stamps_are_of_their_patterns(setting: Setting) -> None:
    """By [sync] of the same camera with stamps, with noise and with hiccups that hand out old images."""
    found = measured(setting, seed=5)
    time, rng, clock = found.time, np.random.default_rng(5), ClockMap()
    patterns, mute = codes(16, rng), replace(setting, stamped=False)
    display = SimulatedDisplay(mute, time, patterns, rng)
    camera = SimulatedCamera(mute, time, display, rng)
    camera.start()
    timing = replace(found.timing, latency_s=setting.delay + setting.exposure + setting.read_out)
    order = rng.integers(0, 16, 300)
    seen = list(acquire(display, camera, timing, order, time=time, clock=clock))
    off = [np.abs(one.image.pixels - (20 + 200 * patterns[one.index])).max() for one in seen]
    assert len(off) == 300
    assert max(off) < 2 + 5 * setting.noise


def test_a_camera_that_sees_nothing_or_gives_nothing() -> None:
    time, rng = SimulatedTime(), np.random.default_rng(0)
    dark = SimulatedDisplay(Setting(), time, np.full((2, 8), 0.5), rng)
    camera = SimulatedCamera(Setting(), time, dark, rng)
    camera.start()
    with pytest.raises(InputError, match=r"white is 0.0 levels above black"):
        synchronise(dark, camera, camera.configure(Wanted(0.01)), time=time, clock=ClockMap())
    camera = SimulatedCamera(Setting(lost=1.0), time, dark, rng)
    camera.start()
    with pytest.raises(InputError, match="no image of frame 1, shown 4 times"):
        list(acquire(dark, camera, None, [1], time=time, clock=ClockMap()))


def test_a_display_unlike_the_model_is_told() -> None:
    odd = Timing(0.01, 0, 0.005, 0.005, 0, 0.01, 1 / 60, 0.020, refresh_s=1 / 60, misfit=0.05)
    texts = [str(notice) for notice in sync_notices(odd)]
    assert "does not settle exponentially" in texts[0]
    assert "exposure_ms=33.333" in texts[1]
    assert sync_notices(Timing(0.01, 0, 0.005, 0.005, 0, 0.01, 1 / 60, 1 / 60, refresh_s=1 / 60)) == ()


def test_a_timing_holds_for_its_settings_and_survives_toml() -> None:
    timing = measured(Setting(), seed=5).timing
    assert Timing.from_table(timing.to_table(), "rig.toml: [sync]") == timing
    timing.require(Accepted(1 / 60, 32, 8))
    with pytest.raises(InputError, match="exposure_s"):
        timing.require(Accepted(1 / 30, 32, 8))
    for table, words in (
        ({"latency": 3}, r"rig.toml .*: unknown field 'latency'"),
        ({**timing.to_table(), "rise_s": "slow"}, "rise_s is 'slow', must be a number"),
        ({}, "latency_s is missing"),
    ):
        with pytest.raises(InputError, match=words):
            Timing.from_table(table, "rig.toml")


def test_clocks_that_drift_and_lie() -> None:
    """Two minutes, 80 ppm, arrivals up to 20 ms late: within 1 ms. A stamp that stands still: arrival."""
    clock, rng, late = ClockMap(), np.random.default_rng(6), []
    for k in range(7200):
        true = 100 + k / 60
        image = replace(_arrived(k, 0), device_s=true * (1 + 8e-5) - 50)
        image = replace(image, arrived_s=true + 0.01 + rng.exponential(0.005))
        late.append(clock.stamp(image).time_s - true)
    assert np.ptp(late[3600:]) < 1e-3
    assert np.abs(np.array(late) - 0.01).max() < 3.5e-3
    stuck = Image(np.zeros((1, 1), np.uint8), 0, 70.0, 300.0)
    assert not clock.stamp(stuck).trusted
    assert clock.stamp(stuck).time_s == 300.0
    assert clock.distrusted == 2


@pytest.mark.parametrize("offset", [-600.0, 1234.5])
@pytest.mark.parametrize("nonsense", [4154505010.2, 0.0, -3600.0])
def test_one_nonsense_stamp_is_distrusted(nonsense: float, offset: float) -> None:
    """At the start or later: one stamp, not the clock, whenever that began."""
    for odd in (0, 17):
        clock = ClockMap()
        for k in range(30):
            true = _arrived(k, offset)
            stamp = clock.stamp(replace(true, device_s=nonsense) if k == odd else true)
        assert (clock.distrusted, stamp.trusted) == (1, True)
        assert stamp.sigma_s < 1e-3
        assert stamp.time_s == pytest.approx(true.arrived_s, abs=1e-9)


def test_an_image_that_waited_long_is_no_new_one() -> None:
    """Suspended for 5 s: of the six that waited in the driver none may count as exposed after that."""
    clock = ClockMap()
    for k in range(60):
        clock.stamp(_arrived(k, 50.0))
    for k in range(60, 66):
        late = replace(_arrived(k, 50.0), arrived_s=100 + 60 / 30 + 5)
        stamp = clock.stamp(late)
        assert stamp.time_s - stamp.late_s == pytest.approx(_arrived(k, 50.0).arrived_s, abs=1e-6)


@pytest.mark.parametrize("by", [-60.0, 60.0])
def test_a_clock_that_is_set_is_followed(by: float) -> None:
    """One stamp counts by its arrival."""
    clock = ClockMap()
    for k in range(60):
        image = _arrived(k, 50.0 if k < 30 else 50.0 + by)
        stamp = clock.stamp(image)
        assert stamp.time_s == pytest.approx(image.arrived_s, abs=1e-9)
    assert (clock.distrusted, stamp.trusted) == (1, True)


def _arrived(k: int, offset: float) -> Image:
    """Image k of 30 a second, 30.5 ms after its exposure, stamped by a clock that is `offset` ahead."""
    return Image(np.zeros((1, 1), np.uint8), k, 100 + k / 30 + offset, 100.0305 + k / 30)


def test_a_rise_that_no_image_shows_has_the_sigma_of_its_range() -> None:
    """A loaded computer loses images. Here they show one fall alone, of a closed form, in 4 bands."""
    exposure, latency, fall, bands = 0.01, 0.03, 0.004, np.array([0.125, 0.375, 0.625, 0.875])
    stamps = 0.5 + np.arange(60) / 61.3

    def light(until: np.ndarray) -> np.ndarray:  # its integral, s; white until 1 s + latency
        dark = np.maximum(until - 1.0 - latency, 0.0)
        return np.asarray(until - dark + fall * -np.expm1(-dark / fall))

    starts = stamps[:, None] + 0.008 * bands
    noise = np.random.default_rng(0).normal(0, 0.002, starts.shape)
    brightness = (light(starts + exposure) - light(starts)) / exposure + noise
    swaps = np.array([-1.0, 1.0])
    taken = FlipRecord(stamps, 0.0, brightness, bands, swaps, np.array([1.0, 0.0]), np.full(60, 0.03), 0.0)
    timing = fit_timing(taken, Accepted(exposure), 1 / 60)
    assert timing.sigma_s is not None
    assert timing.sigma_s["rise"] == pytest.approx(0.2 / np.sqrt(12), rel=0.01)
    assert 0.3 < timing.ready_s() < 0.6
    assert any("Few images show how" in notice.name for notice in sync_notices(timing))
    for name, true, found in (("latency", latency, timing.latency_s), ("fall", fall, timing.fall_s)):
        assert abs(found - true) < 3 * timing.sigma_s[name] < 0.002
