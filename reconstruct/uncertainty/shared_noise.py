"""Variance of the height by noise that pixels have in common (see decode.SharedNoise).

Rows: an error e(y) cos(k x) of a slope, e independent from row to row, is answered by the least-squares solve
with e * exp(-k |y|) / 2, whichever slope it is of: the sum of squares is the slope's variance over 4 k. Where
the phase does not turn along the row (k = 0) errors of slopes down the columns add up on the way from the
anchors: edge j below a pixel takes 1 - A_j of its error, one above it A_j, where A_j is
the anchors' share above it; a turning phase ends that walk where the pixel's and the anchors' errors are
independent. Errors of slopes along the row, which are no gradient, leave an eighth of the row's length at its
ends (the odd cosines' share of a constant), less within. Columns: the same.

Frames: an error that is the cosine of the phase all over the image is a wave of the slope; its height is the
slope's over the wave number. A common shift of the coordinates adds the square of the solve's response to it.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from optolever.decode import SharedNoise

from ..arrays import Floats, Ints, Labels, Pair
from ..problem import Problem
from ..solver.newton import State, edge_errors, response

__all__ = ["shared_variance"]

_COLUMNS = 128  # sampled for medians
_STILL = 1e-9  # radians per pixel: no turn in any image
_ENDS = 8.0  # one over the share of a row's length that slopes along it leave, about


def shared_variance(problem: Problem, state: State, noise: SharedNoise) -> Floats:
    """Variance of w in every pixel of the grid, (rows, cols), in addition to that of independent noise."""
    data, labels = problem.data, problem.labels
    seen = labels > 0
    by_rows, by_cols = (noise.cols, noise.rows) if problem.turned else (noise.rows, noise.cols)
    at = np.divmod(state.rows.pixel, seen.shape[1])
    component, count = state.rows.component, int(labels.max()) + 1
    anchors = _Anchors(*at, component, state.share, count)
    turned = _Anchors(*at[::-1], component, state.share, count)
    factor2, total = np.broadcast_to(state.root**4, seen.shape), np.zeros(seen.shape)
    alone = replace(data, sigma_v=np.zeros(seen.shape)).variances(state.w)
    of_u = [np.fmin(one, both) for one, both in zip(alone, state.variances, strict=True)]
    of_v = [both - one for one, both in zip(of_u, state.variances, strict=True)]
    for turns, frames, coordinate, variances in (
        (noise.turns_u, noise.frames_u, data.u, of_u),
        (noise.turns_v, noise.frames_v, data.v, of_v),
    ):
        p, q = (np.where(seen, one / factor2, np.nan) for one in variances)
        phase = np.where(seen, 2 * np.pi * turns * coordinate, np.nan)
        if frames > 0:
            total += frames * _of_frames(phase, p + q, labels, anchors)
        if by_rows > 0:
            total += by_rows * _of_rows(phase, (p, q), labels, anchors)
        if by_cols > 0:
            total += by_cols * _of_rows(phase.T, (q.T, p.T), labels.T, turned).T
    found = factor2 * total
    for shift in ((noise.shift_u, 0.0), (0.0, noise.shift_v)):
        if any(shift):
            found += np.square(_answer(problem, state, shift))
    return np.asarray(np.where(seen, found, 0.0))


def _answer(problem: Problem, state: State, shift: tuple[float, float]) -> Floats:
    """Error of w where u and v are off by the same everywhere, pattern px."""
    data, nothing = problem.data, np.zeros(problem.labels.shape)
    at = data.slopes(state.w)[:2]
    moved = data.shifted(nothing + shift[0], nothing + shift[1]).slopes(state.w)[:2]
    p, q = (np.where(data.mask, one - other, 0.0) for one, other in zip(moved, at, strict=True))
    known = np.zeros(state.rows.known.shape)
    return response(problem.labels, state, edge_errors(data, state, (p, q)), (p, q), known)


class _Anchors(NamedTuple):
    """Row, column and component of every anchor, and its share in the component's constant, all (M,);
    components: how many labels there are (some may have no anchor, 0 is none)."""

    row: Ints
    col: Ints
    component: Ints
    share: Floats
    components: int

    def by_row(self, rows: int, weight: Any = 1.0) -> Floats:
        """Sums (C, rows) of the shares, times a weight (M,)."""
        sums = np.zeros((self.components, rows))
        np.add.at(sums, (self.component, self.row), self.share * weight)
        return sums


def _of_frames(phase: Floats, variance: Floats, labels: Labels, anchors: _Anchors) -> Floats:
    """Of noise common to the image: phase of the fringe, variance of both slopes."""
    waves = _turn(phase) ** 2 + _turn(phase.T) ** 2 + 1 / max(labels.shape) ** 2
    own = variance / waves
    known = anchors.by_row(len(own), anchors.share * own[anchors.row, anchors.col]).sum(axis=1)
    return np.asarray(own + known[labels])


def _of_rows(phase: Floats, variances: Pair, labels: Labels, anchors: _Anchors) -> Floats:
    """Of noise common to each row: phase of the fringe; variances of the slopes along the rows and down the
    columns, NaN outside the mask."""
    rows, cols = labels.shape
    k, usual = max(_turn(phase), _STILL), np.zeros(rows)
    some = _thin(variances[1])
    lines = ~np.isnan(some).all(axis=1)
    usual[lines] = np.nanmedian(some[lines], axis=1)
    along, down = variances[0] / (4 * k + _ENDS / cols), variances[1] / (4 * k)
    of_anchors = [
        np.square(anchors.by_row(rows, np.sqrt(one[anchors.row, anchors.col]))).sum(axis=1)
        for one in (along, down)
    ]
    apart = usual / (4 * k) + of_anchors[1][:, None]
    walk = _walk(usual, anchors.by_row(rows))
    walk *= apart / np.maximum(walk + apart, np.finfo(float).tiny)
    return np.asarray(walk[labels, np.arange(rows)[:, None]] + along + of_anchors[0][labels])


def _turn(phase: Floats) -> float:
    """Median absolute change of a phase from pixel to pixel along the rows, radians."""
    turned = np.abs(_thin(np.diff(phase)))
    known = turned[np.isfinite(turned)]
    return float(np.median(known)) if known.size else 0.0


def _thin(values: Floats) -> Floats:
    """Some of the columns."""
    return values[:, :: max(1, values.shape[1] // _COLUMNS)]


def _walk(variance: Floats, anchors: Floats) -> Floats:
    """Variance (C, rows) of running sums of errors down the rows, of variances (rows,), less their mean by
    the anchors' shares (C, rows)."""
    edges = 0.5 * (variance[1:] + variance[:-1])
    beyond = np.cumsum(anchors[:, :0:-1], axis=1)[:, ::-1]
    before = np.cumsum(edges * (1 - beyond) ** 2, axis=1)
    after = np.cumsum((edges * beyond**2)[:, ::-1], axis=1)[:, ::-1]
    walk: Floats = np.pad(before, ((0, 0), (1, 0))) + np.pad(after, ((0, 0), (0, 1)))
    return walk
