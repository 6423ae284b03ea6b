"""The gauge: from known distances to the free constant of every component: linear rows on the grid,
and their robust mean.
"""

from dataclasses import dataclass

import numpy as np

from optolever.errors import InputError

from ..arrays import Floats, Ints, Labels, Mask
from ..measured import Measured
from .anchors import EDGE_REACH, Samples

__all__ = ["AnchorRows", "anchor_rows", "free_constants"]

_THERE = 0.05  # pixels: an anchor so near needs no slopes
_STARTS = (-1, 0, -3, -2)  # where a window of four pixels may start, relative to the pixel; the best first


@dataclass(frozen=True, slots=True)
class AnchorRows:
    """Known values of the unknown near valid pixels, M of them.

    The value predicted at an anchor is w[pixel] + p[at_p] . by_p + q[at_q] . by_q: from the nearest valid
    pixel along the row, then along the column, by the cubic through four slopes. more_p: excess of the cubic
    over the parabola nearest to the same slopes; known: w there; reach: pixels travelled; sigma: of the known
    value, in units of w; component: label of the pixel.
    """

    pixel: Ints
    at_p: Ints
    by_p: Floats
    more_p: Floats
    at_q: Ints
    by_q: Floats
    known: Floats
    sigma: Floats
    reach: Floats
    component: Ints

    def predict(self, w: Floats, p: Floats, q: Floats) -> Floats:
        """Value of the unknown at the anchors, (M,)."""
        along_row = np.einsum("mk,mk->m", p.ravel()[self.at_p], self.by_p)
        along_col = np.einsum("mk,mk->m", q.ravel()[self.at_q], self.by_q)
        value: Floats = w.ravel()[self.pixel] + along_row + along_col
        return value

    def bend(self, p: Floats) -> Floats:
        """Excess of the cubic along the row over the parabola, (M,): above the cubic's error on a curve."""
        added: Floats = np.einsum("mk,mk->m", p.ravel()[self.at_p], self.more_p)
        return added

    def spread(self, var_p: Floats, var_q: Floats) -> Floats:
        """Variance that the way from the pixels adds, of the slopes', (M,)."""
        along_row = np.einsum("mk,mk->m", var_p.ravel()[self.at_p], self.by_p**2)
        along_col = np.einsum("mk,mk->m", var_q.ravel()[self.at_q], self.by_q**2)
        added: Floats = along_row + along_col
        return added


def anchor_rows(samples: Samples, data: Measured, labels: Labels) -> AnchorRows:
    """Tie the samples (in this grid's pixels) to the nearest valid pixels, except samples without one in
    reach or with fewer than four slopes on the way.
    """
    mask = data.mask
    row, col, found = _nearest(samples, mask)
    keep = np.flatnonzero(found)
    row, col = row[keep], col[keep]
    delta_row, delta_col = samples.row[keep] - row, samples.col[keep] - col
    start_p, whole_p = _windows(mask, row, col, 0, 1)
    start_q, whole_q = _windows(mask, row, col, 1, 0)
    told = (whole_p | (np.abs(delta_col) < _THERE)) & (whole_q | (np.abs(delta_row) < _THERE))
    keep, row, col = keep[told], row[told], col[told]
    delta_row, delta_col = delta_row[told], delta_col[told]
    start_p, start_q, whole_p, whole_q = start_p[told], start_q[told], whole_p[told], whole_q[told]
    by_p = np.where(whole_p[:, None], _integral(start_p, delta_col), _own(start_p, delta_col))
    by_q = np.where(whole_q[:, None], _integral(start_q, delta_row), _own(start_q, delta_row))
    pixel = row * mask.shape[1] + col
    index = np.arange(4)
    at_p = np.where(whole_p[:, None], pixel[:, None] + start_p[:, None] + index, pixel[:, None])
    more_p = np.where(whole_p[:, None], by_p - _integral(start_p, delta_col, 3), 0.0)
    rows_q = np.where(whole_q[:, None], row[:, None] + start_q[:, None] + index, row[:, None])
    at_q = rows_q * mask.shape[1] + col[:, None]
    distance = samples.distance[keep]
    unit = 1.0 / distance if data.rays.logarithmic else np.ones(distance.shape)
    return AnchorRows(
        pixel=pixel,
        at_p=at_p,
        by_p=by_p,
        more_p=more_p,
        at_q=at_q,
        by_q=by_q,
        known=data.unknown(distance),
        sigma=samples.sigma[keep] * unit,
        reach=np.hypot(delta_row, delta_col),
        component=labels[row, col].astype(np.int64),
    )


def free_constants(
    rows: AnchorRows, error: Floats, factor: Floats, spread: Floats, count: int
) -> tuple[Floats, Floats]:
    """The multiple of the integrating factor that each component needs, (count + 1,), and every row's share
    (M,) in it.

    error: predicted minus known (M,), spread: its variance; factor: integrating factor at the rows' pixels.
    The mean is weighted and leaves out rows farther than five scaled median deviations from the median.
    """
    constants = np.zeros(count + 1)
    share = np.zeros(error.shape)
    for label in np.unique(rows.component):
        pick = np.flatnonzero(rows.component == label)
        most = factor[pick].max()
        if not most > 0:
            raise InputError(
                "anchor: its error would grow beyond all numbers on the way to the other pixels; some next "
                "to the pattern's edge may be wrong: mask them, or calibrate the scene"
            )
        ratio, weight = error[pick] / factor[pick], (factor[pick] / most) ** 2 / spread[pick]
        middle = np.median(ratio)
        limit = 5 * 1.4826 * np.median(np.abs(ratio - middle)) + 1e-12 * np.abs(middle)
        if pick.size > 4:
            weight = np.where(np.abs(ratio - middle) <= limit, weight, 0.0)
        weight = weight / weight.sum()
        constants[label] = -float(weight @ ratio)
        share[pick] = weight
    return constants, share


def _nearest(samples: Samples, mask: Mask) -> tuple[Ints, Ints, Mask]:
    """The valid pixel nearest to each sample within EDGE_REACH."""
    rows, cols = mask.shape
    row0 = np.clip(np.rint(samples.row), 0, rows - 1).astype(np.int64)
    col0 = np.clip(np.rint(samples.col), 0, cols - 1).astype(np.int64)
    row, col, best = row0.copy(), col0.copy(), np.full(row0.shape, np.inf)
    reach = int(EDGE_REACH)
    for dr in range(-reach, reach + 1):
        for dc in range(-reach, reach + 1):
            r, c = np.clip(row0 + dr, 0, rows - 1), np.clip(col0 + dc, 0, cols - 1)
            away = np.where(mask[r, c], np.hypot(samples.row - r, samples.col - c), np.inf)
            closer = away < best
            row, col, best = np.where(closer, r, row), np.where(closer, c, col), np.minimum(away, best)
    return row, col, best <= EDGE_REACH + 0.25


def _windows(mask: Mask, row: Ints, col: Ints, dr: int, dc: int) -> tuple[Ints, Mask]:
    """Start of four valid pixels in a row (dc = 1) or column (dr = 1) around each pixel,
    and whether there are any.
    """
    start = np.zeros(row.shape, dtype=np.int64)
    whole = np.zeros(row.shape, dtype=np.bool_)
    for candidate in _STARTS:
        fits = np.ones(row.shape, dtype=np.bool_)
        for k in range(candidate, candidate + 4):
            r, c = row + k * dr, col + k * dc
            inside = (r >= 0) & (r < mask.shape[0]) & (c >= 0) & (c < mask.shape[1])
            fits &= inside & mask[np.where(inside, r, 0), np.where(inside, c, 0)]
        start = np.where(fits & ~whole, candidate, start)
        whole |= fits
    return start, whole


def _integral(start: Ints, delta: Floats, terms: int = 4) -> Floats:
    """Weights (M, 4) of the integral from 0 to delta of the cubic (the nearest parabola: terms 3) through
    nodes start .. start + 3.
    """
    moments = delta[:, None] ** np.arange(1, terms + 1) / np.arange(1, terms + 1)
    out = np.empty((len(start), 4))
    for candidate in np.unique(start):
        powers = (candidate + np.arange(4.0))[:, None] ** np.arange(terms)
        pick = start == candidate
        out[pick] = moments[pick] @ np.linalg.pinv(powers)
    return out


def _own(start: Ints, delta: Floats) -> Floats:
    """Weights for a constant slope, that of the pixel."""
    out = np.zeros((*start.shape, 4))
    out[:, 0] = delta
    return out
