"""Variance of the height from drawn noise, where no network of blocks stands for what a mask leaves.

Noise as announced is drawn into u and v and carried through the equations, the solve and the anchors. A few
draws tell the variance of single pixels poorly, but its ratio to an estimate well once it is averaged over a
block, as the estimate has the shape right; pixel and block then count by how many draws each is worth.
"""

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from .measured import Measured
from .newton import State, response

__all__ = ["settled"]

Floats = NDArray[np.float64]
Labels = NDArray[np.int32]

_DRAWS = 48
_PIXELS = 1 << 22  # solved in all: fewer draws for large images
_FEWEST = 4
_PRIOR = 6.0  # draws that a block's mean ratio counts as
_BLOCK = 25  # pixels
_SEED = 20140318


def settled(data: Measured, state: State, labels: Labels, estimate: Floats) -> Floats:
    """The variance of w, (rows, cols): the estimate corrected by drawn noise."""
    inside = labels > 0
    count = int(np.clip(_PIXELS // np.count_nonzero(inside), _FEWEST, _DRAWS))
    rng = np.random.default_rng(_SEED)
    total = np.zeros(estimate.shape)
    for _ in range(count):
        total += _drawn(data, state, labels, rng) ** 2
    ratio = np.where(inside, total / (count * estimate), 0.0)
    share = scipy.ndimage.uniform_filter(inside.astype(np.float64), _BLOCK)
    nearby = scipy.ndimage.uniform_filter(ratio, _BLOCK) / np.maximum(share, 1e-3)
    combined = (count * ratio + _PRIOR * nearby) / (count + _PRIOR)
    return np.where(inside, estimate * combined, estimate)


def _drawn(data: Measured, state: State, labels: Labels, rng: np.random.Generator) -> Floats:
    """One answer of the solution to noise, and to what is in doubt of the edges."""
    mask = data.mask
    p, q = data.slopes(state.w)[:2]
    du, dv = (
        np.where(mask, sigma, 0.0) * rng.standard_normal(mask.shape) for sigma in (data.sigma_u, data.sigma_v)
    )
    noisy_p, noisy_q = data.shifted(du, dv).slopes(state.w)[:2]
    errors = np.where(mask, noisy_p - p, 0.0), np.where(mask, noisy_q - q, 0.0)
    edges = None
    if state.doubt is not None:
        dx, dy = state.doubt[:2]
        edges = dx * rng.standard_normal(mask.shape), dy * rng.standard_normal(mask.shape)
    known = state.rows.sigma * rng.standard_normal(state.rows.sigma.shape)
    return response(data, labels, state, errors, edges, known)
