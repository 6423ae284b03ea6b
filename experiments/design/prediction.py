"""What a sequence is worth in a view before a frame is taken: the decoder itself, run on images of the view.

The images are those of the virtual sensor: its light (footprint, blur, reflectance, border, the display's
response), the sensor's levels, noise and rounding. Noise is drawn in pairs of opposite sign: half the
difference of two errors is what noise does, half their sum what it does not.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from optolever.decode import Correspondence, Flag, decode
from optolever.errors import InputError
from optolever.patterns import Sequence
from optolever.projector import light_of

from ..metrics import rms
from .view import Floats, Mask, View

__all__ = ["Prediction", "predict"]

#: Stated sigmas, and cells, beyond which an error is a wrong order or bit.
GROSS = 6.0, 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Draws of a sequence in a view, two by two of opposite noise. error, sigma (D, 2, H, W): of u and v and
    as the decoder states it, cells, 0 and inf where a pixel is refused; good (D, H, W): whether it is not;
    usable (H, W): pixels over which errors are taken."""

    error: Floats
    sigma: Floats
    good: Mask
    usable: Mask

    @property
    def failure(self) -> float:
        """Share of the usable pixels with a wrong order or bit that nobody flags."""
        far, cells = GROSS
        size = np.abs(self.error)
        gross = (size > cells) & (size > far * self.sigma)
        return float(np.asarray(gross.any(axis=1))[:, self.usable].mean())

    @property
    def measured_share(self) -> float:
        """Share of the usable pixels that pass the decoder's checks."""
        return float(self.good[:, self.usable].mean())

    @property
    def rms(self) -> float:
        """Of the errors over the usable pixels that are not refused, cells."""
        error = self.error.swapaxes(0, 1)[:, self.good & self.usable]
        return rms(error)


def predict(view: View, sequence: Sequence, noise: float, *, pairs: int = 1) -> Prediction:
    """`pairs` pairs of draws under Gaussian noise (rms, 8-bit levels) besides the sensor's own.

    InputError if the sequence does not fit the pattern, does not encode both axes or cannot be decoded.
    """
    _require_fit(view, sequence)
    decoded = list(_decoded(view, sequence, noise, pairs))

    def picked(name: str) -> Floats:
        return np.stack([np.asarray(getattr(one, name)).ravel()[view.pick] for one in decoded])

    # the seams between windows are edges that no scene has
    seams = int(Flag.WRONG_FRAME) if view.stride > 1 else 0
    at, sigma = (np.stack([picked(name + axis) for axis in "uv"], axis=1) for name in ("", "sigma_"))
    good = ((picked("flags").astype(np.int64) & ~seams) == 0) & view.visible & np.isfinite(at).all(axis=1)
    keep, error = good[:, None], at - view.centre[:, view.pick]
    return Prediction(np.where(keep, error, 0.0), np.where(keep, sigma, np.inf), good, view.usable)


def _require_fit(view: View, sequence: Sequence) -> None:
    pattern = view.scene.pattern
    if (sequence.rows, sequence.cols) != (pattern.rows, pattern.cols):
        raise InputError(
            f"sequence {sequence.name}: made for {sequence.rows}x{sequence.cols} cells, the pattern of scene "
            f"{view.scene.name!r} has {pattern.rows}x{pattern.cols}"
        )
    for axis in "uv":
        if all(frame.axis != axis for frame in sequence.frames):
            raise InputError(f"sequence {sequence.name}: no frame encodes {axis}; a height needs both axes")


def _decoded(view: View, sequence: Sequence, noise: float, pairs: int) -> Iterator[Correspondence]:
    """What the decoder makes of images of the view, two for every pair."""
    sensor, white = view.sensor, 2**view.sensor.bits - 1
    kind = np.uint8 if sensor.bits == 8 else np.uint16
    light = light_of(view.image, sequence, view.scene.display, view.scene.pattern.blur_px)
    exposure = np.array([frame.exposure for frame in sequence.frames])
    level = sensor.levels(np.maximum(light, 0.0) * exposure[:, None])
    shot = np.maximum(level - sensor.offset, 0.0) / sensor.gain_e if sensor.gain_e > 0 else 0.0
    scatter = np.sqrt(noise**2 + sensor.noise**2 + shot)
    mean, scatter = (np.asarray(part * (white / 255), np.float32) for part in (level, scatter))
    for seed in range(pairs):
        drawn = scatter * np.random.default_rng([seed, 11]).standard_normal(mean.shape, np.float32)
        for sign in (1, -1):
            raw = np.rint(mean + sign * drawn).clip(0, white).astype(kind)
            yield decode(raw.reshape(-1, *view.shape), sequence, white_level=white, check=False)
