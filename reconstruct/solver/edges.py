"""Pixel edges: increments of a slope between neighbouring pixels, their weights, and the operators on them.

Edge arrays have the shape of the image: gx[i, j] belongs to the edge from (i, j) to (i, j + 1), gy[i, j] to
the one from (i, j) to (i + 1, j); an edge exists if both its pixels are in the mask, and is zero in every
array otherwise. Increments of a slope sampled at pixels (unit spacing) integrate the cubic through four
neighbours: interior (-1, 13, 13, -1)/24; where the image or the mask ends, one-sided (9, 19, -5, 1)/24; the
trapezoid where fewer than four neighbours stand.
"""

from typing import Any, NamedTuple

import numpy as np

from optolever.arrays import Floats, Ints, Mask
from optolever.blocks import over_image
from optolever.kernels import exact

__all__ = [
    "Doubt", "SomeEdges", "apply_laplacian", "cubic_at_end", "cubic_inside", "defects", "divergence",
    "edge_weights", "factor_increments", "increments", "scaled_weights",
]  # fmt: skip

_STEEP = 0.05  # of the integrating factor's ratio: where it falls so much, slopes do not say by how much


class Doubt(NamedTuple):
    """What every edge's increment may be off by beyond its noise (see `discontinuities`), (H, W): x along
    columns, y along rows."""

    x: Floats
    y: Floats


class SomeEdges(NamedTuple):
    """Values of a few edges, along columns and along rows, and their numbers in the flat image."""

    at_x: Ints
    at_y: Ints
    x: Floats
    y: Floats

    def times(self, by: float) -> "SomeEdges":
        """The values times a number."""
        return self._replace(x=by * self.x, y=by * self.y)

    def plus(self, other: "SomeEdges") -> "SomeEdges":
        """The sum with values of the same edges."""
        return self._replace(x=self.x + other.x, y=self.y + other.y)


def increments(p: Floats, q: Floats, mask: Mask) -> tuple[Floats, Floats]:
    """Edge increments of the slopes p (along columns) and q (along rows), each (H, W)."""
    zero, one = np.zeros((1, 1)), np.ones((1, 1))
    return defects(p, q, zero, one, mask)


def defects(p: Floats, q: Floats, w: Floats, root: Floats, mask: Mask) -> tuple[Floats, Floats]:
    """Edge defects in units of the integrating factor: (increment of the slope - difference of w) / (root_i
    root_j).

    w and root: (H, W), or (1, 1) if constant. root = sqrt(E). p, q and w may be stacks (..., H, W).
    """
    cols, whole = p.shape[-1], bool(mask.all())
    level, scale = (np.full((1, cols), part[0, 0]) if part.size == 1 else part for part in (w, root))
    p_flat, q_flat, w_flat = (part.reshape(-1, cols) for part in (p, q, level))
    gx, gy = np.empty(p.shape), np.empty(p.shape)
    flat = p_flat, q_flat, w_flat, scale, gx.reshape(-1, cols), gy.reshape(-1, cols)
    over_image(lambda start, stop: _defects(*flat, len(mask), start, stop), p_flat.shape)
    for slopes, out, axis in ((p, gx, 1), (q, gy, 0)):
        _at_ends(slopes, w, root, mask, whole, out, axis)
    return gx, gy


def _at_ends(f: Floats, w: Floats, root: Floats, mask: Mask, whole: bool, out: Floats, axis: int) -> None:
    """The defects along an axis where the image or the mask ends: zero where no edge is, else by what
    neighbours stand."""
    size, step = mask.shape[axis], mask.shape[1] if axis == 0 else 1
    ends = np.zeros(mask.shape, np.bool_)
    edges, inside = np.moveaxis(ends, axis, 0), np.moveaxis(mask, axis, 0)
    if whole:
        edges[: size - 1 : max(size - 2, 1)] = True
        np.moveaxis(out, axis - 2, 0)[-1] = 0.0
    else:
        np.logical_and(inside[:-1], inside[1:], out=edges[:-1])
        np.copyto(out, 0.0, where=~ends)
        edges[1:-2] &= ~(inside[:-3] & inside[3:])
    at = np.flatnonzero(ends)
    place, known = at // mask.shape[1] if axis == 0 else at % mask.shape[1], mask.ravel()
    flat, g, stands = f.reshape(*f.shape[:-2], -1), {}, {}
    for k in range(-2, 4):
        within = (place + k >= 0) & (place + k < size)
        pixel = np.where(within, at + k * step, at)
        g[k], stands[k] = flat[..., pixel], within & known[pixel]
    with np.errstate(all="ignore"):
        rise = np.where(stands[-1] & stands[-2], cubic_at_end(g[1], g[0], g[-1], g[-2]), 0.5 * (g[0] + g[1]))
        rise = np.where(stands[2] & stands[3], cubic_at_end(g[0], g[1], g[2], g[3]), rise)
        rise = np.where(stands[-1] & stands[2], cubic_inside(g[-1], g[0], g[1], g[2]), rise)
    if w.size > 1:
        values = w.reshape(*w.shape[:-2], -1)
        rise = rise - (values[..., at + step] - values[..., at])
    ratio = np.broadcast_to(root, mask.shape).ravel()
    out.reshape(*f.shape[:-2], -1)[..., at] = rise / (ratio[at] * ratio[at + step])


def factor_increments(p_w: Floats, q_w: Floats, mask: Mask) -> tuple[Floats, Floats]:
    """Edge increments of the logarithm of the integrating factor, log((1 + f_i/2) / (1 - f_j/2)).

    This is the factor of the trapezoid rule from pixel to pixel (exact for a factor C x).
    """
    gx, gy = np.zeros(p_w.shape), np.zeros(p_w.shape)

    def block(start: int, stop: int) -> None:
        for out, f, (one, other) in zip((gx, gy), (p_w, q_w), _ends(start, stop, len(mask)), strict=True):
            above, below = 1.0 + 0.5 * f[one], 1.0 - 0.5 * f[other]
            steep = ~(np.minimum(above, below) > _STEEP)
            with np.errstate(all="ignore"):
                np.divide(above, below, out=above)
                np.log(above, out=above)
            if steep.any():
                above[steep] = 0.5 * (f[one][steep] + f[other][steep])
            np.copyto(out[one], above, where=mask[one] & mask[other])

    over_image(block, mask.shape)
    return gx, gy


def _ends(start: int, stop: int, rows: int) -> tuple[tuple[Any, Any], tuple[Any, Any]]:
    """Windows of the pixels at both ends of the edges of some rows, along columns and along rows."""
    last = min(stop, rows - 1)
    along = np.s_[start:stop, :-1], np.s_[start:stop, 1:]
    return along, (np.s_[start:last], np.s_[start + 1 : last + 1])


def edge_weights(
    var_p: Floats, var_q: Floats, root: Floats, mask: Mask, doubt: Doubt | None = None
) -> tuple[Floats, Floats]:
    """Weights (E_i E_j) / var_edge of the edges, var_edge the mean of its two pixels' slope variances
    and the square of the edge's doubt.
    """
    wx, wy = np.zeros(var_p.shape), np.zeros(var_p.shape)
    doubts = (None, None) if doubt is None else doubt
    each = (wx, var_p, doubts[0]), (wy, var_q, doubts[1])

    def block(start: int, stop: int) -> None:
        for (out, variance, more), (one, other) in zip(each, _ends(start, stop, len(mask)), strict=True):
            total = variance[one] + variance[other]
            if more is not None:
                total += 2.0 * np.square(more[one])
            np.divide(2.0, total, out=out[one], where=mask[one] & mask[other])

    over_image(block, mask.shape)
    return (wx, wy) if root.size == 1 and root[0, 0] == 1.0 else scaled_weights((wx, wy), root)


def scaled_weights(weights: tuple[Floats, Floats], root: Floats) -> tuple[Floats, Floats]:
    """The weights (rows, cols) of edges times E_i E_j; root: (rows, cols), or (1, 1) if constant."""
    shape = weights[0].shape
    root, scaled = np.broadcast_to(root, shape), (np.zeros(shape), np.zeros(shape))

    def block(start: int, stop: int) -> None:
        for out, weight, (one, other) in zip(scaled, weights, _ends(start, stop, shape[0]), strict=True):
            both = root[one] * root[other]
            both *= both
            np.multiply(weight[one], both, out=out[one])

    over_image(block, shape)
    return scaled


def divergence(gx: Floats, gy: Floats, wx: Floats, wy: Floats) -> Floats:
    """D^T (w g): what flows into each pixel minus what flows out of it. Weights (H, W), or (1,
    W) for all rows; g may be stacks (..., H, W).
    """
    rows, cols = gx.shape[-2:]
    x, y = gx.reshape(-1, cols), gy.reshape(-1, cols)
    out = np.empty(x.shape)
    over_image(lambda start, stop: _divergence(x, y, wx, wy, rows, out, start, stop), x.shape)
    return out.reshape(gx.shape)


def apply_laplacian(x: Floats, wx: Floats, wy: Floats, out: Floats | None = None) -> tuple[Floats, float]:
    """D^T w D x (into out) for weights (H, W) that are zero where no edge is; its product with x, as a sum of
    squares.
    """
    image, sums = np.empty(x.shape) if out is None else out, np.empty(x.shape[0])
    over_image(lambda start, stop: _laplacian(x, wx, wy, image, sums, start, stop), x.shape)
    return image, float(sums.sum())


def cubic_inside(before: Any, g0: Any, g1: Any, after: Any) -> Any:
    """Increment from g0 to g1 of the cubic through four slopes in a row."""
    return (13.0 * (g0 + g1) - before - after) / 24.0


def cubic_at_end(g0: Any, g1: Any, g2: Any, g3: Any) -> Any:
    """Increment from g0 to g1 likewise, at the end of these."""
    return (9.0 * g0 + 19.0 * g1 - 5.0 * g2 + g3) / 24.0


@exact
def _defects(p, q, w, root, gx, gy, rows, start, stop):  # type: ignore[no-untyped-def]
    """As if all neighbours stood; images of so many rows below each other in p, q, w, gx, gy."""
    full, scaled, cols = int(w.shape[0] > 1), int(root.shape[0] > 1), p.shape[1]
    for i in range(start, stop):
        above, under, beyond = max(i - 1, 0), min(i + 1, len(q) - 1), min(i + 2, len(q) - 1)
        here, near, r, s = full * i, full * under, scaled * (i % rows), scaled * (under % rows)
        for j in range(1, cols - 2):
            rise = (13.0 * (p[i, j] + p[i, j + 1]) - p[i, j - 1] - p[i, j + 2]) / 24.0
            gx[i, j] = (rise - (w[here, j + 1] - w[here, j])) / (root[r, j] * root[r, j + 1])
        for j in range(cols):
            rise = (13.0 * (q[i, j] + q[under, j]) - q[above, j] - q[beyond, j]) / 24.0
            gy[i, j] = (rise - (w[near, j] - w[here, j])) / (root[r, j] * root[s, j])


@exact
def _divergence(gx, gy, wx, wy, rows, out, start, stop):  # type: ignore[no-untyped-def]
    """Images of so many rows below each other."""
    cols = gx.shape[1]
    full = 1 if wx.shape[0] > 1 else 0
    for i in range(start, stop):
        r = i % rows
        for j in range(cols):
            total = -wx[full * r, j] * gx[i, j] - wy[full * r, j] * gy[i, j]
            if j > 0:
                total += wx[full * r, j - 1] * gx[i, j - 1]
            if r > 0:
                total += wy[full * (r - 1), j] * gy[i - 1, j]
            out[i, j] = total


@exact
def _laplacian(x, wx, wy, out, sums, start, stop):  # type: ignore[no-untyped-def]
    rows, cols = x.shape
    for i in range(start, stop):
        total = 0.0
        for j in range(cols):
            here = x[i, j]
            value = 0.0
            if j > 0:
                value += wx[i, j - 1] * (here - x[i, j - 1])
            if j + 1 < cols:
                rise = x[i, j + 1] - here
                value -= wx[i, j] * rise
                total += wx[i, j] * rise * rise
            if i > 0:
                value += wy[i - 1, j] * (here - x[i - 1, j])
            if i + 1 < rows:
                rise = x[i + 1, j] - here
                value -= wy[i, j] * rise
                total += wy[i, j] * rise * rise
            out[i, j] = value
        sums[i] = total
