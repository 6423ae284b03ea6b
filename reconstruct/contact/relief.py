"""The height map in which dents are looked for: enclosed holes interpolated, errors of the rig levelled."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.ndimage
import scipy.sparse
import scipy.sparse.linalg
from numpy.typing import NDArray

from ..arrays import Floats, Ints, Mask
from ..heightmap import HeightFlag, HeightMap
from ..outputs.resampling import natural_pitch
from ..outputs.slope_map import SlopeMap

__all__ = ["Relief", "flat", "levelled"]

_LARGEST = 20_000  # pixels of all holes: more are not interpolated
_SAMPLES = 4000  # pixels that level the map
_INDEPENDENT = 36  # samples of them
_ROUNDS = 12  # of reweighting
_SPREAD = 1.4826  # standard deviation over median absolute deviation


@dataclass(frozen=True, slots=True)
class Relief:
    """(H, W) each: x, y, z, sigma and modes (r, H, W) in mm, with holes interpolated.

    measured: pixels of the map; known: these and the interpolated ones; error: of the interpolation, mm, 0
    where measured; cell: area of a pixel on the mirror, mm^2; pitch: its side, mm.
    """

    x: Floats
    y: Floats
    z: Floats
    sigma: Floats
    modes: NDArray[np.float32]
    measured: Mask
    known: Mask
    error: Floats
    cell: Floats
    pitch: float

    @classmethod
    def of(cls, height: HeightMap, slopes: SlopeMap) -> "Relief | None":
        """Of pixels unflagged or STEEP alone; None without three at (i, j), (i + 1, j) and (i, j + 1)."""
        measured = (height.flags & ~np.uint16(HeightFlag.STEEP)) == 0
        spread = height.sigma + slopes.sigma_x + slopes.sigma_y
        measured &= np.isfinite(height.z) & np.isfinite(spread) & (slopes.sigma_x > 0) & (slopes.sigma_y > 0)
        if not (measured[:-1, :-1] & measured[1:, :-1] & measured[:-1, 1:]).any():
            return None
        modes = np.zeros((0, *measured.shape), np.float32)
        if height.calibration is not None:
            modes = height.calibration
        fields = np.stack([height.x, height.y, height.z, height.sigma])
        holes = scipy.ndimage.binary_fill_holes(measured) & ~measured
        error = np.zeros(measured.shape)
        if 0 < np.count_nonzero(holes) <= _LARGEST:
            modes = modes.copy()
            rough = _interpolated(fields[2:3], measured, holes, 2)
            fields[:, holes] = _interpolated(fields, measured, holes, 3)
            modes[:, holes] = _interpolated(modes, measured, holes, 2)
            error[holes] = np.abs(fields[2, holes] - rough[0])
            fields[3, holes] = _largest_around(height.sigma, measured, holes)
        else:
            holes = np.zeros_like(measured)
        x, y, z, sigma = fields
        pitch = natural_pitch(height.x, height.y, measured)
        return cls(x, y, z, sigma, modes, measured, measured | holes, error, _cells(x, y), pitch)


def _interpolated(fields: NDArray[np.floating[Any]], measured: Mask, holes: Mask, order: int) -> Floats:
    """Fields (k, H, W) in the holes, (k, N): with the smallest sum of squares of the Laplacian (order 2), or
    of its gradient (order 3), over the holes and the pixels around them.
    """
    near = scipy.ndimage.binary_dilation(holes, np.ones((3, 3)), order) & (measured | holes)
    number = np.full(near.shape, -1)
    number[near] = np.arange(int(near.sum()))
    row, col = np.nonzero(near[1:-1, 1:-1])
    row, col = row + 1, col + 1
    around = np.stack([number[row + i, col + j] for i, j in ((0, 0), (0, 1), (0, -1), (1, 0), (-1, 0))])
    whole = (around >= 0).all(axis=0)
    around, row, col = around[:, whole], row[whole], col[whole]
    size = around.shape[1]
    weights = np.repeat([-4.0, 1.0, 1.0, 1.0, 1.0], size)
    operator = scipy.sparse.csr_array(
        (weights, (np.tile(np.arange(size), 5), around.ravel())), shape=(size, int(near.sum()))
    )
    if order == 3:
        place = np.full(near.shape, -1)
        place[row, col] = np.arange(size)
        operator = (
            scipy.sparse.vstack(
                [_difference(place[:, :-1], place[:, 1:], size), _difference(place[:-1], place[1:], size)]
            )
            @ operator
        )
    # where nothing is smoothed (a corner), a weak pull to the neighbours keeps the solution
    weak = scipy.sparse.vstack(
        [
            _difference(number[:, :-1], number[:, 1:], int(near.sum())),
            _difference(number[:-1], number[1:], int(near.sum())),
        ]
    )
    operator = scipy.sparse.vstack([operator, 1e-6 * weak]).tocsc()
    free = holes[near]
    normal = (operator[:, free].T @ operator[:, free]).tocsc()
    known = operator[:, ~free] @ fields[:, near][:, ~free].T
    solve = scipy.sparse.linalg.factorized(normal)
    rhs = -(operator[:, free].T @ known)
    return np.array([solve(part) for part in rhs.T]).reshape(len(fields), np.count_nonzero(free))


def _largest_around(sigma: Floats, measured: Mask, holes: Mask) -> Floats:
    """For every pixel of the holes the largest sigma of the pixels around its hole."""
    labels, count = scipy.ndimage.label(holes, np.ones((3, 3)))
    near = scipy.ndimage.grey_dilation(labels, size=(3, 3))
    largest = scipy.ndimage.maximum(sigma, np.where(measured, near, 0), np.arange(count + 1))
    found: Floats = np.asarray(largest, dtype=np.float64)[labels[holes]]
    return found


def _difference(first: Ints, second: Ints, size: int) -> scipy.sparse.csr_array:
    """Rows that take the value at one number from that at another, where both are numbers."""
    both = (first >= 0) & (second >= 0)
    one, two = first[both].astype(np.intp), second[both].astype(np.intp)
    rows = np.arange(one.size)
    values = np.repeat([-1.0, 1.0], one.size)
    return scipy.sparse.csr_array(
        (values, (np.tile(rows, 2), np.concatenate([one, two]))), shape=(one.size, size)
    )


def flat(field: NDArray[np.floating[Any]]) -> Floats:
    """A field (..., H, W) with its pixels in one axis."""
    pixels: Floats = np.asarray(field).reshape(*field.shape[:-2], field.shape[-2] * field.shape[-1])
    return pixels


def _cells(x: Floats, y: Floats) -> Floats:
    """Area of the mirror (in x and y) that belongs to every pixel, mm^2."""
    x0, x1 = np.gradient(x)
    y0, y1 = np.gradient(y)
    area = np.abs(x0 * y1 - x1 * y0)
    areas: Floats = np.where(np.isfinite(area), area, np.nanmedian(area))
    return areas


def levelled(relief: Relief) -> Floats:
    """Heights (H, W) less the quadratic part of the rig's errors that most of the map shows, for detection.

    The coefficients of the modes have prior variance 1; Cauchy's weights keep dents out. Samples count as
    _INDEPENDENT of them, as dents and their tails are as wide.
    """
    if not len(relief.modes):
        return relief.z
    places = np.flatnonzero(relief.measured)
    places = places[:: max(1, places.size // _SAMPLES)]
    basis = _quadratic(relief)
    forms = flat(basis)[:, places]
    parts = np.linalg.lstsq(forms.T, flat(relief.modes)[:, places].T.astype(np.float64), rcond=None)[0]
    terms = parts.T @ forms
    z, noise = relief.z.ravel()[places], relief.sigma.ravel()[places]
    share = min(1.0, _INDEPENDENT / places.size)
    found = np.zeros(len(terms))
    for _ in range(_ROUNDS):
        residual = z - found @ terms
        weight = share / (np.maximum(noise, _SPREAD * np.median(np.abs(residual))) ** 2 + residual**2)
        normal = (terms * weight) @ terms.T + np.eye(len(terms))
        found = np.linalg.solve(normal, (terms * weight) @ z)
    levels: Floats = relief.z - np.tensordot(parts @ found, basis, 1)
    return levels


def _quadratic(relief: Relief) -> Floats:
    """1, x, y, x^2, x y, y^2 over the map, (6, H, W)."""
    x, y = (
        (part - np.nanmean(part)) / max(float(np.nanstd(part)), relief.pitch) for part in (relief.x, relief.y)
    )
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y])
