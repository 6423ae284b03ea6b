"""Noise of the camera, from what the frames themselves cannot explain: variance = read^2 + gain * level."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .plan import Code, Fringe, Plan

__all__ = ["QUANTISATION", "Noise", "estimate_noise", "sample_pixels"]

#: Variance of rounding to whole levels.
QUANTISATION = 1 / 12
F64 = NDArray[np.float64]
_BINS = 8
_SAMPLE = 128


@dataclass(frozen=True, slots=True)
class Noise:
    """variance = read2 + gain * level, camera levels (after the response, where one was given)."""

    read2: float
    gain: float = 0.0

    def variance(self, level: float) -> float:
        """Variance of one sample at a level."""
        return self.read2 + self.gain * max(level, 0.0)


def sample_pixels(frames: NDArray[Any], lut: NDArray[np.float32]) -> tuple[F64, NDArray[np.bool_]]:
    """Linear levels (N, K) of a grid of up to 128 x 128 pixels, and which pixels hold a zero."""
    _, rows, cols = frames.shape
    raw = frames[:, :: max(1, rows // _SAMPLE), :: max(1, cols // _SAMPLE)]
    raw = raw.reshape(len(frames), -1)
    return (lut[raw] if len(lut) else raw).astype(np.float64), (raw == 0).any(axis=0)


def estimate_noise(frames: NDArray[Any], lut: NDArray[np.float32], clip: float, plan: Plan) -> Noise:
    """Pool the residuals of every model with degrees of freedom left, as a function of the level.

    Fringes of N >= 4 shifts: N - 3 contrasts that offset and fringe do not reach. Bits with inverses: their
    sums are all the same level. Bits without: coarse ones against white and black. Where none of these was
    shown (N = 3), the offset's second differences over neighbours (Immerkaer,
    doi:10.1006/cviu.1996.0060).
    """
    levels, zero = sample_pixels(frames, lut)
    limit = float(lut[min(len(lut) - 1, int(clip))]) if len(lut) else clip
    pairs: list[tuple[F64, F64]] = []
    for axis in plan.axes:
        pairs += [_of_fringe(levels, fringe, limit, zero) for fringe in axis.fringes if len(fringe.index) > 3]
        if axis.code is not None:
            pairs += _of_pairs(levels, axis.code, limit, zero)
    if not any(len(pair[0]) for pair in pairs) and plan.white >= 0 and plan.black >= 0:
        codes = [axis.code for axis in plan.axes if axis.code is not None]
        pairs += [pair for code in codes for pair in _of_flat_bits(levels, code, plan, limit)]
    if not any(len(pair[0]) for pair in pairs):
        pairs = [_of_neighbours(frames, lut, index) for index in _offset_groups(plan, len(frames))]
    level = np.concatenate([pair[0] for pair in pairs])
    residual = np.concatenate([pair[1] for pair in pairs])
    floor = QUANTISATION if frames.dtype.kind == "u" else 1e-12
    return _fit(level, residual, floor)


def _of_fringe(levels: F64, fringe: Fringe, limit: float, zero: NDArray[np.bool_]) -> tuple[F64, F64]:
    own = levels[list(fringe.index)]
    full = np.linalg.qr(fringe.design(), mode="complete")[0]
    modulation = np.hypot(*(np.linalg.pinv(fringe.design())[1:] @ own))
    own = own[:, _usable(np.all(own < limit, axis=0), modulation, zero)]
    residual = full[:, 3:].T @ own
    return np.tile(own.mean(axis=0), len(residual)), residual.ravel()


def _usable(keep: NDArray[np.bool_], modulation: F64, zero: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels that see the pattern and hold no zero (noise cut off there looks smaller), if enough do."""
    for better in (modulation > 0.25 * np.percentile(modulation, 95), ~zero):
        if np.count_nonzero(keep & better) > 500:
            keep = keep & better
    return keep


def _of_pairs(levels: F64, code: Code, limit: float, zero: NDArray[np.bool_]) -> list[tuple[F64, F64]]:
    both = (code.plain >= 0) & (code.inverse >= 0)
    if np.count_nonzero(both) < 2:
        return []
    first, second = levels[code.plain[both]], levels[code.inverse[both]]
    keep = _usable(
        np.all((first < limit) & (second < limit), axis=0), np.abs(first - second).max(axis=0), zero
    )
    sums = (first + second)[:, keep] / np.sqrt(2.0)
    contrasts = np.linalg.qr(np.ones((len(sums), 1)), mode="complete")[0][:, 1:]
    residual = contrasts.T @ sums
    return [(np.tile(sums.mean(axis=0) / np.sqrt(2.0), len(residual)), residual.ravel())]


def _of_flat_bits(levels: F64, code: Code, plan: Plan, limit: float) -> list[tuple[F64, F64]]:
    """The two coarsest bits read white or black nearly everywhere; the fit sorts out their edges."""
    white, black = levels[plan.white], levels[plan.black]
    found = []
    for bit in range(max(0, len(code.plain) - 2), len(code.plain)):
        own = levels[max(code.plain[bit], code.inverse[bit])]
        for reference in (white, black):
            near = (np.abs(own - reference) < 0.2 * np.abs(white - black)) & (own < limit) & (own > 0)
            found.append((own[near], (own - reference)[near] / np.sqrt(2.0)))
    return found


def _offset_groups(plan: Plan, frames: int) -> list[list[int]]:
    groups = [list(fringe.index) for axis in plan.axes for fringe in axis.fringes]
    return groups or [[i] for i in range(min(frames, 8))]


def _of_neighbours(frames: NDArray[Any], lut: NDArray[np.float32], index: list[int]) -> tuple[F64, F64]:
    rows = frames.shape[1]
    top = max(0, rows // 2 - 128)
    raw = frames[index, top : top + 256]
    mean = (lut[raw] if len(lut) else raw).astype(np.float64).mean(axis=0)
    if min(mean.shape) < 3:
        return np.zeros(0), np.zeros(0)
    across = mean[:, :-2] - 2 * mean[:, 1:-1] + mean[:, 2:]
    second = (across[:-2] - 2 * across[1:-1] + across[2:]) / 6
    return mean[1:-1, 1:-1].ravel(), second.ravel() * np.sqrt(len(index))


def _fit(level: F64, residual: F64, floor: float) -> Noise:
    """Robust variance per level bin, then a weighted straight line that is nowhere below the floor."""
    if len(level) == 0:
        return Noise(floor)
    bins = min(_BINS, max(1, len(level) // 200))
    order = np.argsort(level, kind="stable")
    parts = [(level[part], _robust_variance(residual[part])) for part in np.array_split(order, bins)]
    x = np.array([values.mean() for values, _ in parts])
    y = np.array([max(value, floor) for _, value in parts])
    weight = 1 / y
    if bins < 3 or np.ptp(x) < 0.05 * max(x.max(), 1.0):
        return Noise(float(np.mean(y)))
    slope, start = np.polyfit(x, y, 1, w=weight)
    if slope <= 0:
        return Noise(float(np.sum(y * weight**2) / np.sum(weight**2)))
    if start < floor:
        slope = max(0.0, np.sum(weight**2 * x * (y - floor)) / np.sum(weight**2 * x * x))
        return Noise(floor, float(slope))
    return Noise(float(start), float(slope))


def _robust_variance(residual: F64) -> float:
    """Mean square within 4 robust deviations, from the median absolute value and then from itself."""
    size = np.abs(residual)
    deviation = 1.4826 * float(np.median(size)) + 0.1
    for _ in range(3):
        inside = size < 4 * deviation
        deviation = float(np.sqrt(np.mean(size[inside] ** 2))) if inside.any() else deviation
        if deviation == 0:
            return 0.0
    return deviation**2
