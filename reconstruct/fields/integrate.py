"""integrate(): a gradient field to heights, without a scene; the solver by name or from the data.

| method | edges | solver |
|---|---|---|
| dct2 | trapezoid | DCT, full rectangle |
| dct4 | cubic through four pixels | DCT, full rectangle |
| weighted | as dct4 | DCT along rows, tridiagonal along columns: weights by columns, full rectangle |
| cg | as dct4 | conjugate gradients: any mask, any weights |
| direct | as dct4 | sparse factorisation: extreme weights |
| robust | as dct4 | Cauchy reweighting of the edge defects |
| march | as dct4 | sums down the first column, then along every row: no least squares, a cross-check |
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.ndimage
from numpy.typing import ArrayLike

from optolever.errors import InputError

from ..arrays import Floats, Labels, Mask
from ..solver.edges import edge_weights, increments
from ..solver.poisson import SEPARABLE_SPREAD, spread
from .integrators import SOLVERS, Field, defect
from .quadrilateral import quadrilateral_increments, quadrilateral_weights
from .rectangle import rectangle

__all__ = ["Integral", "integrate", "integrator_names"]

RECTANGLES = ("dct2", "dct4")  # by `rectangle`, apart from the solvers of edge increments

_ONE = np.ones((1, 1))


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
    return (*RECTANGLES, *SOLVERS)


def integrate(
    gx: ArrayLike,
    gy: ArrayLike,
    method: str = "auto",
    *,
    mask: ArrayLike | None = None,
    weights: ArrayLike | tuple[ArrayLike, ArrayLike] | None = None,
    spacing: float | tuple[ArrayLike, ArrayLike] = 1.0,
) -> Integral:
    """Heights whose slopes are gx = dz/dx (along columns) and gy = dz/dy (along rows), in the least-squares
    sense.

    gx, gy (H, W): sampled at pixels, NaN where unknown; mask (H, W): pixels to use; weights (H, W) or a pair
    of them for gx and gy: inverse variances. spacing: of the pixels (dx, dy), or where they lie: x, y (H, W),
    or x (W,) of the columns and y (H,) of the rows. An edge's weight is then the inverse variance of its
    increment for slopes of equal variance, times the mean square of the edges' lengths. Raises InputError for
    input that does not fit.

    >>> import numpy as np
    >>> row, column = np.mgrid[:32, :48]
    >>> plane = integrate(np.full((32, 48), 0.5), np.full((32, 48), -0.25)).z
    >>> bool(np.allclose(plane, 0.5 * (column - 23.5) - 0.25 * (row - 15.5)))
    True
    """
    p, q, inside = _checked(gx, gy, mask)
    steps, places = _spaced(spacing, p.shape)
    if places is not None:
        inside &= np.isfinite(places[0]) & np.isfinite(places[1])
    if not inside.any():
        raise InputError("mask: no pixel with a gradient is left")
    wp, wq = _weights(weights, p.shape, inside)
    name = _choose(inside, wp, wq, places is None) if method == "auto" else method
    if name not in integrator_names():
        raise InputError(
            f"method = {method!r}: unknown, must be auto or one of {', '.join(integrator_names())}"
        )
    if places is not None and name in (*RECTANGLES, "weighted"):
        raise InputError(f"method = {name!r}: needs an even grid; 'cg', 'direct' and 'robust' do not")
    if steps != (1.0, 1.0):
        p, q = p * steps[0], q * steps[1]
    if name in RECTANGLES:
        _require_plain(name, inside, wp is not None)
        z, left_over = rectangle(p, q, name == "dct4")
        return Integral(z, name, 1, left_over, np.ones(p.shape, dtype=np.int32))
    if name in ("weighted", "march"):
        _require_plain(name, inside, name == "march" and wp is not None)
    field = _field(p, q, wp, wq, inside) if places is None else _field_at(places, p, q, wp, wq, inside)
    z, iterations, left = SOLVERS[name](field)
    labels = _labels(inside)
    z = _centred(z, labels)
    return Integral(z, name, iterations, defect(field, z), labels, left)


def _require_plain(name: str, inside: Mask, weighted: bool) -> None:
    if not inside.all():
        raise InputError(
            f"method = {name!r}: needs a full rectangle, {np.count_nonzero(~inside)} pixels are masked"
        )
    if weighted:
        raise InputError(f"method = {name!r}: takes no weights; 'weighted', 'cg', 'direct' and 'robust' do")


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


def _spaced(spacing: Any, shape: tuple[int, ...]) -> tuple[tuple[float, float], tuple[Floats, Floats] | None]:
    """Steps between the pixels of an even grid, or 1 and their places x, y (H, W)."""
    try:
        pair = spacing if isinstance(spacing, tuple | list) or np.ndim(spacing) else (spacing, spacing)
        x, y = (np.asarray(part, dtype=np.float64) for part in pair)
    except (TypeError, ValueError) as error:
        raise InputError(f"spacing: must be a number, a pair of them, or places x, y ({error})") from error
    if x.ndim == y.ndim == 0:
        if not all(np.isfinite(step) and step != 0 for step in (x, y)):
            raise InputError(f"spacing = {spacing}: must be finite and not zero")
        return (float(x), float(y)), None
    lines = (shape[1],), (shape[0],)
    if (x.shape, y.shape) not in ((shape, shape), lines):
        raise InputError(
            f"spacing: x has shape {x.shape}, y {y.shape}; must be {shape} as the gradient, "
            f"or {lines[0]} of the columns and {lines[1]} of the rows"
        )
    if x.ndim == 1:
        x, y = np.meshgrid(x, y)
    return (1.0, 1.0), (x, y)


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


def _choose(inside: Mask, wp: Floats | None, wq: Floats | None, even: bool) -> str:
    if wp is None or wq is None:
        return "dct4" if even and inside.all() else "cg"
    if even and inside.all() and max(spread(wp), spread(wq)) < SEPARABLE_SPREAD:
        return "weighted"
    contrast = max(float(np.max(w[inside])) / float(np.min(w[inside])) for w in (wp, wq))
    return "direct" if contrast > 1e4 and inside.sum() <= 1 << 18 else "cg"


def _field(p: Floats, q: Floats, wp: Floats | None, wq: Floats | None, inside: Mask) -> Field:
    one = np.ones(p.shape)
    variances = one if wp is None else 1.0 / wp, one if wq is None else 1.0 / wq
    return Field(*increments(p, q, inside), *edge_weights(*variances, _ONE, inside), inside)


def _field_at(
    places: tuple[Floats, Floats], p: Floats, q: Floats, wp: Floats | None, wq: Floats | None, inside: Mask
) -> Field:
    """Of pixels that lie at x, y (H, W)."""
    one = np.ones(p.shape)
    wx, wy = quadrilateral_weights(one if wp is None else wp, one if wq is None else wq, *places, inside)
    return Field(*quadrilateral_increments(p, q, *places, inside), wx, wy, inside)


def _labels(inside: Mask) -> Labels:
    if inside.all():
        return np.ones(inside.shape, dtype=np.int32)
    labels: Labels = scipy.ndimage.label(inside)[0].astype(np.int32)
    return labels


def _centred(z: Floats, labels: Labels) -> Floats:
    """Mean zero in every component, NaN outside."""
    if labels.all() and labels.max() == 1:
        return np.asarray(z - z.mean())
    count = int(labels.max())
    means = np.zeros(count + 1)
    means[1:] = scipy.ndimage.mean(z, labels, np.arange(1, count + 1))
    centred: Floats = np.where(labels > 0, z - means[labels], np.nan)
    return centred
