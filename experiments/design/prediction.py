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

from .view import Floats, Mask, View

__all__ = ["BORDER", "Prediction", "predict"]

#: Light lost beyond the pattern's border from which on a pixel is left out of every figure.
BORDER = 0.01
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
    def passed(self) -> Floats:
        """Share of the draws (H, W) in which a pixel is not refused."""
        return np.asarray(self.good.mean(axis=0))

    def rms(self, axis: str) -> float:
        """Of the error along an axis over the usable pixels that are not refused, cells."""
        size = self.error[:, "uv".index(axis)][self.good & self.usable]
        return float(np.sqrt(np.mean(size**2))) if size.size else float("nan")

    def and_more(self, more: "Prediction") -> "Prediction":
        """With further draws of the same."""
        error, sigma, good = (
            np.concatenate([getattr(self, name), getattr(more, name)]) for name in ("error", "sigma", "good")
        )
        return Prediction(error, sigma, good, self.usable)


def predict(
    view: View, sequence: Sequence, noise: float, *, pairs: int = 1, first: int = 0, axes: str = "uv"
) -> Prediction:
    """`pairs` pairs of draws, from number `first` on, under Gaussian noise (rms, 8-bit levels) besides the
    sensor's own. axes: along which errors are predicted; of one, its frames alone are decoded.

    InputError if the sequence does not fit the pattern, does not encode the axes or cannot be decoded.
    """
    _require_fit(view, sequence, axes)
    part = Sequence(
        tuple(frame for frame in sequence.frames if frame.axis is None or frame.axis in axes),
        *(sequence.rows, sequence.cols),
    )
    usable = view.visible & (view.lost < BORDER)
    known = len(part) < len(sequence) or len(axes) == 1
    decoded = list(_decoded(view, part, noise, range(first, first + pairs), known))
    # the seams between windows are edges that no scene has
    seams = int(Flag.WRONG_FRAME) if view.stride > 1 else 0
    flags = np.stack([np.asarray(one.flags).ravel()[view.pick].astype(np.int64) & ~seams for one in decoded])
    good = (flags == 0) & view.visible
    error, sigma = (np.zeros((len(decoded), 2, *good.shape[1:])) for _ in "es")
    for axis in axes:
        k = "uv".index(axis)
        truth = view.centre[k][view.pick]
        at, stated = (
            np.stack([np.asarray(getattr(one, name)).ravel()[view.pick] for one in decoded])
            for name in (axis, f"sigma_{axis}")
        )
        good &= np.isfinite(at)
        error[:, k], sigma[:, k] = at - truth, stated
    keep = good[:, None]
    return Prediction(np.where(keep, error, 0.0), np.where(keep, sigma, np.inf), good, usable)


def _require_fit(view: View, sequence: Sequence, axes: str) -> None:
    pattern = view.scene.pattern
    if (sequence.rows, sequence.cols) != (pattern.rows, pattern.cols):
        raise InputError(
            f"sequence {sequence.name}: made for {sequence.rows}x{sequence.cols} cells, the pattern of scene "
            f"{view.scene.name!r} has {pattern.rows}x{pattern.cols}"
        )
    for axis in axes:
        if all(frame.axis != axis for frame in sequence.frames):
            raise InputError(f"sequence {sequence.name}: no frame encodes {axis}; a height needs both axes")


def _decoded(view: View, part: Sequence, noise: float, seeds: range, known: bool) -> Iterator[Correspondence]:
    """What the decoder makes of images of the view, two for every seed; known: it is given noise and
    blur, which it would otherwise estimate."""
    sensor, white = view.sensor, 2**view.sensor.bits - 1
    kind = np.uint8 if sensor.bits == 8 else np.uint16
    light = light_of(view.image, part, view.scene.display, view.scene.pattern.blur_px)
    exposure = np.array([frame.exposure for frame in part.frames])
    level = sensor.levels(np.maximum(light, 0.0) * exposure[:, None])
    read2, step = noise**2 + sensor.noise**2, 255 / white
    shot = np.maximum(level - sensor.offset, 0.0) / sensor.gain_e if sensor.gain_e > 0 else 0.0
    mean, scatter = (np.asarray(part / step, np.float32) for part in (level, np.sqrt(read2 + shot)))
    given = {"noise": np.sqrt(read2) / step, "gain": _gain(sensor.gain_e) / step} if known else {}
    blur = view.scene.pattern.blur_px if known else None
    for seed in seeds:
        drawn = scatter * np.random.default_rng([seed, 11]).standard_normal(mean.shape, np.float32)
        for sign in (1, -1):
            raw = np.rint(mean + sign * drawn).clip(0, white).astype(kind)
            yield decode(
                raw.reshape(-1, *view.shape), part, white_level=white, blur_px=blur, check=False, **given
            )


def _gain(electrons: float) -> float:
    """Variance of shot noise per level."""
    return 1 / electrons if electrons > 0 else 0.0
