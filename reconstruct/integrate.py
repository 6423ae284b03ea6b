"""integrate(): a gradient field to heights, without a scene.

The least-squares heights of edge increments g solve D^T w D z = D^T w g: by a cosine transform along the rows
and a tridiagonal system along the columns on a full rectangle whose weights go by columns, else by conjugate
gradients on multigrid (see `poisson`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.ndimage
from numpy.typing import ArrayLike

from optolever.arrays import Floats, Labels, Mask, Pair
from optolever.errors import InputError

from .solver.edges import edge_weights, increments
from .solver.poisson import Accuracy, edge_problem

__all__ = ["Integral", "integrate"]

_ONE = np.ones((1, 1))
_ACCURACY = Accuracy(relative=1e-12)


@dataclass(frozen=True, slots=True)
class Integral:
    """Heights z (H, W), NaN outside the mask, of mean zero in every connected component.

    iterations: of linear solves; defect: rms difference between edge increments and heights, in units of z;
    components: labels (H, W), 0 outside.
    """

    z: Floats
    iterations: int
    defect: float
    components: Labels


def integrate(
    gx: ArrayLike,
    gy: ArrayLike,
    *,
    mask: ArrayLike | None = None,
    weights: ArrayLike | tuple[ArrayLike, ArrayLike] | None = None,
    spacing: float | tuple[float, float] = 1.0,
) -> Integral:
    """Heights whose slopes are gx = dz/dx (along columns) and gy = dz/dy (along rows), in the least-squares
    sense.

    gx, gy (H, W): sampled at pixels, NaN where unknown; mask (H, W): pixels to use; weights (H, W) or a pair
    of them for gx and gy: inverse variances; spacing: of the pixels, or (dx, dy). Raises InputError for input
    that does not fit.

    >>> import numpy as np
    >>> row, column = np.mgrid[:32, :48]
    >>> plane = integrate(np.full((32, 48), 0.5), np.full((32, 48), -0.25)).z
    >>> bool(np.allclose(plane, 0.5 * (column - 23.5) - 0.25 * (row - 15.5)))
    True
    """
    p, q, inside = _checked(gx, gy, mask)
    dx, dy = _steps(spacing)
    if not inside.any():
        raise InputError("mask: no pixel with a gradient is left")
    wp, wq = _weights(weights, p.shape, inside)
    edges, edge = increments(p * dx, q * dy, inside), edge_weights(1.0 / wp, 1.0 / wq, _ONE, inside)
    found = edge_problem(*edge, inside).solve(*edges, _ACCURACY)
    labels = scipy.ndimage.label(inside)[0].astype(np.int32)
    left, count = _residuals(edges, edge, found.x), sum(int(np.count_nonzero(w)) for w in edge)
    rms = math.sqrt(sum(float(np.einsum("ij,ij->", r, r)) for r in left) / max(count, 1))
    return Integral(_centred(found.x, labels), found.iterations, rms, labels)


def _checked(gx: ArrayLike, gy: ArrayLike, mask: ArrayLike | None) -> tuple[Floats, Floats, Mask]:
    """Slopes, and the pixels to use."""
    p, q = (np.ascontiguousarray(g, dtype=np.float64) for g in (gx, gy))
    if p.ndim != 2 or p.shape != q.shape:
        raise InputError(f"gradient: gx has shape {p.shape}, gy {q.shape}; must be equal and 2-D")
    inside = np.isfinite(p) & np.isfinite(q)
    if mask is not None:
        if np.shape(mask) != p.shape:
            raise InputError(f"mask: shape {np.shape(mask)}, must be {p.shape} as the gradient")
        inside &= np.asarray(mask, dtype=np.bool_)
    return p, q, inside


def _steps(spacing: float | tuple[float, float]) -> tuple[float, float]:
    try:
        x, y = (float(step) for step in (spacing if isinstance(spacing, tuple) else (spacing, spacing)))
    except (TypeError, ValueError) as error:
        raise InputError(f"spacing: must be a number or a pair of them ({error})") from error
    if not all(math.isfinite(step) and step != 0 for step in (x, y)):
        raise InputError(f"spacing = {spacing}: must be finite and not zero")
    return x, y


def _weights(
    weights: ArrayLike | tuple[ArrayLike, ArrayLike] | None, shape: tuple[int, ...], inside: Mask
) -> Pair:
    pair = weights if isinstance(weights, tuple) else (weights, weights)
    found = [np.ones(shape) if weight is None else np.array(weight, dtype=np.float64) for weight in pair]
    if len(found) != 2 or any(weight.shape != shape for weight in found):
        raise InputError(f"weights: must be of shape {shape} as the gradient, or a pair of these")
    if not all(np.all(np.isfinite(weight[inside]) & (weight[inside] > 0)) for weight in found):
        raise InputError("weights: must be finite and greater than 0 in every pixel of the mask")
    return found[0], found[1]


def _residuals(edges: Pair, weights: Pair, z: Floats) -> Pair:
    """Increments less the differences of z, (H, W) each, zero where no edge is."""
    rx, ry = (np.zeros(z.shape) for _ in range(2))
    np.subtract(edges[0][:, :-1], np.diff(z, axis=1), out=rx[:, :-1], where=weights[0][:, :-1] > 0)
    np.subtract(edges[1][:-1], np.diff(z, axis=0), out=ry[:-1], where=weights[1][:-1] > 0)
    return rx, ry


def _centred(z: Floats, labels: Labels) -> Floats:
    """Mean zero in every component, NaN outside."""
    count = int(labels.max())
    means = np.zeros(count + 1)
    means[1:] = scipy.ndimage.mean(z, labels, np.arange(1, count + 1))
    centred: Floats = np.where(labels > 0, z - means[labels], np.nan)
    return centred
