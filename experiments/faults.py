"""Faults of display and light: lag (a share of the preceding frame), gamma, flicker, blur."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.patterns import Sequence
from optolever.projector import NOMINAL_SENSOR, capture
from optolever.scene import Display, Scene, Sensor, Surface

__all__ = ["Faults", "frames_of", "with_noise", "without_noise"]

_FINE = 16  # bits of frames that are mixed before the camera rounds them


@dataclass(frozen=True, slots=True)
class Faults:
    """lag: share of the preceding frame in each frame; gamma: of the display, in place of the scene's;
    flicker: relative amplitude of the light at 100 Hz; blur: rms, cells. None: the scene's value."""

    lag: float = 0.0
    gamma: float | None = None
    flicker: float | None = None
    blur: float | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.lag < 1:
            raise InputError(f"lag: {self.lag:g}, must be at least 0 and below 1")

    def __str__(self) -> str:
        known = {name: getattr(self, name) for name in ("lag", "gamma", "flicker", "blur")}
        return ", ".join(f"{name} {value:g}" for name, value in known.items() if value)

    def on(self, scene: Scene) -> Scene:
        """The scene with these faults of display, blur and light."""
        if self.gamma is not None:
            scene = replace(scene, display=replace(scene.display or Display(), gamma=self.gamma))
        if self.flicker is not None:
            scene = replace(scene, sensor=replace(scene.sensor or NOMINAL_SENSOR, flicker=self.flicker))
        if self.blur is not None:
            scene = replace(scene, pattern=replace(scene.pattern, blur_px=self.blur))
        return scene


def frames_of(
    scene: Scene, surface: Surface, shown: Sequence, lag: float, noise: float, seed: int, renderer: str
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Frames (N, H, W) with noise (8-bit levels) of a display with lag."""
    if not lag:
        return capture(scene, surface, shown, renderer=renderer, noise=noise, seed=seed).frames
    sensor = scene.sensor or NOMINAL_SENSOR
    own = capture(without_noise(scene), surface, shown, renderer=renderer, seed=seed, bits=_FINE).frames
    levels = own.astype(np.float32) * (255.0 / (2**_FINE - 1))
    for before, after in zip(levels[:-1].copy(), levels[1:], strict=True):
        after += np.float32(lag) * (before - after)
    return with_noise(levels, sensor, noise, seed)


def without_noise(scene: Scene) -> Scene:
    """The scene with a sensor that has no noise."""
    return replace(scene, sensor=replace(scene.sensor or NOMINAL_SENSOR, gain_e=0.0, noise=0.0))


def with_noise(levels: NDArray[np.float32], sensor: Sensor, noise: float, seed: int) -> NDArray[np.uint8]:
    """8-bit frames of levels 0 to 255 with the sensor's noise and white noise (rms, levels)."""
    rng, gain = np.random.default_rng([seed, 7]), sensor.gain_e
    if gain > 0:
        light = np.maximum(levels - np.float32(sensor.offset), 0)
        levels = np.float32(sensor.offset) + (rng.poisson(gain * light) / gain).astype(np.float32)
    drawn = np.float32(np.hypot(noise, sensor.noise)) * rng.standard_normal(levels.shape, np.float32)
    return np.asarray(np.clip(np.round(levels + drawn), 0, 255), np.uint8)
