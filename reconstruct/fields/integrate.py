"""integrate(): a gradient field to heights, without a scene; the solver by name or from the data.

| method | edges | solver |
|---|---|---|
| dct2 | trapezoid | DCT, full rectangle |
| dct4 | cubic through four pixels | DCT, full rectangle |
| weighted | as dct4 | DCT along rows, tridiagonal along columns: weights by columns, full rectangle |
| cg | as dct4 | conjugate gradients: any mask, any weights |
| robust | as dct4 | Cauchy reweighting of the edge defects |

dct2 and dct4: the least-squares heights of edge increments g solve the Neumann Laplacian L z = D^T g, which
the DCT-II diagonalises with eigenvalues (2 - 2 cos(pi k / rows)) + (2 - 2 cos(pi l / cols)); no boundary
terms.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.fft
import scipy.ndimage
import scipy.sparse
import scipy.sparse.linalg
from numpy.typing import ArrayLike

from optolever.blocks import threads
from optolever.errors import InputError

from ..arrays import Floats, Labels, Mask, Pair
from ..judgement.reweighting import cauchy, scaled_median
from ..solver.edges import divergence, edge_weights, increments
from ..solver.poisson import (
    SEPARABLE_SPREAD,
    Accuracy,
    EdgeProblem,
    MaskedEdges,
    SeparableEdges,
    edge_problem,
    spread,
)

__all__ = ["Integral", "integrate", "integrator_names"]

_RECTANGLES = ("dct2", "dct4")
_SOLVERS: dict[str, Callable[[Floats, Floats, Mask], EdgeProblem]] = {
    "weighted": lambda wx, wy, _: SeparableEdges(wx, wy),
    "cg": MaskedEdges,
}
_ONE = np.ones((1, 1))
_ACCURACY = Accuracy(relative=1e-12)
_NEGLIGIBLE = 0.1  # energy of a solve's error: a bound of every height's error in standard deviations
_PATIENCE = 50  # conjugate gradients that cost a factorisation; steeper weights still make it many more
_FACTORISED = 1 << 20  # pixels: 1 GB of factors
_ROUNDING = 1e-4  # of the increments: defects below it are quadrature and rounding, no outliers


@dataclass(frozen=True, slots=True)
class Integral:
    """Heights z (H, W), NaN outside the mask, of mean zero in every connected component.

    defect: rms difference between edge increments and heights, in units of z; components: labels (H, W), 0
    outside; edge_weights: factors of robust reweighting on the edges (x, y), (H, W) each, or None.
    """

    z: Floats
    method: str
    iterations: int
    defect: float
    components: Labels
    edge_weights: tuple[Floats, Floats] | None = None


def integrator_names() -> tuple[str, ...]:
    """Names that `integrate` takes as method, apart from 'auto'."""
    return (*_RECTANGLES, *_SOLVERS, "robust")


def integrate(
    gx: ArrayLike,
    gy: ArrayLike,
    method: str = "auto",
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
    steps = _steps(spacing)
    if not inside.any():
        raise InputError("mask: no pixel with a gradient is left")
    wp, wq = _weights(weights, p.shape, inside)
    name = _choose(inside, wp, wq) if method == "auto" else method
    if name not in integrator_names():
        raise InputError(
            f"method = {method!r}: unknown, must be auto or one of {', '.join(integrator_names())}"
        )
    if steps != (1.0, 1.0):
        p, q = p * steps[0], q * steps[1]
    if name in (*_RECTANGLES, "weighted"):
        _require_plain(name, inside, name != "weighted" and wp is not None)
    if name in _RECTANGLES:
        z, rest = _rectangle(p, q, name == "dct4")
        return Integral(z, name, 1, _rms(rest, rest[0].size + rest[1].size), np.ones(p.shape, dtype=np.int32))
    one = np.ones(p.shape)
    wp, wq = (one, one) if wp is None or wq is None else (wp, wq)
    edges, weights = increments(p, q, inside), edge_weights(1.0 / wp, 1.0 / wq, _ONE, inside)
    reweighted = None
    if name == "robust":
        z, iterations, reweighted = _robust(edges, weights, inside)
    else:
        found = _SOLVERS[name](*weights, inside).solve(*edges, _ACCURACY)
        z, iterations = found.x, found.iterations
    labels = scipy.ndimage.label(inside)[0].astype(np.int32)
    rest, count = _residuals(edges, weights, z), sum(int(np.count_nonzero(w)) for w in weights)
    return Integral(_centred(z, labels), name, iterations, _rms(rest, count), labels, reweighted)


def _require_plain(name: str, inside: Mask, weighted: bool) -> None:
    if not inside.all():
        raise InputError(
            f"method = {name!r}: needs a full rectangle, {np.count_nonzero(~inside)} pixels are masked"
        )
    if weighted:
        raise InputError(f"method = {name!r}: takes no weights; 'weighted', 'cg' and 'robust' do")


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
) -> tuple[Floats, Floats] | tuple[None, None]:
    if weights is None:
        return None, None
    pair = weights if isinstance(weights, tuple) else (weights, weights)
    found = []
    for weight in pair:
        array = np.array(weight, dtype=np.float64)
        if array.shape != shape or len(pair) != 2:
            raise InputError(
                f"weights: shape {array.shape}, must be {shape} as the gradient, or a pair of these"
            )
        if not np.all(np.isfinite(array[inside]) & (array[inside] > 0)):
            raise InputError("weights: must be finite and greater than 0 in every pixel of the mask")
        found.append(array)
    return found[0], found[1]


def _choose(inside: Mask, wp: Floats | None, wq: Floats | None) -> str:
    if not inside.all():
        return "cg"
    if wp is None or wq is None:
        return "dct4"
    return "weighted" if max(spread(wp), spread(wq)) < SEPARABLE_SPREAD else "cg"


def _rectangle(p: Floats, q: Floats, cubic: bool) -> tuple[Floats, Pair]:
    """Heights of mean zero (H, W) and the edges' defects, by two cosine transforms. cubic: increments of the
    cubic through four pixels, else of the trapezoid.
    """
    (rows, cols), ones = p.shape, np.ones((1, p.shape[1]))
    gx, gy = increments(p, q, np.ones(p.shape, np.bool_)) if cubic else _trapezoids(p, q)
    modes = scipy.fft.dctn(divergence(gx, gy, ones, ones), norm="ortho", workers=threads(), overwrite_x=True)
    eigenvalues = np.add.outer(*(2.0 - 2.0 * np.cos(np.pi * np.arange(n) / n) for n in (rows, cols)))
    eigenvalues[0, 0] = np.inf
    modes /= eigenvalues
    z: Floats = scipy.fft.idctn(modes, norm="ortho", workers=threads(), overwrite_x=True)
    gx[:, :-1] -= np.diff(z, axis=1)
    gy[:-1] -= np.diff(z, axis=0)
    return z, (gx[:, :-1], gy[:-1])


def _trapezoids(p: Floats, q: Floats) -> Pair:
    gx, gy = np.zeros(p.shape), np.zeros(q.shape)
    gx[:, :-1] = 0.5 * (p[:, :-1] + p[:, 1:])
    gy[:-1] = 0.5 * (q[:-1] + q[1:])
    return gx, gy


def _robust(edges: Pair, weights: Pair, mask: Mask) -> tuple[Floats, int, Pair]:
    """Cauchy weights on the edge defects, see `reweighting`: heights, iterations, the weights at the end."""
    floor = _ROUNDING * scaled_median(edges, weights)
    z, iterations, left, scale = np.zeros(mask.shape), 0, weights, 0.0

    def step(doubts: Pair | None) -> Pair:
        nonlocal z, iterations, left, scale
        if doubts is None:
            result = edge_problem(*left, mask, True).solve(*edges, Accuracy(relative=1e-10))
        else:
            wx, wy = (w / (1.0 + w * doubt**2) for w, doubt in zip(weights, doubts, strict=True))
            left = wx, wy
            accuracy = Accuracy(energy=_NEGLIGIBLE * scale, relative=1e-10)
            result = MaskedEdges(*left, mask).solve(*edges, accuracy, z, _PATIENCE)
        z, iterations = result.x, iterations + result.iterations
        if result.iterations == _PATIENCE and mask.sum() <= _FACTORISED:
            z = _factorised(edges, left, mask)
        residuals = _residuals(edges, weights, z)
        scale = scaled_median(residuals, weights)
        return residuals

    cauchy(step, weights, floor)
    return z, iterations, left


def _factorised(edges: Pair, weights: Pair, mask: Mask) -> Floats:
    """Heights by a sparse factorisation of the normal equations, the first pixel of every component 0: what
    extreme weights ask for."""
    free = mask.ravel().copy()
    free[np.unique(scipy.ndimage.label(mask)[0].ravel(), return_index=True)[1]] = False
    number = np.arange(mask.size).reshape(mask.shape)
    tail = np.concatenate([number[:, :-1].ravel(), number[:-1].ravel()])
    head = np.concatenate([number[:, 1:].ravel(), number[1:].ravel()])
    weight = np.concatenate([weights[0][:, :-1].ravel(), weights[1][:-1].ravel()])
    coupled = scipy.sparse.coo_array((weight, (tail, head)), shape=(mask.size, mask.size)).tocsr()
    coupled = coupled + coupled.T
    normal = (scipy.sparse.diags_array(coupled.sum(axis=1)) - coupled)[free][:, free].tocsc()
    z = np.zeros(mask.shape)
    if free.any():
        options = {"SymmetricMode": True}
        factor = scipy.sparse.linalg.splu(normal, "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
        z.reshape(-1)[free] = factor.solve(divergence(*edges, *weights).ravel()[free])
    return z


def _residuals(edges: Pair, weights: Pair, z: Floats) -> Pair:
    """Increments less the differences of z, (H, W) each, zero where no edge is."""
    rx, ry = (np.zeros(z.shape) for _ in range(2))
    np.subtract(edges[0][:, :-1], np.diff(z, axis=1), out=rx[:, :-1], where=weights[0][:, :-1] > 0)
    np.subtract(edges[1][:-1], np.diff(z, axis=0), out=ry[:-1], where=weights[1][:-1] > 0)
    return rx, ry


def _rms(values: Pair, count: int) -> float:
    """Root mean square over so many edges."""
    return math.sqrt(sum(float(np.einsum("ij,ij->", r, r)) for r in values) / max(count, 1))


def _centred(z: Floats, labels: Labels) -> Floats:
    """Mean zero in every component, NaN outside."""
    count = int(labels.max())
    means = np.zeros(count + 1)
    means[1:] = scipy.ndimage.mean(z, labels, np.arange(1, count + 1))
    centred: Floats = np.where(labels > 0, z - means[labels], np.nan)
    return centred
