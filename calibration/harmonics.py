"""Residual harmonics of fringes after the response is inverted, and their error of the coordinate.

The N-step algorithm applied to sum b_k cos(k psi) yields the modulation b_1 + (b_(N-1) + b_(N+1)) cos(N psi),
the offset b_0 + b_N cos(N psi) and the phase psi - (b_(N-1) - b_(N+1)) / b_1 sin(N psi): aliasing, to first
order. The residuals of the sinusoidal fit contain only b_2 .. b_(N-2), which do not bias the phase. The error
is therefore estimated from the variation of modulation and offset with N psi over all pixels. b_N separates
b_(N-1) and b_(N+1), which are known as a sum, under the assumption of a power law (wrong gamma).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optolever.decode import Response
from optolever.errors import InputError
from optolever.patterns import Frame, Sequence

__all__ = ["HarmonicError", "harmonic_errors"]

F64 = NDArray[np.float64]
#: Pixels of the fit: rows and columns, roughly.
_ROWS, _COLS = 128, 512
#: Degree of the polynomial of uneven light and reflectance over the image.
_DEGREE = 3
_FEWEST = 200
#: Upper bound of the ratio of successive harmonics, and fixed-point iterations for it.
_STEEPEST, _ROUNDS = 0.9, 12
#: Share of the brightest modulation below which a pixel is omitted.
_LIT = 0.25


@dataclass(frozen=True, slots=True)
class HarmonicError:
    """rms_px: rms error of the coordinate by harmonics of an axis' finest fringe, pattern pixels; sigma_px:
    its standard deviation by noise; a smaller error is not significant."""

    axis: str
    rms_px: float
    sigma_px: float


def harmonic_errors(
    frames: ArrayLike, sequence: Sequence, response: Response | None = None, white_level: float = np.inf
) -> tuple[HarmonicError, ...]:
    """Residual harmonic error of each axis with fringes of N >= 3 equal shifts; other axes are omitted.

    frames (N, H, W), unsigned where a response is given; white_level: where the camera clips (uint8: 255).
    Light and reflectance may vary smoothly over the image; texture increases sigma_px.

    For a residual power law the estimate is right to 20 % (N = 3, 4, 5). Other nonlinearities are
    underestimated: noise of 0.5 levels rounded at black, with gamma 2.2 inverted as 2.8, hides 40 % of the
    error at N = 4 and nearly all of it at N = 5.
    """
    stack = np.asarray(frames)
    if stack.ndim != 3 or len(stack) != len(sequence):
        raise InputError(f"harmonics: frames have shape {stack.shape}, sequence describes {len(sequence)}")
    if response is not None and stack.dtype.kind != "u":
        raise InputError(f"harmonics: response is given, frames are {stack.dtype}, must be uint8 or uint16")
    table = None if response is None else response.table(stack.dtype)
    clip = 255.0 if stack.dtype == np.uint8 else white_level
    found = [_of_fringe(stack, own, table, clip) for own in _finest(sequence)]
    return tuple(error for error in found if error is not None)


def _finest(sequence: Sequence) -> list[dict[int, Frame]]:
    """Frames, by their numbers, of each axis' finest fringe."""
    groups: dict[tuple[str, float], dict[int, Frame]] = {}
    for i, frame in enumerate(sequence.frames):
        if frame.kind == "phase":
            groups.setdefault((frame.axis or "", frame.period_px or 1.0), {})[i] = frame
    return [
        groups[min(key for key in groups if key[0] == axis)] for axis in sorted({one[0] for one in groups})
    ]


def _of_fringe(
    stack: NDArray[Any], frames: dict[int, Frame], table: NDArray[np.float32] | None, clip: float
) -> HarmonicError | None:
    (frame, *_), steps = frames.values(), len(frames)
    # an inverted fringe is the fringe shifted by half a period
    shifts = np.array([(one.shift or 0.0) + np.pi * one.inverted for one in frames.values()])
    turns = np.sort(np.mod(shifts - shifts[0], 2 * np.pi))
    if steps < 3 or not np.allclose(np.diff(turns, append=2 * np.pi), 2 * np.pi / steps, atol=1e-3):
        return None
    _, rows, cols = stack.shape
    raw = stack[list(frames), :: max(1, rows // _ROWS), :: max(1, cols // _COLS)]
    levels = (raw if table is None else table[raw]).astype(np.float64)
    offset = levels.mean(axis=0)
    wave = 2 / steps * np.tensordot(np.exp(1j * shifts), levels, 1)
    modulation = np.abs(wave)
    keep = (raw.max(axis=0) < clip) & (modulation > _LIT * np.percentile(modulation, 95))
    if np.count_nonzero(keep) < _FEWEST:
        return None
    swing = steps * (np.angle(wave) - shifts[0])[keep]
    surface = _surface(keep)
    trend = surface @ np.linalg.lstsq(surface, modulation[keep], rcond=None)[0]
    design = np.column_stack([surface, np.cos(swing), np.sin(swing)])
    wanted = np.stack([modulation[keep], offset[keep]], axis=1) / trend[:, None]
    solved = np.linalg.lstsq(design, wanted, rcond=None)[0]
    both, middle = solved[-2]
    freedom = max(len(trend) - design.shape[1], 1)
    variance = float(np.sum((wanted[:, 0] - design @ solved[:, 0]) ** 2)) / freedom
    sigma = np.sqrt(variance * np.linalg.pinv(design.T @ design)[-2, -2])
    scale = (frame.period_px or 1.0) / (2 * np.pi * np.sqrt(2))
    return HarmonicError(
        frame.axis or "", float(scale * abs(_apart(both, middle, steps))), float(scale * sigma)
    )


def _apart(both: float, middle: float, steps: int) -> float:
    """b_(N-1) - b_(N+1) from their sum and b_N, for a power law of the displayed level.

    ((1 + cos psi) / 2)^g has b_(k+1) / b_k = (g - k) / (g + k + 1); g follows from the first ratio.
    """
    lower, product = both, 0.0
    for _ in range(_ROUNDS):
        first = float(np.clip(middle / lower, -_STEEPEST, _STEEPEST)) if lower else 0.0
        power = (steps - 1 + first * steps) / (1 - first)
        product = first * (power - steps) / (power + steps + 1)
        lower = both / (1 + product)
    return lower * (1 - product)


def _surface(keep: NDArray[np.bool_]) -> F64:
    """Polynomials over the kept pixels, (K, terms)."""
    y, x = (2 * at / max(size - 1, 1) - 1 for at, size in zip(np.nonzero(keep), keep.shape, strict=True))
    powers = [(i, j) for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)]
    return np.stack([x**i * y**j for i, j in powers], axis=1)
