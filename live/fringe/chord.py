"""The coupled equations of height and slope, linearised at rest: one chord step takes one cosine transform
and its inverse.

The unknown is tau = t - t0, the distance along a cell's ray less that at rest. The mirror's normal bisects
the ray and the way to the pattern point, n ~ e - d, and the mirror holds its tangents, which gives the slope
of t along columns and rows in closed form from (du, dv, tau) (as in `reconstruct`); the slope at rest is
subtracted, so that float32 is good to nanometres and rest is exactly flat. With E the integrating factor at
rest, tau = E x turns the equations into increments of x, whose weighted least squares are one direct solve.
Cells that are trusted less weigh less: then conjugate gradients, with that solve as preconditioner."""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, TypeVar

import numpy as np

from optolever.arrays import Cells, Floats, Mask
from optolever.blocks import over_rows
from optolever.kernels import inlined, kernel
from optolever.reconstruct import ColumnPoisson, integrate

from .rays_at_rest import AnchorLine, RestRays

__all__ = ["Linearised", "chord_step", "linearised", "slopes_at"]

Real = TypeVar("Real", Cells, Floats)

_f4 = np.float32
_ITERATIONS = 4  # of conjugate gradients: more take the heights no nearer to the truth
_STEP = 1e-4  # turns and mm: of the differences that give derivatives at rest


@dataclass(frozen=True, eq=False)
class Linearised:
    """planes (18, R, C), steps (2, 3): see RestRays; slopes (2, R, C): at rest, mm a cell; factor (R, C): the
    integrating factor E; root: its square root; along (C,), across (C,): weights of the edges by column;
    anchor (3, R, C): weights of tau, p and q in the mean that is zero."""

    planes: Annotated[Cells, "18 R C"]
    steps: Annotated[Cells, "2 3"]
    slopes: Annotated[Cells, "2 R C"]
    factor: Annotated[Cells, "R C"]
    root: Annotated[Cells, "R C"]
    along: Annotated[Cells, "C"]
    across: Annotated[Cells, "C"]
    anchor: Annotated[Cells, "3 R C"]

    @cached_property
    def _columns(self) -> ColumnPoisson:
        return ColumnPoisson(self.along.astype(np.float64), self.across.astype(np.float64), len(self.factor))

    def solve(self, divergence: Cells) -> Cells:
        """x (R, C), of mean mode 0, of which D^T w D x is the right-hand side (R, C)."""
        return np.asarray(self._columns.solve(divergence, single=True), _f4)


def linearised(rays: RestRays, line: AnchorLine, lit: Mask) -> Linearised:
    """The equations at rest. lit (R, C): cells by which the weights go."""
    steps = np.stack([rays.step_u, rays.step_v])
    rows, cols = lit.shape
    zero = np.zeros((rows, cols))

    def at(du: float = 0.0, dv: float = 0.0, tau: float = 0.0) -> Floats:
        return slopes_at(rays.planes, steps, np.stack([zero + du, zero + dv]), zero + tau)

    by_tau = (at(tau=_STEP) - at(tau=-_STEP)) / (2 * _STEP)
    by_u = (at(du=_STEP) - at(du=-_STEP)) / (2 * _STEP)
    by_v = (at(dv=_STEP) - at(dv=-_STEP)) / (2 * _STEP)
    variance = by_u**2 + by_v**2
    log_factor = integrate(by_tau[0], by_tau[1]).z
    factor = np.exp(log_factor - log_factor[lit].max())
    # the weights of x: inverse variances of its increments, averaged over the lit cells of a column
    seen_x, seen_y = lit[:, :-1] & lit[:, 1:], lit[:-1] & lit[1:]
    along = _weights(_amid(variance[0], 1) / (factor[:, :-1] * factor[:, 1:]), seen_x)
    across = _weights(_amid(variance[1], 0) / (factor[:-1] * factor[1:]), seen_y)
    most = max(along.max(), across.max())
    along, across = np.append(along / most, 0.0), across / most
    planes = rays.planes.astype(_f4)
    at_rest = slopes_at(
        planes, steps.astype(_f4), np.zeros((2, rows, cols), _f4), np.zeros((rows, cols), _f4)
    )
    return Linearised(
        planes, steps.astype(_f4), at_rest, factor.astype(_f4), np.sqrt(factor).astype(_f4),
        along.astype(_f4), across.astype(_f4),
        np.stack([line.distance, line.per_col, line.per_row]).astype(_f4),
    )  # fmt: skip


def chord_step(rig: Linearised, displacement: Cells, tau: Cells, trust: Cells) -> tuple[Cells, Cells]:
    """The change of tau (R, C), mm, and the slopes (2, R, C) less those at rest, mm a cell.

    displacement (2, R, C): turns less those at rest; trust (R, C): weight of a cell, 0 to 1.
    """
    slopes = slopes_at(rig.planes, rig.steps, displacement, tau)
    slopes -= rig.slopes
    increments = np.empty_like(slopes)
    over_rows(lambda start, stop: _increments(slopes, tau, rig.root, increments, start, stop), tau.shape[0])
    divergence = _divergence(rig, increments, np.zeros_like(tau), trust)
    x = rig.solve(divergence) if trust.min() == 1 else _weighted(rig, divergence, trust)
    change, here = rig.factor * x, rig.anchor * trust
    weight = float((here[0] * rig.factor).sum())
    if weight > 0:
        off = float((here[0] * (tau + change)).sum() + (here[1:] * slopes).sum())
        change -= _f4(off / weight) * rig.factor
    return change, slopes


def _weighted(rig: Linearised, divergence: Cells, trust: Cells) -> Cells:
    """Conjugate gradients; 0 in cells of weight zero."""
    seen = trust > 0
    nothing = np.zeros((2, *trust.shape), _f4)
    x, r = np.zeros_like(divergence), divergence
    direction, energy = np.zeros_like(divergence), 1.0
    for _ in range(_ITERATIONS):
        z = rig.solve(r) * seen
        before, energy = energy, float(np.vdot(r, z))
        if not energy > 0:
            break
        direction = _f4(energy / before) * direction + z
        image = _divergence(rig, nothing, direction, trust)  # less
        length = _f4(energy / max(-float(np.vdot(direction, image)), 1e-30))
        x += length * direction
        r = r + length * image
    return x


def slopes_at(planes: Real, steps: Real, displacement: Real, tau: Real) -> Real:
    """Slopes of t along columns and rows (2, R, C), mm a cell; planes, steps: see RestRays."""
    out = np.empty((2, *tau.shape), tau.dtype)
    over_rows(lambda start, stop: _slopes(planes, steps, displacement, tau, out, start, stop), tau.shape[0])
    return out


def _divergence(rig: Linearised, increments: Cells, x: Cells, trust: Cells) -> Cells:
    """D^T w (increments - D x), (R, C)."""
    out = np.empty_like(x)
    args = increments, x, rig.along, rig.across, trust, out
    over_rows(lambda start, stop: _flow(*args, start, stop), x.shape[0])
    return out


def _amid(field: Floats, axis: int) -> Floats:
    first, second = np.delete(field, -1, axis), np.delete(field, 0, axis)
    return np.asarray(0.5 * (first + second))


def _weights(variance: Floats, seen: Mask) -> Floats:
    """Inverse mean variances (n,) of the columns of edges; where none is lit, of all."""
    total = float(np.mean(variance[seen])) if seen.any() else float(np.mean(variance))
    count = seen.sum(axis=0)
    mean = np.where(seen, variance, 0.0).sum(axis=0) / np.maximum(count, 1)
    weights: Floats = 1 / np.where(count > 0, mean, total)
    return weights


@kernel
def _slopes(g, steps, displacement, tau, out, start, stop):  # type: ignore[no-untyped-def]
    """out (2, R, C): slopes of t along columns and rows, mm a cell; g (18, R, C): RestRays.planes."""
    for i in range(start, stop):
        for j in range(tau.shape[1]):
            t, a, b = tau[i, j], displacement[0, i, j], displacement[1, i, j]
            dx, dy, dz = g[3, i, j], g[4, i, j], g[5, i, j]
            ex = g[0, i, j] + a * steps[0, 0] + b * steps[1, 0] - t * dx
            ey = g[1, i, j] + a * steps[0, 1] + b * steps[1, 1] - t * dy
            ez = g[2, i, j] + a * steps[0, 2] + b * steps[1, 2] - t * dz
            k = _f4(1) / np.sqrt(ex * ex + ey * ey + ez * ez)
            nx, ny, nz = ex * k - dx, ey * k - dy, ez * k - dz
            scale = _f4(-1) / (nx * dx + ny * dy + nz * dz)
            for axis in range(2):
                m = 6 + 6 * axis
                out[axis, i, j] = scale * (
                    nx * (g[m, i, j] + t * g[m + 3, i, j])
                    + ny * (g[m + 1, i, j] + t * g[m + 4, i, j])
                    + nz * (g[m + 2, i, j] + t * g[m + 5, i, j])
                )


@inlined
def _rise(a, b, c, d, at):  # type: ignore[no-untyped-def]
    """Integral of the cubic through four values, over the first, second or third step (at -1, 0, 1)."""
    first, last = (a, d) if at < 1 else (d, a)
    low, high = (b, c) if at < 1 else (c, b)
    if at == 0:
        return _f4(1 / 24) * (_f4(13) * (b + c) - a - d)
    return _f4(1 / 24) * (_f4(9) * first + _f4(19) * low - _f4(5) * high + last)


@kernel
def _increments(slopes, tau, root, out, start, stop):  # type: ignore[no-untyped-def]
    """out (2, R, C): increments of the slopes by the cubic through four cells, less those of tau, over the
    integrating factor; 0 beyond the last column or row."""
    rows, cols = tau.shape
    p, q = slopes[0], slopes[1]
    for i in range(start, stop):
        for j in range(cols - 1):
            k = min(max(j - 1, 0), cols - 4)
            rise = _rise(p[i, k], p[i, k + 1], p[i, k + 2], p[i, k + 3], j - 1 - k)
            out[0, i, j] = (rise - tau[i, j + 1] + tau[i, j]) / (root[i, j] * root[i, j + 1])
        out[0, i, cols - 1] = _f4(0)
        k, n = min(max(i - 1, 0), rows - 4), min(i + 1, rows - 1)
        for j in range(cols):
            rise = _rise(q[k, j], q[k + 1, j], q[k + 2, j], q[k + 3, j], i - 1 - k)
            step = (rise - tau[n, j] + tau[i, j]) / (root[i, j] * root[n, j])
            out[1, i, j] = step if i < rows - 1 else _f4(0)


@kernel
def _flow(g, x, along, across, trust, out, start, stop):  # type: ignore[no-untyped-def]
    """D^T (w (g - D x)); an edge counts as much as the less trusted of its cells."""
    rows, cols = x.shape
    for i in range(start, stop):
        for j in range(cols):
            total, here, t = _f4(0), x[i, j], trust[i, j]
            if j > 0:
                w = along[j - 1] * min(t, trust[i, j - 1])
                total += w * (g[0, i, j - 1] - here + x[i, j - 1])
            if j + 1 < cols:
                w = along[j] * min(t, trust[i, j + 1])
                total -= w * (g[0, i, j] - x[i, j + 1] + here)
            if i > 0:
                w = across[j] * min(t, trust[i - 1, j])
                total += w * (g[1, i - 1, j] - here + x[i - 1, j])
            if i + 1 < rows:
                w = across[j] * min(t, trust[i + 1, j])
                total -= w * (g[1, i, j] - x[i + 1, j] + here)
            out[i, j] = total
