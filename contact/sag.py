"""How far everything sinks under a load, and how far the rig moved, measured in the map itself.

Heights less rest are known but for one free mode m(x, y), which an anchor settles: it counts as at rest. An
elastic half-space sinks there, too. Away from the contacts, in units of their radii q = r / a, the map is
therefore

    z' = c m + sum over motions of  a M  + sum over contacts of  A / q + (B dx + C dy + D) / q^3

(K. L. Johnson, Contact Mechanics, 1985, eq. 3.42; of a layer its Green's function in place of 1 / q) by least
squares over the good cells outside f radii of every contact, weighted by area and noise, a = 0 +- 1.
With weights that sum to one the covariance is (rho / 3)^2 (A^T W A)^-1, rho the rms residual. f is 2, 2.5, 3
or 4. Where dents fade, as on a layer of unknown thickness, powers of q take the place of the sum; c is
0 +- 2.5 noises, 6 where the rig may move, or free.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from optolever.scene import Layer

from .arrays import Circle, Floats, rms
from .pressure import BONDED, bonded
from .regions import COLUMNS, Region, areas, regions
from .surface import Sag, Surface

__all__ = ["far_field", "sag"]

_FAR = (2.0, 2.5, 3.0, 4.0)  # radii of a contact
_APART = 3.0  # standard deviations between such fits
_WORSE, _MUCH = 1.1, 1.5  # residual of a fit over others, above which it misses what these see
_ROUNDS = 3  # of regions in the map less its sag
_FEWEST = 200  # cells outside the contacts
_MOST = 6000  # cells of the fit
_TAILS = 1e-6  # of a column: amplitudes that the map does not show stay small
_ROBUST = 12  # rounds of Cauchy's weights
_INDEPENDENT = 36.0  # samples of noise, and of a robust fit
_TAILED = 9.0  # samples of what tails of dents leave
_BEYOND = 5.0  # standard deviations: motions beyond their prior are found, too
_SEEN = 2.0  # standard deviations of c under a load
_STILL, _YIELDS = 2.5, 6.0  # noises: of a dent that fades; where the rig moves, which hides a layer's sinking
_SINKS = 0.05  # of the largest height: what sinks with it, whatever the far field is
_FADES, _ANY = range(3, 9), range(1, 7)  # powers of the distance
_OUTLIER = 3.0  # standard deviations of a robust fit: beyond, cells count less
_DEVIATION = 1.4826  # standard deviation over median absolute deviation


#: Of circles, x and y (n,): columns (k, n).
_Fields = Callable[[Sequence[Circle], Floats, Floats], Floats]


class _Cells(NamedTuple):
    """Cells (n,) of a fit."""

    x: Floats
    y: Floats
    z: Floats
    sigma: Floats
    weight: Floats
    free: Floats
    motion: Floats
    rig: Floats


class _Outside(NamedTuple):
    """Cells (n,) far from the contacts; times the root of their weight own (n, k + 1): the motion's modes and
    the free one, right (n,): heights, errors (n, m): the rig's; sinks: whether there is a free mode."""

    x: Floats
    y: Floats
    root: Floats
    noise: float
    own: Floats
    right: Floats
    errors: Floats
    sinks: bool


class _Fit(NamedTuple):
    """Of `fields` in number, motion and the free mode: found (terms, 1 + m) of heights and errors, rho: rms
    residual, unit: standard deviation of what a cell says."""

    weighted: Floats
    upper: Floats
    prior: Floats
    found: Floats
    rho: float
    unit: float
    fields: int


def sag(surface: Surface, layer: Layer | None) -> Sag | None:
    """Fit sinking, motion and far fields to a surface outside its regions, which are found again in the
    corrected map. layer: elastic, None is a half-space. Returns None if too few cells lie outside the
    contacts."""
    cells, noise = _cells(surface)
    thin = surface.thinned(max(1, surface.z.shape[1] // COLUMNS))

    def regions_less(taken: Sag) -> tuple[Region, ...]:
        less = thin.less(replace(taken, rig=taken.rig[:, :0], kept=taken.kept[:0, :0]))
        return regions(less, COLUMNS // 2)

    start = _robust(cells, noise) if len(cells.motion) and cells.z.size else None
    first = regions(thin) if start is None else regions_less(start)
    if start is not None:
        away = (cells.z - start.motion @ cells.motion) / (_OUTLIER * start.misfit * max(noise, 1e-300))
        cells = cells._replace(weight=cells.weight / (1 + away**2))  # where no motion is what modes say
    fits = list[Sag]()
    for far in _FAR:
        # each from the robust fit: a contact that one distance loses is not lost to the others
        found, within, before = None, first, None
        for rounds_left in reversed(range(_ROUNDS)):
            circles = [circle for one in within for circle in one.circles]
            if circles == before:
                break
            found, before = _simplest(cells, circles, layer, far, noise), circles
            if found is None:
                break
            within = regions_less(found) if rounds_left else within
        if found is not None:
            fits.append(found)
        if not within:  # no radius to be far from
            break
    found = _nearest(cells, fits)
    return None if found is None else replace(found, kept=_kept(found))


def _nearest(cells: _Cells, fits: list[Sag]) -> Sag | None:
    """The fit nearest to the contacts that those farther away agree with (O. V. Lepskii, Theory Probab. Appl.
    35:454, 1991): in what is taken off, and in what is left."""
    fields = np.concatenate([cells.motion, cells.free[None]])
    taken = [np.append(one.motion, one.c) @ fields for one in fits]
    sizes = [rms(one.root.T @ fields) * math.sqrt(len(fields)) for one in fits]
    for k, one in enumerate(fits):
        others = range(k + 1, len(fits))
        if all(
            rms(taken[k] - taken[n]) < _APART * math.hypot(sizes[k], sizes[n])
            and max(one.misfit, 1.0) < _WORSE * max(fits[n].misfit, 1.0)
            for n in others
        ):
            break
    else:
        return None
    if not others and k:  # none farther away confirms it
        wider = math.hypot(1.0, rms(taken[k] - taken[k - 1]) / max(sizes[k], 1e-300))
        one = replace(one, sigma=one.sigma * wider, root=one.root * wider, noise=one.noise / wider**2)
    return one


def _kept(found: Sag) -> Floats:
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
    columns = []
    for cx, cy, radius in circles:
        dx, dy = (x - cx) / radius, (y - cy) / radius
        q = np.maximum(np.hypot(dx, dy), 1.0)
        at, slope, bend = 1 / q, -(q**-3), 2 * q**-3
        if layer is not None and layer.thickness_mm is not None:
            base, size = bonded(layer.poisson), radius / layer.thickness_mm
            r = np.minimum(q * size, BONDED)
            at = at + size * base(r)
            slope = slope + size**2 * base(r, 1) / q
            bend = bend + size**3 * base(r, 2)
        columns += [at, slope * dx, slope * dy, bend + slope]
    return np.stack(columns) if columns else np.zeros((0, *np.shape(x)))


def _cells(surface: Surface) -> tuple[_Cells, float]:
    """Cells of the modes' grid that everything is known of, and their median noise."""
    step = surface.step * max(1, round(math.sqrt(surface.z.size / _MOST) / surface.step))
    few, some = (slice(None, None, step),) * 2, (slice(None, None, step // surface.step),) * 2
    area = areas(surface.x, surface.y)[few]
    modes = np.zeros((0, *area.shape))
    if surface.modes is not None:
        modes = np.asarray(surface.modes[:, *some], np.float64)
    rig, motion = np.split(modes, [len(modes) - surface.motions])
    free = np.zeros(area.shape) if surface.free is None else np.asarray(surface.free[few], np.float64)
    known = surface.good[few] & np.isfinite(surface.z[few] + surface.x[few] + surface.y[few] + free)
    known &= np.isfinite(modes).all(axis=0)
    x, y, z = (part[few][known].astype(np.float64) for part in (surface.x, surface.y, surface.z))
    sigma = np.asarray(surface.sigma[few][known], np.float64)
    noise = float(np.median(sigma)) if sigma.size else 0.0
    weight = area[known] / (1 + np.square(sigma / max(noise, 1e-300)))
    return _Cells(x, y, z, sigma, weight, free[known], motion[:, known], rig[:, known]), noise


def _robust(cells: _Cells, noise: float) -> Sag:
    """The motion alone, whatever dents there are: Cauchy's weights."""
    count, spread = len(cells.motion), 0.0
    mean = np.zeros(count)
    for _ in range(_ROBUST):
        left = cells.z - mean @ cells.motion
        spread = max(noise, _DEVIATION * float(np.median(np.abs(left))))
        weight = min(1.0, _INDEPENDENT / left.size) / (spread**2 + left**2)
        normal = (cells.motion * weight) @ cells.motion.T + np.eye(count) / _BEYOND**2
        mean = np.asarray(np.linalg.solve(normal, (cells.motion * weight) @ cells.z), np.float64)
    root = np.zeros((count + 1, count + 1))
    values, vectors = np.linalg.eigh(normal)
    root[:count, :count] = vectors / np.sqrt(values)
    rig = np.zeros((count + 1, len(cells.rig)))
    kept, unknown = np.eye(len(cells.rig)), np.zeros_like(root)
    return Sag(0.0, 0.0, spread / max(noise, 1e-300), 0.0, mean, root, rig, kept, unknown)


def _simplest(
    cells: _Cells, circles: Sequence[Circle], layer: Layer | None, far: float, noise: float
) -> Sag | None:
    """By cells outside so many radii of the contacts, the first that leaves hardly more than the best: a load
    on the half-space or layer; a dent that fades while nothing sinks; contacts of any round far field.
    Without a free mode nothing counts as at rest: of load and dent that fades the one that leaves less."""
    kinds: list[tuple[float, _Fields, float]] = [
        (_WORSE, partial(far_field, layer), math.inf),
        (_MUCH, partial(_round, _FADES), (_YIELDS if len(cells.motion) else _STILL) * noise),
        (1.0, partial(_round, _ANY), _SINKS * float(cells.z.max(initial=0.0))),
    ]
    if not cells.free.any():  # a load's fields look like errors of the rig: only where they leave less
        kinds = [(1.0, *kinds[0][1:]), (1.0, *kinds[1][1:])]
    outside = _outside(cells, circles, far)
    if outside is None:
        return None
    fits = [
        (much, _fitted(outside, fields(circles, outside.x, outside.y), sinks))
        for much, fields, sinks in kinds
    ]
    found = [(much, one) for much, one in fits if one is not None]
    best = min((one.rho for _, one in found), default=0.0)
    if found:
        load = _as_sag(outside, found[0][1])
        if abs(load.c) < _SEEN * load.sigma or found[0][1].rho > _WORSE * best:  # 0 without a free mode
            found = found[1:]
    one = next((one for much, one in found if one.rho <= much * best), None)
    return None if one is None else _as_sag(outside, one)


def _round(powers: range, circles: Sequence[Circle], x: Floats, y: Floats) -> Floats:
    """Heights (n * k, ...) around contacts that fall with these powers of the distance, and their first
    moments."""
    columns = []
    for cx, cy, radius in circles:
        dx, dy = (x - cx) / radius, (y - cy) / radius
        t = 1 / np.maximum(np.hypot(dx, dy), 1.0)
        columns += [*(t**power for power in powers), dx * t**3, dy * t**3]
    return np.reshape(columns, (-1, *np.shape(x)))


def _outside(cells: _Cells, circles: Sequence[Circle], far: float) -> _Outside | None:
    """The cells outside so many radii of the contacts; None of too few."""
    out = np.ones(cells.z.size, np.bool_)
    for cx, cy, radius in circles:
        out &= np.hypot(cells.x - cx, cells.y - cy) > far * radius
    if np.count_nonzero(out) < _FEWEST:
        return None
    x, y, z, sigma, weight = (part[out] for part in cells[:5])
    noise, root = math.sqrt(float(weight @ sigma**2 / weight.sum())), np.sqrt(weight / weight.sum())
    own = (np.concatenate([cells.motion[:, out], cells.free[None, out]]) * root).T
    return _Outside(x, y, root, noise, own, z * root, (cells.rig[:, out] * root).T, bool(cells.free.any()))


def _fitted(outside: _Outside, fields: Floats, sinks: float) -> _Fit | None:
    """With these fields (t, n); sinks: standard deviation of c that is expected, mm."""
    noise, fewer = outside.noise, len(fields)
    weighted = np.concatenate([fields * outside.root, outside.own.T]).T
    terms, motions = weighted.shape[1], slice(fewer, weighted.shape[1] - 1)
    # the triangle of all equations: fits of as many as there are terms
    every = np.concatenate([weighted.T, outside.right[None], outside.errors.T]).T
    triangle = np.asarray(np.linalg.qr(every, mode="r"))
    if not np.isfinite(triangle).all():
        return None  # of a damaged map
    upper, lost = triangle[:terms, :terms], abs(float(triangle[terms, terms]))
    size = np.linalg.norm(upper, axis=0)
    prior = np.where(size > 0, _TAILS * size, 1.0)
    unit = noise / math.sqrt(_INDEPENDENT)
    aims = np.zeros((2 * terms, triangle.shape[1] - terms))
    aims[:terms] = triangle[:terms, terms:]
    rounding = np.finfo(np.float64).eps * len(weighted)
    for _ in range(2):  # the residual weighs the motion's prior
        prior[motions] = np.hypot(_TAILS * size[motions], unit)
        prior[-1] = math.hypot(_TAILS * size[-1] if size[-1] > 0 else 1.0, unit / sinks)
        whole = np.vstack([upper, np.diag(prior)])
        found = np.linalg.lstsq(whole, aims, rcond=rounding)[0]
        rho = math.hypot(lost, float(np.linalg.norm(aims[:terms, 0] - upper @ found[:, 0])))
        unit = math.sqrt(max(rho**2 - noise**2, 0.0) / _TAILED + noise**2 / _INDEPENDENT)
    return _Fit(weighted, upper, prior, found, rho, unit, fewer)


def _as_sag(outside: _Outside, fit: _Fit) -> Sag:
    """The fit with its covariance, and the part of the rig's errors that it takes."""
    weighted, upper, prior, found, rho, unit, fewer = fit
    noise, scale = outside.noise, np.hypot(np.linalg.norm(upper, axis=0), prior)
    normal = (upper.T @ upper + np.diag(prior**2)) / np.multiply.outer(scale, scale)
    inverse = (np.linalg.inv(normal) / np.multiply.outer(scale, scale))[fewer:]
    if not outside.sinks:
        inverse[-1], inverse[:, -1] = 0.0, 0.0
    covariance = unit**2 * inverse[:, fewer:]
    values, vectors = np.linalg.eigh(covariance)
    deviation = float(np.sqrt(covariance[-1, -1]))
    half = vectors * np.sqrt(np.maximum(values, 0.0))
    gain = np.linalg.pinv(half, rcond=1e-6) @ inverse @ upper.T
    by_noise = noise**2 / _INDEPENDENT * gain @ gain.T
    left = np.linalg.norm(outside.errors - weighted @ found[:, 1:], axis=1)
    known = math.hypot(noise, float(np.median(left / np.maximum(outside.root, 1e-300))))
    return Sag(
        *(float(found[-1, 0]), deviation, rho / max(noise, 1e-300), rho / max(known, 1e-300)),
        *(found[fewer:-1, 0], half, found[fewer:, 1:]),
        kept=np.eye(outside.errors.shape[1]),
        noise=by_noise,
    )
