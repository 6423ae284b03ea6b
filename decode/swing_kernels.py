"""Compiled: how a fringe's contrast swings with the place in the cell (see swing). All in float32."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .jit import apart_kernel, asked_by, leaf_kernel, outer_kernel
from .phase_kernels import phase_of
from .wave_kernels import cosine_sine

__all__ = ["LEVEL", "LINES", "prepare", "swing"]

Array = NDArray[Any]
#: Lines of room: what `prepare` leaves there, and two for `swing`.
LINES = 12
_UP, _DOWN, LEVEL, _REST, _SLOW, _MODEL, _ASIDE = 0, 1, 2, 3, 4, 10, 11
#: Parabolas over the image; share of their mean square below which one is none besides the others.
_PARABOLAS, _ALIKE = 6, 1e-6
_ZERO, _HALF, _ONE, _PI = np.float32(0), np.float32(0.5), np.float32(1), np.float32(np.pi)
#: sinc below this is 1 to the last digit.
_NEAR = np.float32(1e-4)


@asked_by("fringes", "float32, float32[::1], float32[:, ::1], float32[:, ::1], float32[:, ::1]")
@outer_kernel
def prepare(f: Any, contrast: Array, sides: Array, at: Array, room: Array) -> None:
    """Of pixels (K,): contrast over what the footprint leaves of it (LEVEL), the same less the nearest
    parabola over the image (_REST), sidebands that nothing blurs but the footprint (_UP, _DOWN), orthonormal
    parabolas (_SLOW on). f: cycles a cell; sides (2, K): footprint, cells; at (2, K): -1 to 1 over the image.
    """
    _levels(f, contrast, sides, room)
    _parabolas(at[0], at[1], room)
    for i in range(_PARABOLAS):
        own = room[_SLOW + i]
        whole = _product(own, own)
        _project(i, own, room)
        left = _product(own, own)
        _scale(own, 1 / math.sqrt(left) if left > _ALIKE * whole else 0.0)
    _project(_PARABOLAS, room[_REST], room)


@leaf_kernel
def _levels(f: Any, contrast: Array, sides: Array, room: Array) -> None:
    count = len(contrast)
    level, above, below, rest = room[LEVEL], room[_UP], room[_DOWN], room[_REST]
    for x in range(count):
        level[x], above[x], below[x] = contrast[x], -f / (f + _ONE), -f / (f - _ONE)
    for side in range(2):
        _take_side(f, sides[side], level, above, below)
    for x in range(count):
        rest[x] = level[x]


@apart_kernel
def _take_side(f: Any, width: Array, level: Array, above: Array, below: Array) -> None:
    """One side of the footprint: level over sinc(f w), and above, below times sinc((f + m) w) / sinc(f w) for
    m = 1, -1, from sines and cosines of f w and w."""
    for x in range(len(width)):
        wide = abs(width[x]) > _NEAR
        w = width[x] if wide else _ONE
        cell_cosine, cell_sine = cosine_sine(_HALF * w)
        cosine, sine = cosine_sine(_HALF * f * w)
        level[x] *= _PI * f * w / sine if wide else _ONE
        cross = cell_sine * cosine / sine
        above[x] *= f / (f + _ONE) * (cell_cosine + cross) if wide else _ONE
        below[x] *= f / (f - _ONE) * (cell_cosine - cross) if wide else _ONE


@leaf_kernel
def _parabolas(row: Array, col: Array, room: Array) -> None:
    for x in range(len(row)):
        room[_SLOW, x], room[_SLOW + 1, x], room[_SLOW + 2, x] = _ONE, row[x], col[x]
        room[_SLOW + 3, x], room[_SLOW + 4, x] = row[x] * row[x], row[x] * col[x]
        room[_SLOW + 5, x] = col[x] * col[x]


@leaf_kernel
def _project(count: int, values: Array, room: Array) -> None:
    """Take off `values` what the first `count` parabolas hold of it."""
    for i in range(count):
        _less(values, room[_SLOW + i], np.float32(_product(values, room[_SLOW + i])))


@apart_kernel
def _less(values: Array, other: Array, share: Any) -> None:
    for x in range(len(values)):
        values[x] -= share * other[x]


@apart_kernel
def _scale(values: Array, factor: Any) -> None:
    by = np.float32(factor)
    for x in range(len(values)):
        values[x] *= by


@apart_kernel
def _product(one: Array, other: Array) -> float:
    total = _ZERO
    for x in range(len(one)):
        total += one[x] * other[x]
    return float(total)


@asked_by("fringes", "float64, float64, float64, float32[::1], float32[:, ::1]")
@outer_kernel
def swing(square: float, f: float, middle: float, place: Array, room: Array) -> tuple[float, float, float]:
    """Of a squared blur (cells^2): seen swing over what it should be, the same of a swing a quarter of a cell
    aside, and their standard error.

    place (K,): within their cells; middle: usual level; room: see prepare.
    """
    count = len(place)
    above = math.exp(-2 * math.pi**2 * square * ((f + 1) ** 2 - f**2))
    below = math.exp(-2 * math.pi**2 * square * ((f - 1) ** 2 - f**2))
    model, aside, rest = room[_MODEL, :count], room[_ASIDE, :count], room[_REST, :count]
    period, up, down = np.float32(1 / f), room[_UP], room[_DOWN]
    _swung(period, np.float32(above), np.float32(below), place, up, down, model, aside)
    _project(_PARABOLAS, model, room)
    _project(_PARABOLAS, aside, room)
    power, beside = _product(model, model) + 1e-30, _product(aside, aside) + 1e-30
    along = _product(model, rest) / middle
    astray = _product(aside, rest) / middle
    share = along / power
    noise = _product(rest, rest) / middle**2 - share * along
    return share, astray / beside, math.sqrt(max(noise, 0.0) / count / power)


@apart_kernel
def _swung(
    period: Any, above: Any, below: Any, place: Array, up: Array, down: Array, model: Array, aside: Array
) -> None:
    """Contrast at places that are read with the stairs of the cells, by the sidebands, and by these turned a
    quarter."""
    for x in range(len(place)):
        both, apart = above * up[x] + below * down[x], above * up[x] - below * down[x]
        cosine, sine = cosine_sine(place[x])
        shift = period * phase_of(_ONE + both * cosine, apart * sine)[0]
        cosine, sine = cosine_sine(place[x] - shift)
        model[x] = np.sqrt((_ONE + both * cosine) ** 2 + (apart * sine) ** 2)
        aside[x] = np.sqrt((_ONE - both * sine) ** 2 + (apart * cosine) ** 2)
