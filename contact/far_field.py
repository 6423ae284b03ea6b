"""How far everything sinks under a load, and how far the rig moved, measured in the map itself.

Heights less rest are known but for one free mode m(x, y), which an anchor settles: it counts as at rest. An
elastic half-space sinks there, too. Away from the contacts, in units of their radii q = r / a, the map is
therefore

    z' = c m + sum over motions of  a M  + sum over contacts of  A / q + (B dx + C dy + D) / q^3

(K. L. Johnson, Contact Mechanics, 1985, eq. 3.42; of a layer its Green's function in place of 1 / q) by least
squares over the good cells outside two radii of every contact, weighted by area and noise, a = 0 +- 1. With
weights that sum to one the covariance is (rho / 3)^2 (A^T W A)^-1, rho the rms residual. Where dents fade, as
on a layer of unknown thickness, powers of q and exponentials take the place of the sum, and c is 0 +- 2.5
noises, 6 where the rig may move, and the height of the dents at the anchors. Both models count by their
likelihood: an undecided choice is in sigma.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from optolever.arrays import Circle, Floats, rms
from optolever.scene import Layer

from .pressure import BONDED, bonded
from .regions import COLUMNS, Region, areas, regions
from .surface import LoadFit, Surface

__all__ = ["far_field", "fit", "load_fit"]

_FAR = 2.0  # radii of a contact
_MUCH = 1.5  # residual of a fit over the best one's, above which it misses what this sees
_ROUNDS = 3  # of regions in the map less its sag
_FEWEST = 200  # cells outside the contacts
_MOST = 6000  # cells of the fit
_AMPLITUDE = 3.0  # of the deepest contact: standard deviation of fields at its rim
_TAILS = 1e-6  # of a column: amplitudes that the map does not show stay small
_ROBUST = 12  # rounds of Cauchy's weights
_INDEPENDENT = 36.0  # samples of noise, and of a robust fit
_TAILED = 9.0  # samples of what tails of dents leave
_BEYOND = 5.0  # standard deviations: motions beyond their prior are found, too
_STILL, _YIELDS = 2.5, 6.0  # noises: of a dent that fades; where the rig moves, which hides a layer's sinking
_SINKS = 0.05  # of the largest height: what sinks with it, whatever the far field is
_RATES = (0.7, 1.4, 2.8)  # a radius
_OUTLIER = 3.0  # standard deviations of a robust fit: beyond, cells count less
_DEVIATION = 1.4826  # standard deviation over median absolute deviation


#: Of circles, x and y (n,): columns (k, n).
_Fields = Callable[[Sequence[Circle], Floats, Floats], Floats]


class _Cells(NamedTuple):
    """Cells (n,) of a fit; their noise, the depth of what is pressed, and the anchors (k, 2), mm."""

    x: Floats
    y: Floats
    z: Floats
    sigma: Floats
    weight: Floats
    free: Floats
    motion: Floats
    rig: Floats
    noise: float
    depth: float
    anchors: Floats | None


class Fit(NamedTuple):
    """Of fields (t, n) in observations (k, n): found (t, k): amplitudes; inverse (t, t): covariance at unit
    noise; rho: norm of the first observation's residual."""

    found: Floats
    inverse: Floats
    rho: float


class _Load(NamedTuple):
    """A fit of `fields` in number, motion and the free mode (t, n) to heights and the rig's errors
    (1 + m, n), all times the root of the weight (n,); unit: standard deviation of a cell's height; prior
    (t,): over the amplitudes' standard deviations."""

    fit: Fit
    every: Floats
    seen: Floats
    root: Floats
    prior: Floats
    unit: float
    fields: int


def fit(fields: Floats, observation: Floats, prior: Floats) -> Fit:
    """Least squares of fields (t, n) to observations (k, n), which their noise weighs to one; prior (t,):
    one over the amplitudes' standard deviations about zero."""
    terms = len(fields)
    triangle = np.asarray(np.linalg.qr(np.concatenate([fields, observation]).T, mode="r"))
    whole = np.vstack([triangle[:, :terms], np.diag(prior)])
    scale = np.maximum(np.linalg.norm(whole, axis=0), 1e-300)
    u, sizes, turned = np.linalg.svd(whole / scale, full_matrices=False)
    kept = sizes > np.finfo(np.float64).eps * max(fields.shape) * sizes.max(initial=0.0)
    half = turned.T / np.where(kept, sizes, np.inf) / scale[:, None]
    found = half @ (u[: len(triangle)].T @ triangle[:, terms:])
    return Fit(found, half @ half.T, float(np.linalg.norm(observation[0] - found[:, 0] @ fields)))


def load_fit(surface: Surface, layer: Layer | None, solid: bool = True) -> LoadFit | None:
    """Fit sinking, motion and far fields to a surface outside its regions, which are found again in the
    corrected map. layer: elastic, None is a half-space; solid: whether either lies behind the mirror. Returns
    None if too few cells lie outside the contacts."""
    cells = _cells(surface)
    thin = surface.thinned(max(1, surface.z.shape[1] // COLUMNS))

    def regions_less(taken: LoadFit) -> tuple[Region, ...]:
        less = thin.less(replace(taken, rig=taken.rig[:, :0], kept=taken.kept[:0, :0]))
        return regions(less, COLUMNS // 2)

    robust = surface.anchors is None and (len(cells.motion) > 0 or cells.free.any())
    start = _robust(cells) if cells.z.size and robust else None
    within = regions(thin) if start is None else regions_less(start)
    if start is not None:
        left = cells.z - start.motion @ cells.motion - start.c * cells.free
        away = left / (_OUTLIER * start.misfit * max(cells.noise, 1e-300))
        # where no motion is what modes say
        cells = cells._replace(weight=cells.weight / (1 + away**2), depth=float(left.max()))
    found, before = None, None
    for rounds_left in reversed(range(_ROUNDS)):
        circles = [circle for one in within for circle in one.circles]
        if circles == before:
            break
        found, before = _explained(cells, circles, layer, solid), circles
        if found is None:
            return None
        within = regions_less(found) if rounds_left else within
    return None if found is None else replace(found, kept=_kept(found))


def _kept(found: LoadFit) -> Floats:
    """Root (m, m) of the second moments of the rig's errors, 1 each before, by the motion that was seen: the
    rig's own, of unit variance, and what its errors look like (Bayes' rule)."""
    looks, seen = found.rig[:-1], found.motion
    gain = np.linalg.solve(looks @ looks.T + np.eye(len(seen)) + found.root[:-1] @ found.root[:-1].T, looks)
    mean = gain.T @ seen
    moment = np.eye(looks.shape[1]) - looks.T @ gain + np.multiply.outer(mean, mean)
    values, vectors = np.linalg.eigh(moment)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)


def far_field(layer: Layer | None, circles: Sequence[Circle], x: Floats, y: Floats) -> Floats:
    """Heights (4 n, ...) that n contacts cause at places outside them, in any unit: for each contact the
    fields of a force, of its two first moments and of its second moment."""
    thickness = None if layer is None else layer.thickness_mm

    def fields(dx: Floats, dy: Floats, q: Floats, radius: float) -> list[Floats]:
        at, slope, bend = 1 / q, -(q**-3), 2 * q**-3
        if layer is not None and thickness is not None:
            base, size = bonded(layer.poisson), radius / thickness
            r = np.minimum(q * size, BONDED)
            at = at + size * base(r)
            slope = slope + size**2 * base(r, 1) / q
            bend = bend + size**3 * base(r, 2)
        return [at, slope * dx, slope * dy, bend + slope]

    return _columns(fields, circles, x, y)


def _columns(fields: Callable[..., list[Floats]], circles: Sequence[Circle], x: Floats, y: Floats) -> Floats:
    """Heights (k n, ...) around n contacts by fields of the place in radii, its distance, at least 1, and the
    radius, mm."""
    columns = []
    for cx, cy, radius in circles:
        dx, dy = (x - cx) / radius, (y - cy) / radius
        columns += fields(dx, dy, np.maximum(np.hypot(dx, dy), 1.0), radius)
    return np.reshape(columns, (len(columns), *np.shape(x)))


def _cells(surface: Surface) -> _Cells:
    """Cells of the modes' grid that everything is known of."""
    step = surface.step * max(1, round(math.sqrt(surface.z.size / _MOST) / surface.step))
    few, some = (slice(None, None, step),) * 2, (slice(None, None, step // surface.step),) * 2
    area = areas(surface.x, surface.y)[few]
    modes = np.asarray(surface.common[:, *some], np.float64)
    rig, motion = np.split(modes, [len(modes) - surface.motions])
    free = np.zeros(area.shape) if surface.free is None else np.asarray(surface.free[few], np.float64)
    known = surface.good[few] & np.isfinite(surface.z[few] + surface.x[few] + surface.y[few] + free)
    known &= np.isfinite(modes).all(axis=0)
    x, y, z = (part[few][known].astype(np.float64) for part in (surface.x, surface.y, surface.z))
    sigma = np.asarray(surface.sigma[few][known], np.float64)
    noise = float(np.median(sigma)) if sigma.size else 0.0
    weight = area[known] / (1 + np.square(sigma / max(noise, 1e-300)))
    fields, depth = (free[known], motion[:, known], rig[:, known]), float(z.max(initial=0.0))
    return _Cells(x, y, z, sigma, weight, *fields, noise, depth, surface.anchors)


def _robust(cells: _Cells) -> LoadFit:
    """Motion and sinking alone, whatever dents there are: Cauchy's weights."""
    fields, noise, spread = np.concatenate([cells.motion, cells.free[None]]), cells.noise, 0.0
    count, mean = len(fields), np.zeros(len(fields))
    prior = np.diag([*np.full(count - 1, 1 / _BEYOND**2), 0.0 if cells.free.any() else 1.0])
    for _ in range(_ROBUST):
        left = cells.z - mean @ fields
        spread = max(noise, _DEVIATION * float(np.median(np.abs(left))))
        weight = min(1.0, _INDEPENDENT / left.size) / (spread**2 + left**2)
        normal = (fields * weight) @ fields.T + prior
        mean = np.asarray(np.linalg.solve(normal, (fields * weight) @ cells.z), np.float64)
    values, vectors = np.linalg.eigh(normal)
    root = vectors / np.sqrt(values)
    rig, kept, unknown = np.zeros((count, len(cells.rig))), np.eye(len(cells.rig)), np.zeros_like(root)
    misfit = spread / max(noise, 1e-300)
    return LoadFit(float(mean[-1]), 0.0, misfit, 0.0, mean[:-1], root, rig, kept, unknown)


def _explained(cells: _Cells, circles: Sequence[Circle], layer: Layer | None, solid: bool) -> LoadFit | None:
    """The mean of a load on the half-space or layer and of a dent that fades, by their odds; where neither
    fits, contacts of any round far field."""
    outside = _outside(cells, circles)
    if outside is None:
        return None
    faded = _sinks(cells, circles)
    kinds: list[tuple[_Fields, float]] = [
        (partial(far_field, layer), math.inf),
        (partial(_columns, _fading), faded),
        (partial(_columns, _any), max(_SINKS * cells.depth, faded)),
    ]
    kinds = kinds if cells.free.any() else kinds[:2]
    fits = [_fitted(outside, fields(circles, outside.x, outside.y), sinks) for fields, sinks in kinds]
    load, fades, either = fits[0], fits[1], fits[-1]
    best = min((one.fit.rho for one in fits if one is not None), default=0.0)
    odds = (solid * _likelihood(load, best), _likelihood(fades, best))
    likely = [(share, one) for share, one in zip(odds, (load, fades), strict=True) if one and share > 0]
    likely = likely or [(1.0, one) for one in (either,) if one]
    each = [_as_load_fit(outside.noise, one) for _, one in likely]
    return _mean(each, np.array([share for share, _ in likely])) if each else None


def _likelihood(load: _Load | None, best: float) -> float:
    """Of a fit, as if the best one left noise, and of its motion; 0 if it misses what the best one sees."""
    if load is None or load.fit.rho > _MUCH * best:
        return 0.0
    motion = load.fit.found[load.fields : -1, 0]
    power = _INDEPENDENT * ((load.fit.rho / max(best, 1e-300)) ** 2 - 1) + motion @ motion
    return math.exp(-0.5 * power)


def _mean(fits: list[LoadFit], likely: Floats) -> LoadFit:
    """The mean of fits by their likelihood; the rest is of the likeliest."""
    each, likely = np.array([[*one.motion, one.c] for one in fits]), likely / likely.sum()
    best, mean = fits[int(likely.argmax())], likely @ each
    spread = np.tensordot(likely, [one.root @ one.root.T for one in fits], 1)
    values, vectors = np.linalg.eigh(spread + (likely * (each - mean).T) @ (each - mean))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    turn = np.linalg.pinv(root, rcond=1e-6) @ best.root
    c, sigma, noise = float(mean[-1]), float(np.linalg.norm(root[-1])), turn @ best.noise @ turn.T
    return replace(best, c=c, sigma=sigma, motion=mean[:-1], root=root, noise=noise)


def _sinks(cells: _Cells, circles: Sequence[Circle]) -> float:
    """Standard deviation of c, mm, beside dents that fade: noise, and what they reach, as Gaussians of half
    the depth at their radii, at the anchors; any where these are not known."""
    if cells.anchors is None:
        return math.inf
    still = (_YIELDS if len(cells.motion) else _STILL) * cells.noise
    q = [np.hypot(*(cells.anchors - (cx, cy)).T) / radius for cx, cy, radius in circles]
    reach = rms(np.sum(0.5 ** np.square(q), axis=0)) if q else 0.0
    return math.hypot(still, cells.depth * reach)


def _fading(dx: Floats, dy: Floats, q: Floats, _radius: float) -> list[Floats]:
    waves = (np.exp(-rate * (q - 1)) for rate in _RATES)
    return [q**-3, q**-4, *waves, 0.5 ** (q**2 - 1), dx * q**-4, dy * q**-4]


def _any(dx: Floats, dy: Floats, q: Floats, _radius: float) -> list[Floats]:
    return [*(q**-power for power in range(1, 7)), dx * q**-4, dy * q**-4]


def _outside(cells: _Cells, circles: Sequence[Circle]) -> _Cells | None:
    """The cells outside two radii of the contacts; None of too few."""
    out = np.ones(cells.z.size, np.bool_)
    for cx, cy, radius in circles:
        out &= np.hypot(cells.x - cx, cells.y - cy) > _FAR * radius
    if np.count_nonzero(out) < _FEWEST:
        return None
    cells = _Cells._make([*(part[..., out] for part in cells[:8]), *cells[8:]])
    noise = math.sqrt(float(np.average(cells.sigma**2, weights=cells.weight)))
    return cells._replace(weight=cells.weight / cells.weight.sum(), noise=noise)


def _fitted(cells: _Cells, fields: Floats, sinks: float) -> _Load | None:
    """With these fields (t, n); sinks: standard deviation of c that is expected, mm."""
    root, noise, fewer = np.sqrt(cells.weight), cells.noise, len(fields)
    every = np.concatenate([fields, cells.motion, cells.free[None]]) * root
    seen = np.concatenate([cells.z[None], cells.rig]) * root
    if not (np.isfinite(every).all() and np.isfinite(seen).all()):
        return None  # of a damaged map
    size, unit = np.linalg.norm(every, axis=1), noise / math.sqrt(_INDEPENDENT)
    for _ in range(2):  # the residual weighs the prior
        aimed = np.full(len(every), unit)
        aimed[:fewer] /= max(_AMPLITUDE * cells.depth, noise, 1e-100)
        aimed[-1] /= sinks
        prior = np.hypot(np.where(size > 0, _TAILS * size, 1.0), aimed)
        found = fit(every, seen, prior)
        unit = math.sqrt(max(found.rho**2 - noise**2, 0.0) / _TAILED + noise**2 / _INDEPENDENT)
    return _Load(found, every, seen, root, prior, unit, fewer)


def _as_load_fit(noise: float, load: _Load) -> LoadFit:
    """The fit with its covariance, and the part of the rig's errors that it takes."""
    (found, inverse, rho), every, (_, *errors), root, prior, unit, fewer = load
    own = np.s_[fewer:]
    covariance, seen = unit**2 * inverse, inverse - (inverse * prior**2) @ inverse
    for each in (covariance, seen):
        if not every[-1].any():  # no free mode
            each[-1], each[:, -1] = 0.0, 0.0
    values, vectors = np.linalg.eigh(covariance[own, own])
    half = vectors * np.sqrt(np.maximum(values, 0.0))
    turn = np.linalg.pinv(half, rcond=1e-6)
    left = np.linalg.norm(np.reshape(errors, (-1, root.size)) - found[:, 1:].T @ every, axis=0)
    known = math.hypot(noise, float(np.median(left / np.maximum(root, 1e-300))))
    by_noise = noise**2 / _INDEPENDENT * turn @ seen[own, own] @ turn.T
    misfits = rho / max(noise, 1e-300), rho / max(known, 1e-300)
    fitted = float(found[-1, 0]), math.sqrt(covariance[-1, -1]), *misfits, found[fewer:-1, 0]
    return LoadFit(*fitted, half, found[fewer:, 1:], np.eye(len(errors)), by_noise)
