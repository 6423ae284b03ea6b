"""The camera's frames: unit, levels, white level, response inverted, and a sample of pixels from all over
them."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optolever.errors import InputError
from optolever.kernels import F32, inlined
from optolever.patterns import Sequence

from .records import Correspondence
from .response import Response, levels_of

__all__ = [
    "Levels",
    "Light",
    "RawFrames",
    "RawLevel",
    "in_levels",
    "level_of",
    "light_of",
    "sample_levels",
    "sample_places",
]

#: A camera's level as it comes, and an array of them.
RawLevel = np.uint8 | np.uint16 | np.float32
RawFrames = NDArray[RawLevel]
#: Pixels of a run (a cache line of 8-bit frames).
_RUN = 64
#: The brightest float is scaled to this level up to twice as much: a power of two keeps every digit.
_BRIGHT = 128.0


@dataclass(frozen=True, slots=True, eq=False)
class Levels:
    """frames (N, H, W), floats scaled to levels of 8 bits, so that no result depends on their unit; lost (H,
    W): pixels that are not finite in some frame, or None; unit: levels per unit of the given frames."""

    frames: NDArray[Any]
    lost: NDArray[np.bool_] | None = None
    unit: float = 1.0

    def inside(self, mask: ArrayLike | None) -> ArrayLike | None:
        """A mask (H, W) without the lost pixels; unchanged if there are none, or if it does not fit."""
        if self.lost is None or mask is None:
            return mask if self.lost is None else ~self.lost
        pixels = np.asarray(mask)
        fits = pixels.dtype == np.bool_ and pixels.shape == self.lost.shape
        return pixels & ~self.lost if fits else mask

    def restored(self, found: Correspondence) -> Correspondence:
        """Amplitude and offset in the unit of the given frames."""
        if self.unit == 1:
            return found
        light = {name: getattr(found, name) / np.float32(self.unit) for name in ("amplitude", "offset")}
        return replace(found, **light)


def in_levels(frames: ArrayLike) -> Levels:
    """Frames scaled for decoding. InputError if no pixel is finite in all of them."""
    stack = np.asarray(frames)
    if stack.dtype.kind != "f" or stack.ndim != 3 or 0 in stack.shape:
        return Levels(stack)
    finite = np.isfinite(stack).all(axis=0)
    if not finite.any():
        raise InputError("decode: no pixel is finite in every frame, must be light")
    stack = np.where(finite, stack, 0.0).astype(np.float64)
    most = float(np.abs(stack).max())
    exponent = np.frexp(most / _BRIGHT)[1] - 1 if most > 0 else 0
    unit = float(np.ldexp(1.0, -int(exponent)))
    return Levels((stack * unit).astype(np.float32), None if finite.all() else ~finite, unit)


@dataclass(frozen=True, slots=True, eq=False)
class Light:
    """Frames (N, H, W) uint8, uint16 or float32.

    clip      raw level from which on a sample is saturated
    table     linear level of every raw one, float32, by the inverse response; empty: levels are linear
    rounding  variance by rounding to integer raw levels, levels^2
    """

    raw: NDArray[Any]
    clip: float
    table: F32
    rounding: float

    @property
    def white(self) -> float:
        """The linear level at which samples saturate."""
        return float(self.table[min(int(self.clip), len(self.table) - 1)]) if len(self.table) else self.clip

    def linear(self, raw: NDArray[Any]) -> F32:
        """Linear levels of some raw ones, float32; saturated ones are NaN."""
        level = self.table[raw] if len(self.table) else raw.astype(np.float32)
        return np.where(raw >= self.clip, np.float32(np.nan), level)


def light_of(
    frames: ArrayLike,
    sequence: Sequence,
    white_level: float | None = None,
    response: Response | None = None,
    rounding: float | None = None,
) -> Light:
    """Check frames against their description. InputError if they do not fit or are not finite.

    rounding: variance by rounding, if it and white_level are known of the camera; else all samples of 16-bit
    frames determine both.
    """
    stack = np.asarray(frames)
    if stack.ndim != 3 or 0 in stack.shape:
        raise InputError(f"decode: frames have shape {stack.shape}, must be (N, H, W)")
    if len(stack) != len(sequence):
        raise InputError(f"decode: {len(stack)} frames, sequence {sequence.name} describes {len(sequence)}")
    if white_level is not None and not white_level > 0:
        raise InputError(f"decode: white_level is {white_level}, must be above 0")
    if stack.dtype.kind == "f":
        bad = np.flatnonzero(~np.isfinite(stack).all(axis=(1, 2)))
        if len(bad):
            raise InputError(f"decode: frame {bad[0]} holds values that are not finite")
        stack = stack.astype(np.float32)
    elif stack.dtype not in (np.uint8, np.uint16):
        raise InputError(f"decode: frames are {stack.dtype}, must be uint8, uint16 or float")
    if response is not None and stack.dtype.kind != "u":
        raise InputError(f"decode: response is given and frames are {stack.dtype}, must be uint8 or uint16")
    table = np.zeros(0, np.float32) if response is None else response.table(stack.dtype)
    if rounding is None or white_level is None:
        step, found = levels_of(stack)
        white_level, rounding = white_level or found, step * step / 12
    return Light(np.ascontiguousarray(stack), float(white_level), table, rounding)


def sample_places(shape: tuple[int, int], runs: int) -> NDArray[np.int64]:
    """Row and column (K, 2) of pixels in runs along rows, evenly spread over an image (golden-ratio lattice);
    all pixels of a small image."""
    rows, cols = shape
    if rows * cols <= runs * _RUN:
        return np.stack(np.divmod(np.arange(rows * cols), cols), axis=1)
    length = min(_RUN, cols)
    number = np.arange(runs * _RUN // length)
    row = ((number + 0.5) / len(number) * rows).astype(np.int64)
    first = (np.mod(number * 0.6180339887498949, 1.0) * (cols - length + 1)).astype(np.int64)
    across = first[:, None] + np.arange(length)
    return np.stack([np.repeat(row, length), across.ravel()], axis=1)


def sample_levels(light: Light, places: NDArray[np.int64]) -> F32:
    """Linear levels (N, K) at places (K, 2); saturated samples are NaN."""
    number = np.ravel_multi_index(tuple(places.T), light.raw.shape[1:])
    return light.linear(light.raw.reshape(len(light.raw), -1).take(number, axis=1))


@inlined
def level_of(value: RawLevel, table: F32 | None) -> np.float32:
    """Linear level of one raw one."""
    if table is None:
        return np.float32(value)
    level: np.float32 = table[np.int64(value)]
    return level
