"""Checks of pixels against their neighbours, on a block of rows: sigma inflated, then flags; no pixel refused
that a neighbour confirms.

Signature (decoder.py calls it block by block, with the pixel kernel's rows still in cache):

    neighbours(block, above, dof, limits, result)

    block    place, variance (A, n, W); chi2, amplitude (n, W); flags (n, W): rows of the result and HALO more
             on either side, fewer at the image's border
    above    rows of the block before the result's first one
    dof      degrees of freedom of chi2, 0: it says nothing
    limits   (A, 6) float32, rows of axis_limits()
    result   coordinate, sigma (A, R, W), flags (R, W), written

Axes without frames have no row in A. Flagged pixels' places and variances may be anything but NaN.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .plan import AxisPlan
from .records import Flag

__all__ = ["HALO", "Block", "Result", "axis_limits", "neighbours"]

F32 = NDArray[np.float32]
U16 = NDArray[np.uint16]
#: Rows that a block needs on either side of its result.
HALO = 4
#: Usual blur of a camera's lens, and of a soft one, px of the camera; of a display, cells.
_LENS, _SOFT, _BLUR = 0.35, 0.6, 0.6
#: Standard deviations beyond which neighbours contradict.
_SURE = 5.0


class Block(NamedTuple):
    """Output of the pixel kernel.

    place, variance  (A, n, W) float32, pattern px, px^2: by noise alone (bits: of the interval)
    chi2       (n, W) float32, squares of residuals over their noise, summed over all axes
    amplitude  (n, W) float32, levels, the smaller one of both axes
    flags      (n, W) uint16, of both axes
    """

    place: F32
    variance: F32
    chi2: F32
    amplitude: F32
    flags: U16


class Result(NamedTuple):
    """Rows of the maps: coordinate, sigma (A, R, W) float32, pattern px; flags (R, W) uint16."""

    coordinate: F32
    sigma: F32
    flags: U16


def axis_limits(axis: AxisPlan, lens_px: float | None = None, on_cells: bool = True) -> F32:
    """Numbers (6,) of an axis, by which the kernel takes them:

    jump      second difference of neighbours that contradicts them, px: a quarter period, two cells
    extent    of the display, px; infinite: no border
    border    variance of the display's blur and a cell, px^2; 0: no border
    aperture  half the second moment of a camera pixel and its lens, px^2 of the camera; 0: places are cells
    unsure    half of its uncertainty
    fine      1: places within a cell, by fringes or a look-up
    """
    fine = axis.code is None or bool(axis.fringes)
    if axis.fringes:
        jump = 0.25 * axis.fringes[-1].period
    else:
        jump = 2 * axis.code.cell if axis.code is not None else 2.0
    lens = _LENS**2 if lens_px is None else lens_px**2
    least, most = 1 / 48, 1 / 12
    most += _SOFT**2 if lens_px is None else 0.0
    aperture, unsure = (0.5 * (1 / 12 + lens), 0.25 * (most - least)) if fine else (0.0, 0.0)
    bordered = on_cells and fine
    border = 1 / 12 + _BLUR**2 if bordered else 0.0
    extent = float(axis.extent) if bordered else np.inf
    return np.array([jump, extent, border, aperture, unsure, fine], np.float32)


def _shift(of: NDArray[Any], down: int, right: int) -> NDArray[Any]:
    """Map (n, W) of the neighbours; 0 beyond the block."""
    n, width = of.shape
    found = np.zeros_like(of)
    found[max(-down, 0) : n - max(down, 0), max(-right, 0) : width - max(right, 0)] = of[
        max(down, 0) : n + min(down, 0), max(right, 0) : width + min(right, 0)
    ]
    return found


def _box(of: NDArray[Any], reach: int) -> NDArray[Any]:
    """Sum over a square of 2 reach + 1 pixels."""
    every = range(-reach, reach + 1)
    return np.asarray(sum(_shift(of, i, j) for i in every for j in every))


_FOUR = ((0, 1), (0, -1), (1, 0), (-1, 0))


def _unconfirmed(p: NDArray[Any], v: NDArray[Any], good: NDArray[np.bool_], jump: float) -> Any:
    """Good pixels that no neighbours confirm: opposite ones, or three at a corner."""
    confirmed = np.zeros(p.shape, np.bool_)
    for i, j in ((0, 1), (1, 0), (1, 1), (1, -1)):
        both = _shift(good, i, j) & _shift(good, -i, -j)
        most = jump + _SURE * np.sqrt(v + 0.25 * (_shift(v, i, j) + _shift(v, -i, -j)))
        confirmed |= both & (np.abs(0.5 * (_shift(p, i, j) + _shift(p, -i, -j)) - p) < most)
    for i in (-1, 1):
        for j in (-1, 1):
            three = _shift(good, i, 0) & _shift(good, 0, j) & _shift(good, i, j)
            most = jump + _SURE * np.sqrt(v + _shift(v, i, 0) + _shift(v, 0, j) + _shift(v, i, j))
            confirmed |= three & (np.abs(_shift(p, i, 0) + _shift(p, 0, j) - _shift(p, i, j) - p) < most)
    return good & ~confirmed


def neighbours(block: Block, above: int, dof: int, limits: F32, result: Result) -> None:
    """See the head of the file."""
    good = block.flags == 0
    amp, bad = block.amplitude, np.zeros_like(good)
    for p, v, numbers in zip(block.place, block.variance, limits, strict=True):
        bad |= _unconfirmed(p, v, good, float(numbers[0]))
    top = np.max([np.where(_shift(good, *d), _shift(amp, *d), 0) for d in _FOUR], 0)
    lost = np.clip(1 - amp / np.maximum(top, 1e-6), 0, 1)
    bad |= good & np.any([_shift(block.flags > 0, *d) for d in _FOUR], 0) & (lost > 0.5)
    clean = good & ~bad
    flags = block.flags | np.where(bad, np.uint16(Flag.OUTLIER), np.uint16(0))
    rim = clean & ~np.all([_shift(clean, *d) for d in _FOUR], 0)
    beside = clean & np.any([_shift(~clean, *d) for d in _FOUR], 0)
    full, full3 = _box(clean.astype(np.float32), 2) > 24.5, _box(clean.astype(np.float32), 1) > 8.5
    scale = np.ones_like(amp)
    if dof:
        z = block.chi2 / dof
        near = _box(np.where(clean, np.minimum(z, 25), 0), 2) / np.maximum(
            _box(clean.astype(np.float32), 2), 1
        )
        scale = np.maximum(
            np.where(near > 1 + 4 * np.sqrt(2 / dof / 25), near, 1),
            np.where(z > 1 + 5 * np.sqrt(2 / dof) + 8 / dof, z, 1),
        )
    own = slice(above, above + len(result.flags))
    for k, (p, v, numbers) in enumerate(zip(block.place, block.variance, limits, strict=True)):
        _, extent, border, aperture, unsure, fine = numbers.tolist()
        v0 = v * scale
        coordinate, variance = p, v0.copy()
        sides = [
            (np.where(_shift(clean, *d), (_shift(p, *d) - p) * sum(d), 0), _shift(clean, *d)) for d in _FOUR
        ]
        along, down = (
            (a + b) / np.maximum(m.astype(int) + n, 1) for (a, m), (b, n) in (sides[:2], sides[2:])
        )
        step2 = along**2 + down**2
        if fine:
            total, curve, near3 = np.zeros_like(p), np.zeros_like(p), np.zeros_like(p)
            for i in range(-2, 3):
                for j in range(-2, 3):
                    d = np.where(_shift(clean, i, j), _shift(p, i, j) - p, 0)
                    total += d
                    curve += (i * i + j * j - 4) * d
                    near3 += (i * i + j * j - 4 / 3) * d if max(abs(i), abs(j)) < 2 else 0
            lap, lap3 = np.where(full, curve / 35, 0), np.where(full3 & ~full, near3 / 2, 0)
            rest2 = np.where(full, (total / 25 - curve / 35) ** 2 / (1 - 27 / 175), 0)
            count = _box(full.astype(np.float32), 1)
            extra = np.maximum(_box(rest2, 1) / np.maximum(count, 1) - 1.6 * v0, 0) * (count > 0)
            most = np.zeros_like(p)
            for i, j in ((0, 1), (1, 0)):
                four = ((0, -1), (1, 3), (2, -3), (3, 1))
                h = np.asarray(sum(w * _shift(p, i * s, j * s) for s, w in four))
                ok = np.all([_shift(clean, i * s, j * s) for s, _ in four], 0)
                excess = np.where(ok, np.minimum(h * h / 20, 25 * _shift(v, i, j)), 0)
                window = [(i * s + j * t, j * s + i * t) for s in range(-3, 1) for t in range(-3, 4)]
                count = np.asarray(sum(_shift(ok.astype(np.float32), *d) for d in window))
                mean = np.asarray(sum(_shift(excess, *d) for d in window)) / np.maximum(count, 1)
                most = np.maximum(most, np.where(count > 3, mean - 1.2 * v0, 0))
            coordinate = p - aperture * lap
            variance += extra + most + (unsure * lap) ** 2 + ((aperture + unsure) * lap3) ** 2
            variance += step2 * np.where(rim, 0.09, np.where(full, 0, 0.0036))
            variance += step2 * np.where(beside, (0.5 * lost) ** 2, 0)
        if border > 0:
            reach = np.sqrt(2 * aperture * step2 + border)
            t = np.minimum(p + 0.5, extent - 0.5 - p) / reach
            flags = flags | np.where(clean & (t < 1.2), np.uint16(Flag.OFF_PATTERN), np.uint16(0))
            variance += (0.4 * reach * np.exp(-0.5 * np.maximum(t, 0) ** 2)) ** 2
        result.coordinate[k] = coordinate[own]
        result.sigma[k] = np.sqrt(np.maximum(variance, 1e-4))[own]
    result.flags[:] = flags[own]
