"""The height's variance by noise, as a list of sources that add up.

| source | its error fields (see `monte_carlo`) |
|---|---|
| NOISE | noise of every pixel: in closed form, or drawn |
| SHARED | of u or v: a shift; cosine and sine of the phase, of frames; drawn, of rows and columns |
| LENS | of u and v together, see `lens_errors` |
| CELLS | the sawtooth of a discrete code, over the places where its cells may begin |
| ANCHORS | of every known value; the response is the integrating factor |
| BEND | of the ways to the anchors in common (`AnchorRows.bend`), likewise |
| DOUBTS | of edges in doubt that the solve does not go around, drawn |

A discrete code yields the middle of the cell at which a pixel looks. Where sampling is commensurate (one cell
a pixel, two, one and a half) regions share one error. The measured coordinates, smoothed, are rounded again
with the cells begun elsewhere (a parametric bootstrap: Efron, 10.1214/aos/1176344552).

The closed form of NOISE, after the least-squares solve and the anchors. With independent edge noise of
variance var_e the solve w = E g has the covariance E L^-1 E, L = D^T w D. In the DCT basis along the rows L
is tridiagonal, and two Schur sweeps give the diagonal of its inverse, mode by mode. Edges share pixels: an
edge averages the slopes of its neighbours, A A^T = 1 - |..|, so that the covariance is smaller,

    E L^-1 E - c,    c = < sum_a w_a l_a (1 - |A_a|^2) / (sum_a w_a l_a)^2 >,   l = 2 - 2 cos k, a = x, y,

averaged over the Brillouin zone: c is local (the correction is an operator of order zero), about a fifth of
the slopes' variance; all of this is for weights by columns. |A| = (13 cos(k/2) - cos(3k/2)) / 12 for the
four-pixel increments.
An anchor sum_m a_m w_m = known subtracts the covariance with it: var_i = G_ii - 2 (G a)_i + a.G a.
"""

from collections.abc import Iterator
from functools import lru_cache
from itertools import islice

import cv2
import numpy as np
import scipy.fft
import scipy.ndimage
from numpy.typing import NDArray

from optolever.arrays import Floats, Labels, Mask, Pair
from optolever.blocks import on_cores, threads
from optolever.decode import Correspondence, SharedNoise

from ..measured import Measured
from ..problem import Problem
from ..solver.newton import State
from ..solver.poisson import ColumnPoisson
from .monte_carlo import FLOOR, ErrorField, drawn_doubts, monte_carlo_variance, smoothed, variance_by

__all__ = [
    "ANCHORS", "BEND", "CELLS", "DOUBTS", "LENS", "NOISE", "SHARED", "anchor_response", "averaging_gain",
    "edge_diagonal", "lens_errors", "noise_sources", "unknown_variance",
]  # fmt: skip

NOISE, SHARED = "noise of the frames, independent", "noise that pixels have in common"
LENS = "blur of the lens, which was not given"
CELLS = "cells of a discrete code"
DOUBTS = "slopes that change too fast between pixels"
ANCHORS, BEND = "known heights of the anchors", "curvature between mirror and anchors"
_DRAWS, _FEWEST = 32, 8
_PIXELS = 1 << 22  # solved in all: fewer draws for large images
_SEED = 20140318
_PLACES = 8  # of the cells' beginning
_SMOOTH = 4.0  # pixels, rms: over more than the sawtooth of two cells a pixel
_CLEAN = np.ones((5, 5), np.uint8)  # as the decoder asks before it takes the aperture off
_SMALL, _LARGE = 1e-6, 1e6


def noise_sources(
    problem: Problem, state: State, gain: Floats, shared: SharedNoise | None, lens: Pair | None
) -> dict[str, Floats]:
    """Variance of the unknown (rows, cols) by every source of noise, in words; NOISE first. gain (rows,
    cols): see `holes.noise_gain`; lens: see `lens_errors`."""
    found = {NOISE: gain * unknown_variance(problem.data, state, problem.labels)}
    if shared is not None:
        common = variance_by(problem, state, _shared(problem, shared))
        found |= {SHARED: common} if common.any() else {}
    if lens is not None:
        field = ErrorField(problem.to_grid(lens[0]), problem.to_grid(lens[1]))
        found[LENS] = variance_by(problem, state, [field])
    if problem.data.whole_cells(problem.bridged):
        found[CELLS] = variance_by(problem, state, _cells(problem))
    if state.doubt is not None and state.problem.closed:
        found[DOUBTS] = variance_by(problem, state, _doubts(problem, state))
    return found | {name: each for name, each in _anchors(problem.labels, state).items() if each.any()}


def anchor_response(labels: Labels, state: State, known: Floats) -> Floats:
    """Change of the unknown (rows, cols) when all known values change by `known` (M,) at once."""
    rows, factor = state.rows, np.broadcast_to(state.root**2, labels.shape)
    moved = state.share / factor.ravel()[rows.pixel] * known
    changed: Floats = factor * np.bincount(rows.component, moved, int(labels.max()) + 1)[labels]
    return changed


def _anchors(labels: Labels, state: State) -> dict[str, Floats]:
    rows, factor = state.rows, np.broadcast_to(state.root**2, labels.shape)
    moved, count = state.share / factor.ravel()[rows.pixel], int(labels.max()) + 1
    alone = np.bincount(rows.component, np.square(moved * rows.sigma), count)
    together = np.square(anchor_response(labels, state, state.bend))
    return {ANCHORS: factor**2 * alone[labels], BEND: together}


def _shared(problem: Problem, noise: SharedNoise) -> Iterator[ErrorField]:
    data, shape, nothing = problem.data, problem.labels.shape, np.zeros(problem.labels.shape)
    lines, waves = noise.rows > 0 or noise.cols > 0, []
    of_u = noise.turns_u, noise.frames_u, data.u, data.sigma_u
    of_v = noise.turns_v, noise.frames_v, data.v, data.sigma_v
    for axis, (turns, frames, at, sigma) in enumerate((of_u, of_v)):
        if not (frames > 0 or lines):
            continue
        phase = 2 * np.pi * turns * np.where(data.mask, at, 0.0)
        waves.append(np.where(data.mask, sigma, 0.0) * np.stack([np.cos(phase), np.sin(phase)]))
        for field in np.sqrt(frames) * waves[-1] if frames > 0 else ():
            yield ErrorField(nothing, field) if axis else ErrorField(field, nothing)
    count = int(np.clip(_PIXELS // nothing.size, _FEWEST, _DRAWS)) if lines else 0
    rng = np.random.default_rng(_SEED)
    for _ in range(count):
        rows, cols = rng.standard_normal((2, 2, shape[0], 1)), rng.standard_normal((2, 2, 1, shape[1]))
        drawn = np.sqrt(noise.rows / count) * rows + np.sqrt(noise.cols / count) * cols
        yield ErrorField(*((part * wave).sum(axis=0) for part, wave in zip(drawn, waves, strict=True)))


def _cells(problem: Problem) -> Iterator[ErrorField]:
    data = problem.data
    smooth = [_twiced(coord, data.mask) for coord in (data.u, data.v)]
    # misread neighbours make sigma larger than a cell's 1 / sqrt(12), and share their errors likewise
    widths = [np.sqrt(12.0) * np.where(data.mask, sigma, 0.0) for sigma in (data.sigma_u, data.sigma_v)]
    cells = [float(width[data.mask].min()) for width in widths]
    for k in range(_PLACES):
        # 3 k mod 8 keeps u and v out of step
        begins = ((k + 0.5) / _PLACES, ((3 * k) % _PLACES + 0.5) / _PLACES)
        places = [coord / cell + begin for coord, cell, begin in zip(smooth, cells, begins, strict=True)]
        of_u, of_v = (
            width / np.sqrt(_PLACES) * (np.rint(at) - at) for width, at in zip(widths, places, strict=True)
        )
        yield ErrorField(of_u, of_v)


def _doubts(problem: Problem, state: State) -> Iterator[ErrorField]:
    """Draws of the doubts, see `drawn_doubts`."""
    rng, nothing = np.random.default_rng(_SEED), np.zeros(state.w.shape)
    assert state.doubt is not None
    alone, size = 1 / np.sqrt(3.0 * _FEWEST), 1 / np.sqrt(_FEWEST)
    draws = drawn_doubts(state.doubt, state.w - problem.data.rest(), rng)
    for own, common in islice(draws, _FEWEST):
        yield ErrorField(nothing, nothing, own.times(alone).plus(common.times(size)))


def _twiced(coord: Floats, mask: Mask) -> Floats:
    """Smoothed, plus the smoothed residual, which restores curvature (twicing: Tukey, Exploratory Data
    Analysis, 1977): the slope determines where sampling is commensurate."""
    once = smoothed(coord, mask, _SMOOTH)
    return once + smoothed(coord - once, mask, _SMOOTH)


def lens_errors(seen: Correspondence, rest: Correspondence | None) -> Pair | None:
    """Errors of u and v (H, W) by one standard deviation of the lens, less those that the rest capture has
    in common; None: the lens was given, or the code's places are cells."""
    noise = seen.shared_noise
    if noise is None or not (noise.lens_u or noise.lens_v):
        return None
    errors = _brackets(seen)
    if rest is not None:
        errors = errors - _brackets(rest)
    return noise.lens_u * errors[0], noise.lens_v * errors[1]


def _brackets(seen: Correspondence) -> Floats:
    """laplace u + 2 grad u . grad ln A, of v likewise (2, H, W), a place's shift over half the aperture's
    second moment: the mean of 3 x 3 pixels; 0 beside pixels that are not good."""
    usable = seen.good & np.isfinite(seen.u) & np.isfinite(seen.v)
    light = np.ones(usable.shape) if seen.amplitude is None else np.nan_to_num(seen.amplitude)
    # of a damaged file both may be anything
    log = np.where(usable, np.log(np.clip(light, _SMALL, 2.0**16)), 0.0).astype(np.float64)
    falls = _slopes(log)
    good = cv2.erode(usable.view(np.uint8), _CLEAN, borderType=cv2.BORDER_CONSTANT, borderValue=0)

    def bracket(at: NDArray[np.floating]) -> Floats:
        place = np.where(usable, np.clip(at, -_LARGE, _LARGE), 0.0).astype(np.float64)
        shift: Floats = np.asarray(cv2.Laplacian(place, cv2.CV_64F), np.float64)
        for rise, fall in zip(_slopes(place), falls, strict=True):
            shift += 2.0 * rise * fall
        shift *= good
        return np.asarray(cv2.blur(shift, (3, 3)))

    return np.stack(on_cores(bracket, (seen.u, seen.v)))


def _slopes(values: Floats) -> Pair:
    """By the neighbours on either side, along columns and rows (H, W)."""
    difference = np.array([[-0.5, 0.0, 0.5]])
    along, down = (cv2.filter2D(values, cv2.CV_64F, part) for part in (difference, difference.T))
    return np.asarray(along), np.asarray(down)


def unknown_variance(data: Measured, state: State, labels: Labels) -> Floats:
    """Variance of w in every pixel, (rows, cols): the closed form on a rectangle with weights by
    columns; else drawn noise (see `monte_carlo`).
    """
    rows, problem = state.rows, state.problem
    factor = np.broadcast_to(state.root**2, state.w.shape)
    columns = problem.columns
    at = factor.ravel()[rows.pixel]
    along_rows = 1.0 / columns.wy
    # of the edges on either side of a pixel
    edges = np.pad(1.0 / columns.wx[:-1], 1, mode="edge") if len(columns.wx) > 1 else along_rows.repeat(2)
    along_cols = 0.5 * (edges[:-1] + edges[1:])
    # what is averaged is no noisier than its neighbours
    gain = scipy.ndimage.minimum_filter1d(averaging_gain(along_cols, along_rows), 3)
    share = state.share / state.share.sum()
    own = share**2 * (rows.spread(*state.variances) / at**2 - gain[rows.pixel % gain.size])
    load: Floats = np.bincount(rows.pixel, share, labels.size).astype(np.float64).reshape(labels.shape)
    potential = columns.solve(load)
    constant = float(share @ potential.ravel()[rows.pixel]) + own.sum()
    potential *= -2.0
    potential += constant
    potential += edge_diagonal(columns)
    potential -= gain
    variance: Floats = np.maximum(potential, FLOOR * along_cols, out=potential)
    variance *= factor**2
    if problem.weights is not None:
        return monte_carlo_variance(data, state, labels, variance, load)
    return variance


def averaging_gain(var_p: Floats, var_q: Floats) -> Floats:
    """Decrease of the height's variance by the averaging of neighbouring slopes, same shape."""
    ratios, values = _gain_table()
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.log(var_p / var_q)
    gain: Floats = var_p * np.interp(ratio, ratios, values)
    return gain


@lru_cache(maxsize=1)
def _gain_table() -> tuple[Floats, Floats]:
    """c / var_p as a function of log(var_p / var_q), by the midpoint rule over the Brillouin zone."""
    count = 128
    k = np.pi * (np.arange(count) + 0.5) / count
    transfer = (13 * np.cos(k / 2) - np.cos(3 * k / 2)) / 12
    l = 2 - 2 * np.cos(k)
    lost = l * (1 - transfer**2)
    ratios = np.linspace(np.log(1e-3), np.log(1e3), 61)
    values = [float(np.mean((lost[:, None] + r * lost) / (l[:, None] + r * l) ** 2)) for r in np.exp(ratios)]
    return ratios, np.array(values)


def edge_diagonal(columns: ColumnPoisson) -> Floats:
    """Diagonal of the rectangle's inverse, (rows, cols): sum_k v_k(col) phi_k(row)^2,
    symmetric in the rows.
    """
    modes, rows = columns.inverse_diagonal(), columns.rows
    # phi_k^2 = (1 + cos 2 k x) / rows, x = pi (row + 1/2) / rows: itself a sum of cosines, 2 k folded back
    even, low, high = np.zeros(modes.shape), np.arange(1, (rows + 1) // 2), np.arange(rows // 2 + 1, rows)
    even[0] = modes.sum(axis=0)
    even[2 * low] = 0.5 * modes[low]
    even[2 * (rows - high)] -= 0.5 * modes[high]
    found: Floats = scipy.fft.dct(even, type=3, axis=0, overwrite_x=True, workers=threads())
    return found / rows
