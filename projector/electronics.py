"""From light to digital numbers: exposure, flicker, camera response, shot and read noise, quantisation.

One function for both renderers. Noise is drawn row by row from generators seeded with (seed, frame, source),
so a capture is the same on every machine, however its rows are cut into strips and spread over threads.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from optolever.scene import Sensor

__all__ = ["NOMINAL_SENSOR", "WHITE_NOISE_SENSOR", "FrameElectronics", "flicker_factor"]

#: White noise alone (`noise` of `capture`): linear, dark at 16, white at 232.75: noise is not clipped.
WHITE_NOISE_SENSOR = Sensor(offset=16.0, exposure=0.85)
#: Of a scene that names none: 30 electrons a level and 6 of read noise, as of small machine vision cameras.
#: Its colours overlap by 10 to 14 %, as a display's and a camera's filters together.
NOMINAL_SENSOR = replace(
    WHITE_NOISE_SENSOR,
    gain_e=30.0,
    noise=0.2,
    mix=np.array([[0.86, 0.12, 0.02], [0.10, 0.80, 0.10], [0.02, 0.12, 0.86]]),
)

_SHOT, _READ = 0, 1
_FULL_SCALE = 255.0


def flicker_factor(sensor: Sensor, time: float) -> float:
    """Mean of 1 + flicker sin(2 pi f t) over the shutter around `time` (s)."""
    if sensor.flicker == 0.0:
        return 1.0
    smear = float(np.sinc(sensor.flicker_hz * sensor.shutter_s))
    return 1.0 + sensor.flicker * smear * float(np.sin(2.0 * np.pi * sensor.flicker_hz * time))


@dataclass(slots=True)
class FrameElectronics:
    """The electronics of one frame; takes its rows from the top down.

    gain: exposure of this frame, times flicker; noise: rms of the read noise in 8-bit levels.
    """

    sensor: Sensor
    gain: float
    noise: float
    bits: int
    _shot: np.random.Generator
    _read: np.random.Generator

    @classmethod
    def of_frame(
        cls, sensor: Sensor, gain: float, noise: float, bits: int, seed: int, frame: int
    ) -> "FrameElectronics":
        """Electronics of frame number `frame`, with that frame's noise."""
        shot, read = (np.random.default_rng([seed, frame, source]) for source in (_SHOT, _READ))
        return cls(sensor, gain, noise, bits, shot, read)

    def expose(self, light: NDArray[np.float32], out: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
        """Digital numbers of the next rows: relative light (R, W) >= 0 into out (R, W)."""
        level = self._response(light)
        if self.sensor.gain_e > 0.0:
            self._add_shot_noise(level)
        if self.noise > 0.0:
            level += self._read.standard_normal(level.shape, dtype=np.float32) * np.float32(self.noise)
        white = 2**self.bits - 1
        if white != _FULL_SCALE:
            level *= np.float32(white / _FULL_SCALE)
        level += np.float32(0.5)
        np.clip(level, 0.0, white + 0.5, out=level)
        np.minimum(level.astype(out.dtype), white, out=out)

    def _response(self, light: NDArray[np.float32]) -> NDArray[np.float32]:
        sensor = self.sensor
        level: NDArray[np.float32] = light * np.float32(sensor.exposure * self.gain)
        if sensor.gamma != 1.0:
            np.maximum(level, np.float32(0.0), out=level)  # rounding: no light may be a little less than none
            np.power(level, np.float32(1.0 / sensor.gamma), out=level)
        level *= np.float32(_FULL_SCALE)
        level += np.float32(sensor.offset)
        return level

    def _add_shot_noise(self, level: NDArray[np.float32]) -> None:
        """Poisson statistics of the photo-electrons; the offset comes after the photodiode and has none."""
        electrons = self.sensor.gain_e
        mean = np.maximum(level - np.float32(self.sensor.offset), 0.0).astype(np.float64) * electrons
        level[:] = self._shot.poisson(mean) / electrons + self.sensor.offset
