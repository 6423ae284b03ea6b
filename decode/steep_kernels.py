"""Compiled: where on steep stairs a pixel looks: the mean over all places that its coordinate may come from.

On a tread many places give the same coordinate, on a riser few; no inversion tells them apart. What is known
is a distribution over one cell: the likelihood of the coordinate at each of its places.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .jit import apart_kernel, leaf_kernel
from .phase_kernels import phase_of
from .wave_kernels import falling

__all__ = ["PLACES", "likely_place", "read_as"]

Array = NDArray[Any]
#: Places in a cell, harmonics at most, their waves there.
PLACES, _TERMS = 64, 8
_ANGLES = 2 * np.pi * np.outer(np.arange(1, _TERMS + 1), (np.arange(PLACES) + 0.5) / PLACES)
_COSINES, _SINES = np.cos(_ANGLES).astype(np.float32), np.sin(_ANGLES).astype(np.float32)
_ZERO, _HALF, _ONE = np.float32(0), np.float32(0.5), np.float32(1)
_STEP, _TWELFTH = np.float32(1 / PLACES), np.float32(1 / 12)


@leaf_kernel
def read_as(periods: Array, weights: Array, bands: Array, room: Array, curve: Array) -> None:
    """curve (PLACES + 1,): as which coordinate every place in a cell is read.

    periods, weights (G,), bands (G, 2, K): the stairs (see stairs_kernels); room: (4, PLACES) float32.
    """
    real, imag, error, whole = room
    for i in range(PLACES):
        error[i] = _ZERO
        whole[i] = _ZERO
    for g in range(len(periods)):
        _add_period(np.float32(periods[g]), np.float32(weights[g]), bands[g], real, imag, error, whole)
    for i in range(PLACES):
        curve[i] = _STEP * (np.float32(i) + _HALF) + error[i] / whole[i]
    curve[PLACES] = curve[0] + _ONE


@leaf_kernel
def likely_place(target: float, variance: float, curve: Array) -> tuple[float, float]:
    """Mean and variance of the place whose coordinate is read as `target` with that variance."""
    off, spread = _mean(np.float32(target - np.floor(target)), np.float32(variance), curve)
    return target + off, spread


@apart_kernel
def _add_period(
    period: Any, weight: Any, bands: Array, real: Array, imag: Array, error: Array, whole: Array
) -> None:
    """error, whole += what cells make of one period at all places, times and with its weight there."""
    for i in range(PLACES):
        real[i] = _ONE
        imag[i] = _ZERO
    for k in range(bands.shape[1]):
        both, odd = np.float32(bands[0, k] + bands[1, k]), np.float32(bands[0, k] - bands[1, k])
        cosine, sine = _COSINES[k], _SINES[k]
        for i in range(PLACES):
            real[i] += both * cosine[i]
            imag[i] += odd * sine[i]
    for i in range(PLACES):
        turn, _, _ = phase_of(real[i], imag[i])
        power = weight * (real[i] * real[i] + imag[i] * imag[i])
        error[i] += power * period * turn
        whole[i] += power


@apart_kernel
def _mean(target: Any, variance: Any, curve: Array) -> Any:
    """Mean distance from the target of the places, and their variance."""
    above = curve[1:]
    total, first, second = np.float32(1e-30), _ZERO, _ZERO
    for i in range(PLACES):
        rise = above[i] - curve[i]
        spread = variance + rise * rise * _TWELFTH
        off = target - _HALF * (above[i] + curve[i])
        cells = np.floor(off + _HALF)
        off -= cells
        x = _HALF * off * off / spread
        weight = falling(x) / np.sqrt(spread)
        # between two places the curve is a line, which tells more than half way where it rises fast
        nearer = _STEP * _TWELFTH * rise * off / spread
        nearer = nearer if nearer < _HALF * _STEP else _HALF * _STEP
        nearer = nearer if nearer > -_HALF * _STEP else -_HALF * _STEP
        away = _STEP * np.float32(i + 1) + cells - target + nearer
        total += weight
        first += weight * away
        second += weight * (away * away + _STEP * _STEP * _TWELFTH * variance / spread)
    mean = first / total
    left = second / total - mean * mean
    return mean, (left if left > _ZERO else _ZERO)
