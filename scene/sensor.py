"""How a display turns levels into light, and a sensor light into levels; without them: ideal and linear."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Any

import numpy as np

from optolever import InputError

from .fields import Float, Record, integer, non_negative, number, positive, vector

__all__ = ["MOSAICS", "Display", "Sensor"]

_share = partial(non_negative, below=1)
#: Colours of a mosaic's pixels (0, 0), (0, 1), (1, 0), (1, 1): row, column.
MOSAICS = ("RGGB", "GRBG", "GBRG", "BGGR")


def _mix(name: str, value: Any) -> Float:
    """(3, 3) shares of at least 0 that can be separated."""
    if not isinstance(value, list | tuple | np.ndarray) or len(value) != 3:
        raise InputError(f"{name} = {value!r}: must be three lists of three numbers")
    mix = np.stack([vector(f"{name}[{k}]", row) for k, row in enumerate(value)])
    if mix.min() < 0 or abs(np.linalg.det(mix)) < 1e-3:
        raise InputError(f"{name} = {mix.tolist()}: must not be negative, nor its rows nearly dependent")
    mix.flags.writeable = False
    return mix


def _gammas(name: str, value: Any) -> Float:
    """(3,) above 0."""
    gammas = vector(name, value)
    if gammas.min() <= 0:
        raise InputError(f"{name} = {gammas.tolist()}: must be above 0")
    return gammas


def _mosaic(name: str, value: Any) -> str:
    if value not in MOSAICS:
        raise InputError(f"{name} = {value!r}: must be one of {', '.join(MOSAICS)}")
    return str(value)


@dataclass(frozen=True, eq=False)
class Display(Record, section="display"):
    """Light of level g (0..255), relative to that of 255: black + (1 - black) (g/255)^gamma. gammas (3,): of
    red, green and blue in `capture_colour`; None: gamma of all."""

    gamma: Annotated[float, positive] = 1.0
    black: Annotated[float, _share] = 0.0
    gammas: Annotated[Float | None, _gammas] = None

    def channel(self, number: int) -> Display:
        """Of red, green or blue."""
        return self if self.gammas is None else replace(self, gamma=self.gammas[number], gammas=None)

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
    frame to frame; shutter_s: how long a frame is exposed (0: an instant). Of a colour camera mix (3, 3):
    share of the display's red, green and blue (columns) in the camera's (rows), for `capture_colour`; mosaic:
    one of MOSAICS, 2 x 2 of its pixels in each of the scene's camera; None: three values in every pixel.
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
    mix: Annotated[Float | None, _mix] = None
    mosaic: Annotated[str | None, _mosaic] = None

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
