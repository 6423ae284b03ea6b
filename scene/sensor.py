"""How a display turns levels into light, and a sensor light into levels; without them: ideal and linear."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Annotated

import numpy as np

from optolever import InputError

from .fields import Float, Record, integer, non_negative, number, positive

__all__ = ["Display", "Sensor"]

_share = partial(non_negative, below=1)


@dataclass(frozen=True, eq=False)
class Display(Record, section="display"):
    """Light of level g (0..255), relative to that of 255: black + (1 - black) (g/255)^gamma."""

    gamma: Annotated[float, positive] = 1.0
    black: Annotated[float, _share] = 0.0

    def light(self, levels: Float) -> Float:
        """Relative light of levels 0..255 (any shape)."""
        light: Float = self.black + (1 - self.black) * (np.asarray(levels, np.float64) / 255) ** self.gamma
        return light


@dataclass(frozen=True, eq=False)
class Sensor(Record, section="sensor"):
    """How light becomes levels (8-bit levels throughout). Light 1: a pixel fully lit, fully reflected.

    level = offset + 255 (exposure light)^(1/gamma), clipped to 0..255, rounded to `bits` bits (255 becomes
    2^bits - 1). noise: standard deviation of the read noise in levels; gain_e: electrons per level, for shot
    noise (0: none); flicker: relative amplitude of the light's oscillation at flicker_hz; frame_s: time from
    frame to frame; shutter_s: how long a frame is exposed (0: an instant).
    """

    bits: Annotated[int, partial(integer, least=8, most=16)] = 8
    noise: Annotated[float, non_negative] = 0.0
    gain_e: Annotated[float, non_negative] = 0.0
    gamma: Annotated[float, partial(positive, below=100)] = 1.0
    exposure: Annotated[float, positive] = 1.0
    offset: Annotated[float, number] = 0.0
    flicker: Annotated[float, _share] = 0.0
    flicker_hz: Annotated[float, positive] = 100.0
    frame_s: Annotated[float, positive] = 1 / 60
    shutter_s: Annotated[float, non_negative] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.shutter_s > self.frame_s:
            raise InputError(
                f"sensor.shutter_s = {self.shutter_s:g}: must be at most frame_s = {self.frame_s:g}"
            )

    def levels(self, light: Float) -> Float:
        """Noise-free, unrounded 8-bit levels of relative light (any shape), not clipped."""
        level: Float = self.offset + 255 * (self.exposure * np.asarray(light, np.float64)) ** (1 / self.gamma)
        return level
