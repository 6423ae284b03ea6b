"""Holes of a few pixels and narrow slits, bridged from their neighbours, so that scattered bad pixels cost no
masked solve, and the flagged seams between the cells of a code do not part the image into islands.

The bridged values only serve the neighbours' edges; a bridged pixel stays flagged and gets no height.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.ndimage

from optolever.kernels import exact

from .arrays import Floats, Ints, Mask
from .measured import Measured

__all__ = ["bridged", "noise_gain", "small_holes"]

LARGEST = 9  # pixels
NARROW = 2  # pixels between measured ones in a row or a column
SHARE = 0.5  # of the image: where more is missing, it falls apart
_REACH = 4.0  # pixels, rms: over which the gain is averaged


def small_holes(mask: Mask) -> Mask:
    """Pixels outside the mask in holes of at most LARGEST pixels (eight neighbours), and in slits of at most
    NARROW.
    """
    outside = ~mask
    if not outside.any():
        return outside
    labels, _ = scipy.ndimage.label(outside, structure=np.ones((3, 3)))
    sizes = np.bincount(labels.ravel())
    sizes[0] = LARGEST + 1
    small: Mask = sizes[labels] <= LARGEST
    if not small[outside].all():
        small |= _slit(mask) | _slit(mask.T).T
    return small if np.count_nonzero(small) <= SHARE * mask.size else np.zeros_like(mask)


def _slit(mask: Mask) -> Mask:
    """Pixels outside the mask between two of it, at most NARROW + 1 apart along the row."""
    found = np.zeros_like(mask)
    for gap in range(1, NARROW + 1):
        ends = mask[:, : -gap - 1] & mask[:, gap + 1 :]
        for k in range(1, gap + 1):
            found[:, k : k - gap - 1] |= ends
    return found & ~mask


def bridged(data: Measured, holes: Mask) -> Measured:
    """The measurement with u, v and the sigmas interpolated across the holes, which join the mask."""
    if not holes.any():
        return data
    bridge = _bridge(data.mask & ~holes, holes)
    fields = {name: getattr(data, name).copy() for name in ("u", "v", "sigma_u", "sigma_v")}
    for name, field in fields.items():
        weights = bridge.weights
        if name.startswith("sigma"):  # those of the neighbours
            weights = np.abs(weights) / np.abs(weights).sum(axis=1, keepdims=True)
        _fill(field.reshape(-1), bridge.pixels, bridge.sources, weights)
    mask = data.mask & ~holes
    mask.reshape(-1)[bridge.pixels] = True
    return replace(data, mask=mask, **fields)


def noise_gain(mask: Mask, holes: Mask) -> Floats:
    """By what factor bridging the holes, which are part of the mask, raises the noise of long waves,
    (rows, cols).

    A bridged pixel repeats its neighbours' noise. With W the sum of a measured pixel's weights, its own and
    those in bridged ones, the power at long waves is the mean of W^2 over all pixels, 1 without any bridge.
    """
    if not holes.any():
        return np.ones(mask.shape)
    bridge = _bridge(mask & ~holes, holes)
    weights = mask.astype(np.float64)
    _gather(weights.reshape(-1), bridge.pixels, bridge.sources, bridge.weights)
    area = scipy.ndimage.gaussian_filter(mask.astype(np.float64), _REACH)
    gain: Floats = scipy.ndimage.gaussian_filter(weights**2, _REACH) / np.maximum(area, 1e-12)
    return np.maximum(gain, 1.0, out=gain)


@dataclass(frozen=True, slots=True)
class _Bridge:
    """pixels (M,) in the order in which they are filled, each from sources (M, 8) times weights (M, 8)."""

    pixels: Ints
    sources: Ints
    weights: Floats


def _bridge(known: Mask, holes: Mask) -> _Bridge:
    """From both sides where there are both: extrapolation, which magnifies noise, comes last."""
    order = np.where(known, 0, _NEVER)
    at = np.argwhere(holes)
    sources, weights = np.zeros((len(at), 8), dtype=np.int64), np.zeros((len(at), 8))
    _plan(order, at, sources, weights)
    turn = order[holes]
    first = np.argsort(turn, kind="stable")[: np.count_nonzero(turn < _NEVER)]
    pixels = (at @ np.array([known.shape[1], 1]))[first]
    return _Bridge(pixels, sources[first], weights[first])


_NEVER = np.iinfo(np.int64).max


@exact
def _plan(order, at, sources, weights):  # type: ignore[no-untyped-def]
    """Which pass fills a pixel (order: 0 known, later the pass), from what and with what weights.

    Mean over the axes of cubic interpolation across this pixel or, failing that, across it and one beside
    it; where no axis has second neighbours, linear interpolation; where no axis has both sides and no other
    pixel of the pass has, linear extrapolation or the neighbour's value.
    """
    left = at.shape[0]
    turn, sided = 0, True
    while left > 0:
        turn += 1
        filled = 0
        for m in range(at.shape[0]):
            i, j = at[m, 0], at[m, 1]
            if order[i, j] < turn:
                continue
            kinds = _kind(order, i, j, 0, turn), _kind(order, i, j, 1, turn)
            best = max(kinds[0], kinds[1])
            if best < (2 if sided else 1):
                continue
            share = 0.5 if kinds[0] == kinds[1] else 1.0
            for axis in range(2):
                if kinds[axis] == best:
                    _weigh(order, i, j, axis, turn, best, share, sources[m], weights[m])
            order[i, j] = turn
            filled += 1
        left -= filled
        if filled > 0:
            sided = True
        elif sided:
            sided = False
        else:
            break


@exact
def _is_known(order, i, j, turn):  # type: ignore[no-untyped-def]
    """Whether a pixel was filled before this pass."""
    return 0 <= i < order.shape[0] and 0 <= j < order.shape[1] and order[i, j] < turn


@exact
def _pair(order, i, j, di, dj, turn):  # type: ignore[no-untyped-def]
    """Distance, 1 or 2, of the nearest two known pixels in a row on that side; 0: there are none."""
    for away in (1, 2):
        first = _is_known(order, i + away * di, j + away * dj, turn)
        if first and _is_known(order, i + (away + 1) * di, j + (away + 1) * dj, turn):
            return away
        if first:
            return 0
    return 0


@exact
def _kind(order, i, j, axis, turn):  # type: ignore[no-untyped-def]
    """4, 3: cubic across one pixel, two; 2: linear; 1: from one side; 0: nothing beside."""
    di, dj = (1, 0) if axis == 0 else (0, 1)
    before, after = _pair(order, i, j, -di, -dj, turn), _pair(order, i, j, di, dj, turn)
    if before > 0 and after > 0 and before + after <= 3:
        return 6 - before - after
    return int(_is_known(order, i - di, j - dj, turn)) + int(_is_known(order, i + di, j + dj, turn))


@exact
def _weigh(order, i, j, axis, turn, kind, share, source, weight):  # type: ignore[no-untyped-def]
    di, dj = (1, 0) if axis == 0 else (0, 1)
    cols = order.shape[1]
    for side in range(2):
        sign = 2 * side - 1
        away = 1 if kind != 3 else _pair(order, i, j, sign * di, sign * dj, turn)
        a, b = i + away * sign * di, j + away * sign * dj
        if not _is_known(order, a, b, turn):
            continue
        near, far = 0.5, 0.0
        if kind == 4:
            near, far = 4.0 / 6.0, -1.0 / 6.0
        elif kind == 3:
            near, far = (1.0, -0.3) if away == 1 else (0.5, -0.2)
        elif kind == 1:
            near = 1.0
            if _is_known(order, a + sign * di, b + sign * dj, turn):
                near, far = 2.0, -1.0
        k = 4 * axis + 2 * side
        source[k], weight[k] = a * cols + b, near * share
        if far != 0.0:
            source[k + 1], weight[k + 1] = (a + sign * di) * cols + b + sign * dj, far * share


@exact
def _fill(field, pixels, sources, weights):  # type: ignore[no-untyped-def]
    for m in range(pixels.size):
        total = 0.0
        for k in range(8):
            if weights[m, k] != 0.0:
                total += weights[m, k] * field[sources[m, k]]
        field[pixels[m]] = total


@exact
def _gather(field, pixels, sources, weights):  # type: ignore[no-untyped-def]
    """The transpose of _fill."""
    for m in range(pixels.size - 1, -1, -1):
        for k in range(8):
            field[sources[m, k]] += weights[m, k] * field[pixels[m]]
        field[pixels[m]] = 0.0
