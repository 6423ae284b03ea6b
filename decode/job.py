"""What is decoded: frames, checked; the camera's response, clip level and noise."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optolever.blocks import on_cores
from optolever.errors import InputError
from optolever.patterns import Sequence

from .bits import bit_edges
from .noise import QUANTISATION, Noise, estimate_noise
from .plan import Plan
from .records import Edges
from .response import Response
from .sample import Sample, sampled
from .table_decoder import by_table

__all__ = ["Job", "check_camera", "checked", "clip_level", "job_of", "levels_of"]

#: Sigma that is stated for frames without noise beyond their rounding, pattern pixels.
FLOOR = 0.01
Frames = NDArray[Any]


@dataclass(frozen=True, slots=True)
class Job:
    """What is the same for all rows.

    frames (N, H, W), which clip at `clip`; lut: linear level of each raw one, slope: its slope, both empty if
    levels are linear (slope also unless samples are weighed); noise: of fringes, raw_noise: of codes; floor:
    of sigma, pattern pixels; light, bright: linear frames and their clip level for what takes no lut; told:
    the noise, if the caller knows it; sample: of the frames; edges: of each axis's bits.
    """

    frames: Frames
    lut: NDArray[np.float32]
    slope: NDArray[np.float32]
    clip: float
    noise: Noise
    raw_noise: Noise
    floor: float
    light: Frames
    bright: float
    told: Noise | None
    sample: Sample
    edges: dict[str, Edges]


def checked(frames: ArrayLike, sequence: Sequence) -> Frames:
    """The frames as an array (N, H, W), contiguous. InputError if they do not fit the sequence."""
    stack = np.asarray(frames)
    if stack.ndim != 3 or 0 in stack.shape:
        raise InputError(f"decode: frames have shape {stack.shape}, must be (N, H, W)")
    if len(stack) != len(sequence):
        raise InputError(f"decode: {len(stack)} frames, sequence {sequence.name} describes {len(sequence)}")
    if stack.dtype.kind == "f":
        if not np.isfinite(stack).all():
            bad = int(np.flatnonzero(~np.isfinite(stack).all(axis=(1, 2)))[0])
            raise InputError(f"decode: frame {bad} holds values that are not finite")
        return stack.astype(np.float32)
    if stack.dtype not in (np.uint8, np.uint16):
        raise InputError(f"decode: frames are {stack.dtype}, must be uint8, uint16 or float")
    return np.ascontiguousarray(stack)


def check_camera(noise: float | None, gain: float, white_level: float | None) -> None:
    """InputError if what is said of the camera cannot be."""
    for name, value in (("noise", noise), ("gain", gain)):
        if value is not None and not 0 <= value < np.inf:
            raise InputError(f"decode: {name} is {value}, must be finite and at least 0")
    if white_level is not None and not white_level > 0:
        raise InputError(f"decode: white_level is {white_level}, must be above 0")


def levels_of(stack: Frames, response: Response | None) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Linear level of each raw one, and the slope of that; both empty: levels are linear."""
    if response is None:
        return np.zeros(0, np.float32), np.zeros(0, np.float32)
    if stack.dtype.kind != "u":
        raise InputError(f"decode: response is given and frames are {stack.dtype}, must be uint8 or uint16")
    return response.table(stack.dtype), response.slope()


def job_of(
    stack: Frames,
    wanted: Plan,
    noise: float | None,
    gain: float,
    clip: float,
    response: Response | None,
    weigh_samples: bool,
    subpixel: bool,
) -> Job:
    """What decode was told of frames (N, H, W), or what they tell of the camera themselves."""
    lut, slope = levels_of(stack, response)
    sample = sampled(stack)
    none = np.zeros(0, np.float32)
    if response is not None:
        raw = estimate_noise(stack, sample, lut, clip, wanted, slope)
        known = raw if weigh_samples else estimate_noise(stack, sample, lut, clip, wanted, none)
    elif noise is None:
        raw = known = estimate_noise(stack, sample, lut, clip, wanted, none)
    else:
        raw = known = Noise(noise**2 + (QUANTISATION if stack.dtype.kind == "u" else 0.0), gain)
    silent = raw.read2 < 1.5 * QUANTISATION  # as a rule, all there is to ask
    silent = silent and raw.variance(float(sample.runs[:, ::8].mean())) < 1.5 * QUANTISATION
    light, bright = stack, clip
    no_lut = subpixel or any(axis.stripes is not None or by_table(axis) for axis in wanted.axes)
    if len(lut) and no_lut:
        light, bright = lut[stack], float(lut[min(int(clip), len(lut) - 1)])
    floor = FLOOR if silent else 0.0
    told = raw if noise is not None and response is None else None
    linear = slope if weigh_samples else none
    edges = {axis.axis: bit_edges(sample.levels, raw, wanted, axis.code) for axis in wanted.axes if axis.code}
    return Job(stack, lut, linear, clip, known, raw, floor, light, bright, told, sample, edges)


def clip_level(stack: Frames) -> float:
    """255, or the largest level of the fewest bits that hold the brightest sample of 16-bit frames."""
    if stack.dtype == np.uint8:
        return 255.0
    if stack.dtype.kind == "f":
        return float("inf")
    brightest = int(max(on_cores(np.max, list(stack)), default=0))
    return float(next(level for level in (255, 1023, 4095, 16383, 65535) if level >= brightest))
