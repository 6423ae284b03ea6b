"""How a display turns levels into light, and a sensor light into levels; without them: ideal and linear."""

from dataclasses import dataclass

import numpy as np

from optolever import InputError

from .record import Float, Record, freeze, integer, number, positive

__all__ = ["Display", "Sensor"]


@dataclass(frozen=True, eq=False)
class Display(Record):
    """Light of level g (0..255), relative to that of 255: black + (1 - black) (g/255)^gamma."""

    gamma: float = 1.0
    black: float = 0.0

    def __post_init__(self) -> None:
        freeze(self, gamma=positive("display.gamma", self.gamma))
        freeze(self, black=positive("display.black", self.black, zero=True, below=1))

    def light(self, levels: Float) -> Float:
        """Relative light of levels 0..255 (any shape)."""
        light: Float = self.black + (1 - self.black) * (np.asarray(levels, np.float64) / 255) ** self.gamma
        return light


@dataclass(frozen=True, eq=False)
class Sensor(Record):
    """How light becomes levels (8-bit levels throughout). Light 1: a pixel fully lit, fully reflected.

    level = offset + 255 (exposure light)^(1/gamma), clipped to 0..255, rounded to `bits` bits (255 becomes
    2^bits - 1). noise: standard deviation of the read noise in levels; gain_e: electrons per level, for shot
    noise (0: none); flicker: relative amplitude of the light's oscillation at flicker_hz; frame_s: time from
    frame to frame; shutter_s: how long a frame is exposed (0: an instant).
    """

    bits: int = 8
    noise: float = 0.0
    gain_e: float = 0.0
    gamma: float = 1.0
    exposure: float = 1.0
    offset: float = 0.0
    flicker: float = 0.0
    flicker_hz: float = 100.0
    frame_s: float = 1 / 60
    shutter_s: float = 0.0

    def __post_init__(self) -> None:
        freeze(self, bits=integer("sensor.bits", self.bits, 8, 16))
        for name, most in (("gamma", 100), ("exposure", 1e9), ("flicker_hz", 1e12), ("frame_s", 1e9)):
            freeze(self, **{name: positive(f"sensor.{name}", getattr(self, name), below=most)})
        for name in ("noise", "gain_e", "shutter_s"):
            freeze(self, **{name: positive(f"sensor.{name}", getattr(self, name), zero=True, below=1e9)})
        freeze(self, flicker=positive("sensor.flicker", self.flicker, zero=True, below=1))
        freeze(self, offset=number("sensor.offset", self.offset))
        if self.shutter_s > self.frame_s:
            raise InputError(
                f"sensor.shutter_s = {self.shutter_s:g}: must be at most frame_s = {self.frame_s:g}"
            )

    def levels(self, light: Float) -> Float:
        """Noise-free, unrounded 8-bit levels of relative light (any shape), not clipped."""
        level: Float = self.offset + 255 * (self.exposure * np.asarray(light, np.float64)) ** (1 / self.gamma)
        return level
