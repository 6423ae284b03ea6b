"""How much light a camera pixel takes from every cell of the pattern: the lookup over its footprint's area.

A pixel sees the parallelogram spanned by its Jacobian (du/dcol, dv/dcol), (du/drow, dv/drow). Along u that is
box(|du/dcol|) * box(|du/drow|), a trapezoid; with a Gaussian blur of the pattern, its convolution with that.
The share of the cell k (from k - 1/2 to k + 1/2, of even level) is

    W_k = H(k + 1/2 - u) - H(k - 1/2 - u),
    H(x) = [M(x + p) - M(x + q) - M(x - q) + M(x - p)] / (a b),    p = (a + b) / 2, q = (a - b) / 2,

the second difference over both boxes a >= b of the twice integrated kernel, M(t) = t |t| / 4 for a sharp
pattern and

    M(t) = [(t^2 + s^2) erf(t / (s sqrt 2)) / 2 + t s phi(t / s)] / 2    for a blur of s cells rms.

Boxes much narrower than the blur would cancel digits, so they are widened to 0.35 s and s is reduced to the
same variance (error of H: 1e-5); without blur the floor is 1e-3 cells. `footprint.glsl` is the same in
float32. A frame that varies along one axis only takes the weights of that axis, times the share of the
footprint that lies on the pattern along the other. Frames that vary along both take the product of the
shares, of the footprint cut up where it lies askew (the product leaves out that u and v vary together there).
Off the pattern it is dark.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import exact, inlined

__all__ = ["ASKEW", "BLUR_FLOOR", "PARTS", "REACH", "SHARP_FLOOR", "look_up_one", "look_up_two"]

SHARP_FLOOR = 1e-3
"""Narrowest box of a footprint on a sharp pattern, in cells."""
BLUR_FLOOR = 0.35
"""Narrowest box of a footprint, in units of the blur."""
REACH = 4.5
"""The blur is cut off here, in units of its rms: 3.4e-6 of the light."""
ASKEW = 0.02
"""Frames along both axes: a footprint whose u and v vary together by more than this (cells^2) is cut up."""
PARTS = 3
"""Into so many parts along each side; what the product of the shares leaves out falls by the square of it."""

_ROOT_HALF = math.sqrt(0.5)
_ROOT_TWO_PI = math.sqrt(2.0 * math.pi)


@inlined
def _twice_integrated(t: float, s: float) -> float:
    if s == 0.0:
        return 0.25 * t * abs(t)
    z = t / s
    if abs(z) > 6.0:
        return math.copysign(0.25 * (t * t + s * s), t)
    bell = math.exp(-0.5 * z * z) / _ROOT_TWO_PI
    return 0.5 * ((t * t + s * s) * 0.5 * math.erf(z * _ROOT_HALF) + t * s * bell)


@exact
def _shape(a: float, b: float, blur: float) -> tuple[float, float, float, float]:
    """Boxes (of either sign) and blur -> p, q, 1 / (a b), s after the floors."""
    a, b = abs(a), abs(b)
    if a < b:
        a, b = b, a
    floor = BLUR_FLOOR * blur if blur > 0.0 else SHARP_FLOOR
    wide, narrow = max(a, floor), max(b, floor)
    s = 0.0
    if blur > 0.0:
        s = math.sqrt(blur * blur + (a * a - wide * wide + b * b - narrow * narrow) / 12.0)
    return 0.5 * (wide + narrow), 0.5 * (wide - narrow), 1.0 / (wide * narrow), s


@exact
def _share(x: Any, p: Any, q: Any, scale: Any, s: Any) -> Any:
    """H(x): the share of the footprint below x, less one half."""
    if x >= p + REACH * s:
        return 0.5
    if x <= -p - REACH * s:
        return -0.5
    outer = _twice_integrated(x + p, s) + _twice_integrated(x - p, s)
    return (outer - _twice_integrated(x + q, s) - _twice_integrated(x - q, s)) * scale


@exact
def _extent(at: Any, a: Any, b: Any, blur: Any, cells: Any) -> Any:
    """Share of the footprint that lies on the pattern along one axis."""
    p, q, scale, s = _shape(a, b, blur)
    return _share(cells - 0.5 - at, p, q, scale, s) - _share(-0.5 - at, p, q, scale, s)


@exact
def _span(at: float, p: float, s: float, cells: int) -> tuple[int, int]:
    """First and last cell that the footprint touches."""
    reach = p + REACH * s
    return max(0, math.ceil(at - reach - 0.5)), min(cells - 1, math.floor(at + reach + 0.5))


@exact
def _shares(at: float, a: float, b: float, blur: float, cells: int) -> tuple[int, NDArray[np.float64]]:
    """First cell under the footprint, and the shares W_k from it on."""
    p, q, scale, s = _shape(a, b, blur)
    first, last = _span(at, p, s, cells)
    weights = np.empty(max(0, last - first + 1))
    left = _share(first - 0.5 - at, p, q, scale, s)
    for k in range(weights.size):
        right = _share(first + k + 0.5 - at, p, q, scale, s)
        weights[k] = right - left
        left = right
    return first, weights


@exact
def look_up_one(
    look: NDArray[np.float64],
    light: NDArray[np.float64],
    blur: float,
    table: NDArray[np.float32],
    across: int,
    out: NDArray[np.float32],
) -> None:
    """Irradiance of frames that vary along one axis.

    look: (P, 6): position along the axis, its movement from edge to edge of the pixel along columns and along
    rows, and the same three across the axis, in cells.
    light: (P,) share that the mirror passes on, 0 without a view of the pattern. table: (cells, N) levels.
    across: cells of the other axis. out: (P, N).
    """
    sums = np.empty(table.shape[1])
    for i in range(light.size):
        out[i, :] = 0.0
        if light[i] <= 0.0:
            continue
        at = look[i, 0]
        p, q, scale, s = _shape(look[i, 1], look[i, 2], blur)
        first, last = _span(at, p, s, table.shape[0])
        sums[:] = 0.0
        left = _share(first - 0.5 - at, p, q, scale, s)
        for k in range(first, last + 1):
            right = _share(k + 0.5 - at, p, q, scale, s)
            for n in range(sums.size):
                sums[n] += (right - left) * table[k, n]
            left = right
        share = light[i] * _extent(look[i, 3], look[i, 4], look[i, 5], blur, across)
        for n in range(sums.size):
            out[i, n] = sums[n] * share


@exact
def look_up_two(
    look: NDArray[np.float64],
    light: NDArray[np.float64],
    blur: float,
    levels: tuple[NDArray[np.uint8], NDArray[np.uint8]],
    mean: bool,
    response: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """Irradiance of frames that vary along both axes: every cell under the footprint, shares multiplied.

    look, light, out as in look_up_one, u first. levels: (cols, N) and (rows, N), combined by their product
    or mean. response: (256,) light of each level.
    """
    sums = np.empty(out.shape[1])
    for i in range(light.size):
        sums[:] = 0.0
        if light[i] > 0.0:
            u, u_col, u_row, v, v_col, v_row = look[i]
            parts = PARTS if abs(u_col * v_col + u_row * v_row) > ASKEW else 1
            for j in range(parts * parts):
                by_col, by_row = (j // parts + 0.5) / parts - 0.5, (j % parts + 0.5) / parts - 0.5
                at = (u + by_col * u_col + by_row * u_row, v + by_col * v_col + by_row * v_row)
                boxes = (u_col / parts, u_row / parts, v_col / parts, v_row / parts)
                _add_cells(at, boxes, blur, levels, mean, response, sums)
            sums *= light[i] / (parts * parts)
        out[i, :] = sums


@exact
def _add_cells(
    at: tuple[float, float],
    boxes: tuple[float, float, float, float],
    blur: float,
    levels: tuple[NDArray[np.uint8], NDArray[np.uint8]],
    mean: bool,
    response: NDArray[np.float32],
    sums: NDArray[np.float64],
) -> None:
    """Add the light (N,) of all cells under a footprint, shares of both axes multiplied."""
    levels_u, levels_v = levels
    first_v, weights_v = _shares(at[1], boxes[2], boxes[3], blur, levels_v.shape[0])
    first_u, weights_u = _shares(at[0], boxes[0], boxes[1], blur, levels_u.shape[0])
    for j in range(weights_v.size):
        for k in range(weights_u.size):
            weight = weights_u[k] * weights_v[j]
            for n in range(sums.size):
                a, b = np.int64(levels_u[first_u + k, n]), np.int64(levels_v[first_v + j, n])
                level = (a + b + 1) // 2 if mean else (a * b + 127) // 255
                sums[n] += weight * response[level]
