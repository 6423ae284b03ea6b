"""What `synchronise` recovers of drawn settings, and what `acquire` then takes, in simulated time."""

from dataclasses import dataclass

import numpy as np

from optolever.camera import ClockMap, Timing, acquire, synchronise
from optolever.projector import Wanted

from .simulated import (
    BLACK,
    SETTINGS,
    SWING,
    Setting,
    SimulatedCamera,
    SimulatedDisplay,
    SimulatedTime,
    codes,
    drawn_setting,
)

__all__ = ["Measured", "SyncFigure", "measured", "run_setting", "run_sync"]

_PATTERNS = 64


@dataclass(frozen=True)
class SyncFigure:
    """Errors (s) of latency, rise, fall, shutter; images taken; of the wrong pattern, with more than one
    level of another one, not complete; time a frame over the setting's bound.
    """

    setting: Setting
    timing: Timing
    errors: dict[str, float]
    frames: int
    wrong: int
    mixed: int
    incomplete: int
    ratio: float

    @property
    def recovered(self) -> bool:
        """Within 0.5 ms and 3 %."""
        truth = {"rise": self.setting.rise, "fall": self.setting.fall, "shutter": abs(self.setting.shutter)}
        return all(abs(error) <= 0.0005 + 0.03 * truth.get(name, 0.0) for name, error in self.errors.items())


@dataclass(frozen=True)
class Measured:
    """What `synchronise` found, by how much (s) it is off, and the clocks of then."""

    timing: Timing
    errors: dict[str, float]
    clock: ClockMap
    time: SimulatedTime


def measured(setting: Setting, seed: int, rows: int = 32) -> Measured:
    """Synchronise with a camera of so many rows."""
    time, rng, clock = SimulatedTime(), np.random.default_rng(seed), ClockMap()
    display = SimulatedDisplay(setting, time, np.repeat([[0.0], [1.0]], 8, axis=1), rng)
    camera = SimulatedCamera(setting, time, display, rng, rows=rows)
    accepted = camera.configure(Wanted(setting.exposure))
    camera.start()
    triggered = setting.trigger == "software"
    timing, taken = synchronise(
        display, camera, accepted, time=time, clock=clock, seed=seed, triggered=triggered
    )
    middle = (taken.stamps_s[0] + taken.stamps_s[-1]) / 2
    mapped = clock.host(middle * (1 + setting.drift) + setting.offset)[0] - middle
    # rows of the simulation are exposed at row / (rows - 1), bands have their middles at (row + 1/2) / rows
    slope = setting.shutter * rows / (rows - 1)
    first = max(-setting.shutter, 0.0) - setting.shutter / (2 * (rows - 1))
    errors = {
        "latency": timing.latency_s - (setting.delay + mapped - first),
        "rise": timing.rise_s - setting.rise,
        "fall": timing.fall_s - setting.fall,
        "shutter": timing.shutter_s - slope,
    }
    return Measured(timing, errors, clock, time)


def run_setting(setting: Setting, frames: int, seed: int) -> SyncFigure:
    """Synchronise, then capture."""
    rng = np.random.default_rng(seed + 1000)
    found = measured(setting, seed)
    timing, clock, time = found.timing, found.clock, found.time
    patterns = codes(_PATTERNS, rng)
    display = SimulatedDisplay(setting, time, patterns, rng)
    camera = SimulatedCamera(setting, time, display, rng)
    camera.start()
    order = rng.integers(0, _PATTERNS, frames)
    begin, wrong, mixed, incomplete, count = time.now(), 0, 0, 0, 0
    expected = np.rint(BLACK + SWING * patterns)
    triggered = setting.trigger == "software"
    for taken in acquire(display, camera, timing, order, time=time, clock=clock, triggered=triggered):
        count += 1
        if not taken.image.complete:
            incomplete += 1
            continue
        off = np.abs(taken.image.pixels.astype(float) - expected[taken.index])
        mixed += bool(off.max() > 1)
        wrong += bool(off.max() > SWING / 2)
    ratio = (time.now() - begin) / count / setting.bound
    return SyncFigure(setting, timing, found.errors, count, wrong, mixed, incomplete, ratio)


def run_sync(frames: int, seed: int) -> list[SyncFigure]:
    """20 drawn settings that share `frames` images."""
    rng = np.random.default_rng(seed)
    settings = [drawn_setting(rng) for _ in range(SETTINGS)]
    return [run_setting(one, frames // SETTINGS, seed + k) for k, one in enumerate(settings)]
