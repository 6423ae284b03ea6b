"""The frames of a camera: unit, levels, white level, a sample of pixels; `Response`, inverted first."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from optolever.blocks import on_cores
from optolever.errors import InputError
from optolever.kernels import F32, F64, inlined, plain
from optolever.patterns import Sequence
from optolever.records import Comparable

from .correspondence import Correspondence

__all__ = [
    "Levels", "Light", "RawFrames", "RawLevel", "Response", "Settings", "in_levels", "level_of",
    "levels_of", "light_of", "raw_at", "sample_places",
]  # fmt: skip

#: A camera's level as it comes, and an array of them.
RawLevel = np.uint8 | np.uint16 | np.float32
RawFrames = NDArray[RawLevel]
#: Pixels of a run (a cache line of 8-bit frames).
_RUN = 64
#: The brightest float is scaled to this level up to twice as much: a power of two keeps every digit.
_BRIGHT = 128.0


@dataclass(frozen=True, slots=True, eq=False)
class Response(Comparable):
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
    def from_gamma(cls, gamma: float, white_level: float = 255.0, blur: float | None = None) -> Response:
        """`seen` = white_level (shown / 255)^gamma; blur: of a display's, see above; None: a camera's."""
        if not 0.1 <= gamma <= 10:
            raise InputError(f"response: gamma is {gamma}, must be in 0.1..10")
        shown = np.linspace(0.0, 1.0, 1025)
        return cls(255.0 * shown, white_level * shown**gamma, blur)

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
        if bright < 5.0:  # levels
            raise InputError(
                f"response: the brightest frame is {bright:.3g} levels above the darkest, no ramp"
            )
        lit = span >= 0.5 * bright
        whole, least = lit & (light[-1] < clip), 0.1
        if np.count_nonzero(whole) < least * np.count_nonzero(lit):
            share = 1 - np.count_nonzero(whole) / np.count_nonzero(lit)
            raise InputError(
                f"response: {share:.0%} of the pixels that see the display clip at {clip:g}, "
                f"must be {1 - least:.0%} at most; expose less"
            )
        relative = (light[:, whole] - light[0, whole]).sum(axis=1) / span[whole].sum()
        seen = np.median(light[0, whole]) + np.median(span[whole]) * relative
        return replace(cls.from_table([shown[i] for i in order], seen), blur=float("nan"))

    def light(self) -> F64:
        """Relative light (256,) of the levels 0..255: 0 at level 0, 1 at 255 (monotone cubics)."""
        curve = scipy.interpolate.PchipInterpolator(self.shown, self.seen, extrapolate=True)(np.arange(256.0))
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


@dataclass(frozen=True, slots=True)
class Settings:
    """Parameters of `decode` that the caller knows or chooses."""

    noise: float | None = None
    gain: float = 0.0
    white_level: float | None = None
    response: Response | None = None
    blur_px: float | None = None
    lens_px: float | None = None
    on_cells: bool = True

    @property
    def display(self) -> Response | None:
        """The response of a display, which the frames keep; a camera's is taken off them."""
        return None if self.response is None or self.response.blur is None else self.response

    @property
    def blur(self) -> float:
        """Known blur, pattern px; NaN: unknown."""
        known = self.blur_px if self.display is None or self.blur_px is not None else self.display.blur
        return float("nan") if known is None else known


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
    """Frames scaled for decoding, integers as uint16. InputError if no pixel is finite in all of them."""
    stack = np.asarray(frames)
    if stack.dtype.kind in "iu" and stack.size and stack.dtype not in (np.uint8, np.uint16):
        low, high = int(stack.min()), int(stack.max())
        if low < 0 or high > 65535:
            found = f"frames are {stack.dtype} from {low} to {high}"
            raise InputError(f"decode: {found}, must be 0 to 65535; take frames.astype(float)")
        stack = stack.astype(np.uint16)
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

    @property
    def numbers(self) -> tuple[NDArray[Any], F32 | None, np.float32]:
        """For kernels: raw levels, table (None: linear), clip."""
        return self.raw, self.table if len(self.table) else None, np.float32(min(self.clip, 1e9))

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
    """Check frames of in_levels() against their description. InputError if they do not fit.

    rounding: variance by rounding, if it and white_level are known of the camera; else all samples of 16-bit
    frames determine both.
    """
    stack = np.asarray(frames)
    if stack.ndim != 3 or 0 in stack.shape:
        cure = "projector.Capture.load(folder, sequence).frames reads files, and makes colours grey"
        raise InputError(f"decode: frames have shape {stack.shape}, must be (N, H, W); {cure}")
    if len(stack) != len(sequence):
        raise InputError(f"decode: {len(stack)} frames, sequence {sequence.name} describes {len(sequence)}")
    if white_level is not None and not white_level > 0:
        raise InputError(f"decode: white_level is {white_level}, must be above 0")
    if stack.dtype not in (np.uint8, np.uint16, np.float32):
        raise InputError(f"decode: frames are {stack.dtype}, must be uint8, uint16 or float")
    response = None if response is None or response.blur is not None else response  # a display's stays
    if response is not None and stack.dtype.kind != "u":
        raise InputError(f"decode: response is given and frames are {stack.dtype}, must be uint8 or uint16")
    table = np.zeros(0, np.float32) if response is None else response.table(stack.dtype)
    if rounding is None or white_level is None:
        step, found = levels_of(stack)
        white_level, rounding = white_level or found, step * step / 12
    return Light(plain(stack), float(white_level), table, rounding)


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


def raw_at(light: Light, places: NDArray[np.int64]) -> NDArray[Any]:
    """Raw levels (N, K) at places (K, 2)."""
    number = places @ (light.raw.shape[2], 1)
    return np.ascontiguousarray(light.raw.reshape(len(light.raw), -1).take(number, axis=1))


@inlined
def level_of(value: RawLevel, table: F32 | None) -> np.float32:
    """Linear level of one raw one."""
    if table is None:
        return np.float32(value)
    level: np.float32 = table[np.int64(value)]
    return level
