"""Response of display and camera together: camera level against displayed level, inverted before decoding."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import PchipInterpolator

from optolever.blocks import on_cores
from optolever.errors import InputError
from optolever.kernels import F64
from optolever.patterns import Sequence

__all__ = ["Response", "levels_of"]

#: Least span of a ramp, levels; least share of unclipped pixels among those that receive the ramp brightly.
_HARDLY, _WHOLE = 5.0, 0.1


@dataclass(frozen=True, slots=True)
class Response:
    """Camera levels `seen` (K,) where levels `shown` (K,) were displayed; both rise strictly with each other.

    Between the entries the inverse is linear. Beyond them it continues with the slope of the last pair, or
    the mean slope if that is less: at dark levels a camera may be almost flat, and its inverse too steep.
    blur: rms, cells, of the light between a nonlinear display and a linear camera (NaN: unknown); None: the
    nonlinearity follows the blur, in the camera.
    """

    shown: F64
    seen: F64
    blur: float | None = None

    def __post_init__(self) -> None:
        for name in ("shown", "seen"):
            values = np.asarray(getattr(self, name), np.float64)
            if values.ndim != 1 or len(values) < 2 or len(values) != len(np.asarray(self.shown)):
                raise InputError(f"response: {name} has shape {values.shape}, must be (K,), K >= 2, as shown")
            if not np.all(np.isfinite(values)) or not np.all(np.diff(values) > 0):
                raise InputError(f"response: {name} must be finite and rise strictly")
            object.__setattr__(self, name, values)
        if self.blur is not None and self.blur < 0:
            raise InputError(f"response: blur is {self.blur}, must be at least 0")

    @classmethod
    def from_table(cls, shown: ArrayLike, seen: ArrayLike) -> Response:
        """From a measured table in any order; entries where the camera's level does not rise are dropped."""
        pairs = np.array([np.asarray(shown, np.float64).ravel(), np.asarray(seen, np.float64).ravel()])
        if not np.all(np.isfinite(pairs)):
            raise InputError("response: table holds values that are not finite")
        pairs = pairs[:, np.argsort(pairs[0], kind="stable")]
        rising = pairs[1] > np.concatenate([[-np.inf], np.maximum.accumulate(pairs[1])[:-1]])
        rising &= np.concatenate([[True], np.diff(pairs[0]) > 0])
        return cls(pairs[0, rising], pairs[1, rising])

    @classmethod
    def from_gamma(cls, gamma: float, white_level: float = 255.0) -> Response:
        """`seen` = white_level (shown / 255)^gamma."""
        if not 0.1 <= gamma <= 10:
            raise InputError(f"response: gamma is {gamma}, must be in 0.1..10")
        shown = np.linspace(0.0, 1.0, 1025)
        return cls(255.0 * shown, white_level * shown**gamma)

    @classmethod
    def from_ramp(cls, frames: ArrayLike, sequence: Sequence) -> Response:
        """Of a display, from the uniform frames of a capture ("ramp"): mean over the brightest pixels.

        A pixel is normalised by its span between the darkest and the brightest level; pixels that clip at the
        brightest level are excluded.
        """
        stack = np.asarray(frames)
        if stack.ndim != 3 or len(stack) != len(sequence):
            raise InputError(
                f"response: frames have shape {stack.shape}, sequence describes {len(sequence)} images"
            )
        level = {"white": 255, "black": 0}
        shown = {
            i: level.get(frame.kind, frame.level or 0)
            for i, frame in enumerate(sequence.frames)
            if frame.kind in ("white", "black", "uniform")
        }
        if len(set(shown.values())) < 3:
            raise InputError(
                f"response: sequence {sequence.name} shows {len(shown)} levels, must show 3 or more"
            )
        order = sorted(shown, key=lambda i: shown[i])
        _, rows, cols = stack.shape
        light = stack[order, :: max(1, rows // 128), :: max(1, cols // 128)].reshape(len(order), -1)
        light = light.astype(np.float64)
        span, clip = light[-1] - light[0], levels_of(stack)[1]
        bright = float(np.percentile(span, 95))
        if bright < _HARDLY:
            raise InputError(
                f"response: the brightest frame is {bright:.3g} levels above the darkest, no ramp"
            )
        lit = span >= 0.5 * bright
        whole = lit & (light[-1] < clip)
        if np.count_nonzero(whole) < _WHOLE * np.count_nonzero(lit):
            share = 1 - np.count_nonzero(whole) / np.count_nonzero(lit)
            raise InputError(
                f"response: {share:.0%} of the pixels that see the display clip at {clip:g}, "
                f"must be {1 - _WHOLE:.0%} at most; expose less"
            )
        relative = (light[:, whole] - light[0, whole]).sum(axis=1) / span[whole].sum()
        seen = np.median(light[0, whole]) + np.median(span[whole]) * relative
        return replace(cls.from_table([shown[i] for i in order], seen), blur=float("nan"))

    def light(self) -> F64:
        """Relative light (256,) of the levels 0..255: 0 at level 0, 1 at 255 (monotone cubics)."""
        curve = PchipInterpolator(self.shown, self.seen, extrapolate=True)(np.arange(256.0))
        return np.asarray(np.clip((curve - curve[0]) / (curve[-1] - curve[0]), 0, 1))

    def shown_of(self, seen: ArrayLike) -> F64:
        """Displayed level for a camera level `seen`."""
        value, steepest = np.asarray(seen, np.float64), np.ptp(self.shown) / np.ptp(self.seen)
        slope = np.minimum(np.diff(self.shown)[[0, -1]] / np.diff(self.seen)[[0, -1]], steepest)
        below, above = np.minimum(value - self.seen[0], 0), np.maximum(value - self.seen[-1], 0)
        inside = np.interp(value, self.seen, self.shown)
        return np.asarray(inside + slope[0] * below + slope[1] * above)

    def table(self, dtype: np.dtype[Any]) -> NDArray[np.float32]:
        """Displayed level for every raw level of an unsigned integer type."""
        return self.shown_of(np.arange(np.iinfo(dtype).max + 1)).astype(np.float32)


def levels_of(stack: NDArray[Any]) -> tuple[int, float]:
    """Step of integer levels (0: not integer), and the largest level: 255, or that of the fewest bits that
    hold all samples of 16-bit frames; if a camera uses the upper bits of 16, the lower ones are 0."""
    if stack.dtype == np.uint8:
        return 1, 255.0
    if stack.dtype.kind == "f":
        return 0, float("inf")
    used = int(np.bitwise_or.reduce(on_cores(_bits_used, list(stack))))
    step = min(used & -used, 256) if used > 16383 else 1  # at least 8 bits
    return step, float(next(level for level in (255, 1023, 4095, 16383, 65536 - step) if level >= used))


def _bits_used(frame: NDArray[np.uint16]) -> int:
    return int(np.bitwise_or.reduce(frame, axis=None))
