"""The camera's frames: validated, their white level and response, and a sample of pixels from all over
them."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optolever.errors import InputError
from optolever.kernels import Real, inlined
from optolever.patterns import Sequence

from .response import Response, levels_of

__all__ = [
    "KernelLight",
    "Light",
    "RawFrames",
    "RawLevel",
    "level_of",
    "light_of",
    "sample_levels",
    "sample_places",
    "variance_of",
]

F32 = NDArray[np.float32]
#: A camera's level as it comes, and an array of them.
RawLevel = np.uint8 | np.uint16 | np.float32
RawFrames = NDArray[RawLevel]
#: `Light` for kernels, see `Light.numbers`.
KernelLight = tuple[RawFrames, F32 | None, F32 | None, tuple[np.float32, np.float32]]
#: Pixels of a run (a cache line of 8-bit frames).
_RUN = 64


@dataclass(frozen=True, slots=True)
class Light:
    """Frames (N, H, W) uint8, uint16 or float32 and the tables that linearise their levels.

    clip    raw level from which on a sample is saturated
    table   linear level of every raw one, float32; empty: levels are linear
    rounding  variance by rounding to integer raw levels, levels^2
    response  inverted by the table; by raw level, empty if constant:
    spread  variance of the linear level, levels^2; steep: its ratio to the variance of the raw level
    """

    raw: NDArray[Any]
    clip: float
    table: F32
    rounding: float
    response: Response | None = None
    spread: F32 = field(default_factory=lambda: np.zeros(0, np.float32))
    steep: F32 = field(default_factory=lambda: np.zeros(0, np.float32))

    @property
    def white(self) -> float:
        """The linear level at which samples saturate."""
        return float(self.table[min(int(self.clip), len(self.table) - 1)]) if len(self.table) else self.clip

    def numbers(self) -> KernelLight:
        """Kernel argument `light`: raw, table and spread (None where empty), raw and linear saturation
        levels."""
        clip, white = (np.float32(min(level, 1e9)) for level in (self.clip, self.white))
        table, spread = (one if len(one) else None for one in (self.table, self.spread))
        return self.raw, table, spread, (clip, white)

    def under(self, read2: float, gain: float) -> "Light":
        """Add the spread of a response for a camera whose noise variance is read2 + gain * raw level."""
        if self.response is None:
            return self
        variance = read2 + gain * np.arange(len(self.table), dtype=np.float64)
        spread = self.response.spread(variance)
        return replace(self, spread=spread, steep=(spread / variance).astype(np.float32))

    def only(self, index: NDArray[np.int64]) -> "Light":
        """Some of the frames."""
        if np.array_equal(index, np.arange(len(self.raw))):
            return self
        return replace(self, raw=np.ascontiguousarray(self.raw[index]))

    def linear(self, raw: NDArray[Any]) -> F32:
        """Linear levels of some raw ones, float32."""
        return self.table[raw] if len(self.table) else raw.astype(np.float32)


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
        stack = _finite(stack)
    elif stack.dtype not in (np.uint8, np.uint16):
        raise InputError(f"decode: frames are {stack.dtype}, must be uint8, uint16 or float")
    if response is not None and stack.dtype.kind != "u":
        raise InputError(f"decode: response is given and frames are {stack.dtype}, must be uint8 or uint16")
    table = np.zeros(0, np.float32) if response is None else response.table(stack.dtype)
    if rounding is None or white_level is None:
        step, found = levels_of(stack)
        white_level, rounding = white_level or found, step * step / 12
    return Light(np.ascontiguousarray(stack), float(white_level), table, rounding, response)


def _finite(stack: NDArray[Any]) -> F32:
    bad = np.flatnonzero(~np.isfinite(stack).all(axis=(1, 2)))
    if len(bad):
        raise InputError(f"decode: frame {bad[0]} holds values that are not finite")
    return stack.astype(np.float32)


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
    raw = light.raw.reshape(len(light.raw), -1).take(number, axis=1)
    return np.where(raw >= light.clip, np.float32(np.nan), light.linear(raw))


@inlined
def variance_of(value: RawLevel, spread: F32 | None, more: Real) -> Real:
    """Variance of a linear level by the raw one, and more; 1 where all have the same."""
    if spread is None:
        return 1.0
    own: np.float32 = spread[np.int64(value)]
    return own + more


@inlined
def level_of(value: RawLevel, table: F32 | None) -> np.float32:
    """Linear level of one raw one."""
    if table is None:
        return np.float32(value)
    level: np.float32 = table[np.int64(value)]
    return level
