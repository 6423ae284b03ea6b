"""Simulated frames under faults of display and light: lag (a share of the preceding frame), gamma, flicker,
blur.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.patterns import Frame, Sequence
from optolever.projector import NOMINAL_SENSOR, capture, capture_colour
from optolever.scene import Display, Scene, Sensor, Surface, Trace

from .user_patterns import UserImages

__all__ = ["Faults", "levels_of", "with_noise"]

Levels = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Faults:
    """Faults of display and light. lag: share of the preceding frame in each frame; gamma: of the display, in
    place of the scene's; flicker: relative amplitude of the light at 100 Hz; blur: rms, cells. None: the
    scene's value."""

    lag: float = 0.0
    gamma: float | None = None
    flicker: float | None = None
    blur: float | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.lag < 1:
            raise InputError(f"lag: {self.lag:g}, must be at least 0 and below 1")

    def on(self, scene: Scene) -> Scene:
        """The scene with these faults of display, blur and light."""
        if self.gamma is not None:
            scene = replace(scene, display=replace(scene.display or Display(), gamma=self.gamma))
        if self.flicker is not None:
            scene = replace(scene, sensor=replace(scene.sensor or NOMINAL_SENSOR, flicker=self.flicker))
        if self.blur is not None:
            scene = replace(scene, pattern=replace(scene.pattern, blur_px=self.blur))
        return scene


def levels_of(
    scene: Scene, surface: Surface, truth: Trace, pattern: Sequence | UserImages, lag: float, renderer: str
) -> Levels:
    """Levels (N, H, W), 0 to 255, of a mirror without noise, of a display with lag; in colour as of
    `capture_colour`, with the sequence's stripes."""
    quiet = replace(scene, sensor=replace(scene.sensor or NOMINAL_SENSOR, gain_e=0.0, noise=0.0))
    if isinstance(pattern, UserImages):
        levels = _image_levels(quiet, surface, truth, pattern, renderer)
    else:
        levels = _captured_levels(quiet, surface, pattern, renderer)
    if lag:
        for before, after in zip(levels[:-1].copy(), levels[1:], strict=True):
            after += np.float32(lag) * (before - after)
    return levels


def _captured_levels(scene: Scene, surface: Surface, pattern: Sequence, renderer: str) -> Levels:
    if pattern.packing is None:
        frames = capture(scene, surface, pattern, renderer=renderer, bits=16).frames
    else:
        stripes = pattern.packing.stripes
        known = None if stripes in ("none", "unknown") else stripes
        scene = replace(scene, pattern=replace(scene.pattern, stripes=known))
        frames = capture_colour(scene, surface, pattern, renderer=renderer, bits=16).images
    return frames.astype(np.float32) * np.float32(255 / (2**16 - 1))


def _image_levels(scene: Scene, surface: Surface, truth: Trace, pattern: UserImages, renderer: str) -> Levels:
    """Levels of a mirror that reflects images, from its white and its black frame: each pixel has the level
    of the blurred image at its coordinates, a point without a footprint."""
    rows, cols = pattern.levels.shape[1:]
    ends = Sequence((Frame("white"), Frame("black")), rows, cols)
    white, black = _captured_levels(scene, surface, ends, renderer)
    display = scene.display or Display()
    light = (display.light(pattern.levels.astype(np.float64)) - display.black) / (1 - display.black)
    at = np.where(truth.visible, [truth.v, truth.u], -10.0)
    levels = np.empty((len(pattern), *white.shape), np.float32)
    for level, image in zip(levels, light, strict=True):
        soft = scipy.ndimage.gaussian_filter(image, scene.pattern.blur_px)
        share = scipy.ndimage.map_coordinates(soft, at, order=1, mode="constant")
        level[:] = black + (white - black) * share
    return levels


def with_noise(levels: Levels, sensor: Sensor, noise: float, seed: int) -> NDArray[np.uint8]:
    """8-bit frames of levels 0 to 255 with the sensor's photon noise, as normal as that of 30 electrons and
    more is, and white noise (rms, levels)."""
    rng, frames = np.random.default_rng([seed, 7]), np.empty(levels.shape, np.uint8)
    for level, frame in zip(levels, frames, strict=True):
        light = np.maximum(level - np.float32(sensor.offset), 0)
        variance = (
            (light / np.float32(sensor.gain_e) if sensor.gain_e > 0 else 0) + noise**2 + sensor.noise**2
        )
        drawn = rng.standard_normal(level.shape, np.float32) * np.sqrt(variance, dtype=np.float32)
        frame[:] = np.clip(np.round(level + drawn), 0, 255)
    return frames
