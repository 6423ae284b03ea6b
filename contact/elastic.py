"""Contacts by the elastic field around them: place, radius, depth and force, each with sigma, from one fit.

A pressure ~ (1 - s^2 / a^2)^m on a disc of radius a (m = -1/2: a flat punch, 1/2: a ball) moves a half-space,
F its force, by

    w(r) = F / (pi E* r) 2F1(1/2, 1/2; m + 2; a^2 / r^2)                                outside the disc,
    w(r) = F / (pi E* a) (m + 1) B(1/2, m + 1) 2F1(1/2, -1/2 - m; 1; r^2 / a^2)         inside

(I. N. Sneddon, Int. J. Engng Sci. 3:47, 1965). A base below a layer of thickness h adds F / (pi E* h) times
b + a^2 / (4 (m + 2)) laplace b, b: `pressure.bonded`. A long contact is several discs of one radius and m,
each with its own F. F and the motion's modes enter linearly; place, log a, m and an unknown h by Gauss-Newton
steps.

Two fits are compared: to the cells beyond 1.3 radii of the contacts ("flank"), and to all cells ("whole").
Where the flank does not follow such a field, the pressure is another one or the surface fades: nothing is
found.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np
import scipy

from optolever.arrays import Floats, Ints, Mask, norm
from optolever.blocks import blas_on_one
from optolever.scene import Layer

from .pressure import BONDED, bonded
from .regions import Region
from .surface import Surface

__all__ = ["CLEAR", "ElasticFit", "elastic_fits"]

_MOST, _FEWEST = 3000, 40  # cells of a fit
#: Share of a contact's cells that are measured: below, its figures are the field's and no thickness is named.
CLEAR = 0.9
_INDEPENDENT, _MISFIT = 36.0, 9.0  # independent samples of the map's noise, of its further residual
_NEAR, _REACH = 1.3, 8.0  # radii of a contact: where a flank begins, and ends
_WIDER = 1.6  # resolutions: up to there a map smooths a contact to a wider one
_POWER, _POWERS = (0.5, 0.8), (-0.5, 2.0)  # m: mean and sigma; least and most
_PLACE, _CUT, _SIZE = 0.5, 1.0, 0.4  # sigmas: of a place, radii, of a cut contact's; of log a
_FREE = 1e3  # sigma of a force over E*, mm^2
_THICK, _THICKEST = 2.0, 4.0  # log of h over the largest radius: start; sigma about it
_STEP, _ROUNDS, _LEAP = 1e-4, 25, 0.3  # relative: of differences, and where they end
_ROUGH = 0.03  # of the depth: misfit inside that the whole fit allows for
_REFUSED = (0.03, 8.0, 0.005)  # misfit over the depth; in noises and over the depth
_FOLLOWS, _APART = 0.007, 1.7  # of the depth: misfit of a whole fit; sigmas between both forces
_AROUND, _FINE = 1.6, 33  # radii: half of the depth lies inside; cells of its area, a side
_PLACES = np.linspace(0.0, 1.0, 129)  # of a pressure's field
_SHARES = 0.5, 0.3  # of the difference of both forces in the sigma of the whole fit's, of the flank's
_FORCE, _THIN = 0.002, 0.09  # least relative sigma of a force; of one on a layer, times (a / h)^4


@dataclass(frozen=True, slots=True, eq=False)
class ElasticFit:
    """One contact by the field around it.

    values, sigmas (8,): x, y, radius a of the pressure and depth (mm), force over E* (mm^2), power m of the
    pressure, area (mm^2) and volume (mm^3) of what is deeper than half the depth, and their standard
    deviations by noise, modes and what such pressures leave out; pressure: in the middle, over E*; whole: the
    inside follows the same pressure; bound: the depth is a lower bound: m is at its limit, or the deepest
    place lies outside the map; misfit: rms residual over noise of the cells next to the contact; left: what
    of it exceeds noise, over the depth; thickness, thickness_sigma: of the bonded layer that was looked for,
    mm (None: it was given, or a half-space is)."""

    values: Floats
    sigmas: Floats
    pressure: float
    whole: bool
    bound: bool
    misfit: float
    left: float
    thickness: float | None
    thickness_sigma: float | None


class _Cells(NamedTuple):
    """Cells (n,) of a fit: place, height, root of the weight, nearest contact; rig, own (m, n): modes of the
    rig's errors and of its motion; noise: rms, mm."""

    x: Floats
    y: Floats
    z: Floats
    root: Floats
    nearest: Ints
    rig: Floats
    own: Floats
    noise: float


class _Discs(NamedTuple):
    """Discs (n,) of the contacts: x, y, contact; size (k,): radius of each contact's first, cut (k,)."""

    x: Floats
    y: Floats
    owner: Ints
    size: Floats
    cut: Mask


class _Solved(NamedTuple):
    """Terms (t,): dx, dy, log a, m of each contact, F / (pi E*) of each disc, the modes, log h where it is
    looked for; their covariance; misfit (k,): rms residual over noise; excess (k,): of it over noise, mm."""

    terms: Floats
    covariance: Floats
    misfit: Floats
    excess: Floats


class _Base(NamedTuple):
    """A bonded layer's thickness (mm, inf: a half-space) and Poisson's ratio."""

    thickness: float
    poisson: float


@blas_on_one()
def elastic_fits(
    surface: Surface,
    regions: Sequence[Region],
    layer: Layer | None,
    resolution: float = 0.0,
    thin: bool = True,
) -> list[ElasticFit | None]:
    """Of every region of a map less rest, in their order; None where no such pressure makes the heights
    around. layer: elastic, its modulus does not matter, None: a half-space; where no thickness is given and a
    half-space does not make the field, a thickness is looked for if `thin`. resolution: smaller contacts
    (radius, mm) look wider in the map than they are."""
    poisson, thickness = (0.5, None) if layer is None else (layer.poisson, layer.thickness_mm)
    base = _Base(thickness or math.inf, poisson)
    found: list[ElasticFit | None] = [None] * len(regions)
    for search in (False, True)[: 1 + (thin and thickness is None)]:
        clear = [not search or surface.good[one.box][one.inside].mean() > CLEAR for one in regions]
        # half a disc is as long as two: it is one, unless one does not make the field
        for single in (True, False)[0 if any(one.cut for one in regions) else 1 :]:
            if None not in found:
                break
            solve = partial(_fit, surface, regions, _discs(regions, single), base, resolution, search)
            flank = solve(_NEAR, 0.0)
            whole = solve(0.0, _ROUGH) if flank else None
            for k, one in enumerate(flank or []):
                new = _chosen(one, whole[k] if whole else None, regions[k].radius >= resolution)
                if found[k] is None and (not search or (new is not None and new.whole and clear[k])):
                    found[k] = new
    return found


def _chosen(flank: ElasticFit, whole: ElasticFit | None, resolved: bool) -> ElasticFit | None:
    """One of a contact's two fits, its sigmas with their difference; None where the flank's is refused."""
    if _refused(flank):
        return None
    if whole is None or _refused(whole) or whole.left > _FOLLOWS or not resolved:
        return flank
    apart = float(whole.values[4] - flank.values[4])
    inside = abs(apart) < _APART * float(flank.sigmas[4])
    one, share = (whole, _SHARES[0]) if inside else (flank, _SHARES[1])
    sigmas = one.sigmas.copy()
    sigmas[4] = norm(sigmas[4], share * apart)
    return replace(one, sigmas=sigmas, whole=inside)


def _refused(fit: ElasticFit) -> bool:
    most, noises, share = _REFUSED
    return min(fit.values[3:5]) <= 0 or fit.left > most or (fit.misfit > noises and fit.left > share)


def _discs(regions: Sequence[Region], single: bool) -> _Discs:
    """Of contacts; single: a cut one has one."""
    parts = [((one.x, one.y, one.radius),) if single and one.cut else one.circles for one in regions]
    x, y, _ = np.array([disc for part in parts for disc in part], np.float64).reshape(-1, 3).T
    owner = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    size = np.array([part[0][2] for part in parts], np.float64)
    return _Discs(x, y, owner, size, np.array([one.cut for one in regions], np.bool_))


def _fit(
    surface: Surface,
    regions: Sequence[Region],
    discs: _Discs,
    base: _Base,
    resolution: float,
    search: bool,
    near: float,
    tolerance: float,
) -> list[ElasticFit] | None:
    """To the cells outside so many radii, or as far outside of what the resolution blurs; None of too few.
    tolerance: sigma over the depth of heights within 1.3 radii."""
    cells = _cells(surface, discs, _WIDER * resolution / _NEAR, near, tolerance)
    if cells is None:
        return None
    count, first, own = len(regions), 4 * len(regions) + discs.x.size, len(cells.own)
    sigma, mean = np.ones(first + own + search), np.zeros(first + own + search)
    place = np.where(discs.cut, _CUT, _PLACE) * discs.size
    grown = np.where(discs.size < resolution, 3 * _SIZE, _SIZE)
    sigma[: 4 * count] = np.stack([place, place, grown, np.full(count, _POWER[1])], axis=1).ravel()
    sigma[4 * count : first], mean[3 : 4 * count : 4] = _FREE, _POWER[0]
    if search:
        sigma[-1], mean[-1] = _THICKEST, _THICK + math.log(discs.size.max())
    start = mean.copy()
    depths = np.array([one.depth for one in regions])
    start[4 * count : first] = (0.6 * depths * discs.size / np.bincount(discs.owner))[discs.owner]
    solved = _solved(cells, discs, base, search, start, mean, sigma)
    return [_figures(surface, solved, discs, base, search, k) for k in range(count)]


def _cells(surface: Surface, discs: _Discs, least: float, near: float, tolerance: float) -> _Cells | None:
    """least: radius of a disc, mm, that smaller ones are taken for."""
    away, nearest = np.full(surface.z.shape, np.inf), np.zeros(surface.z.shape, np.int64)
    for x, y, k in zip(discs.x, discs.y, discs.owner.tolist(), strict=True):
        off = np.hypot(surface.x - x, surface.y - y) / max(discs.size[k], least)
        nearest[off < away] = k
        np.fmin(away, off, out=away)
    use = surface.good & np.isfinite(surface.z + surface.sigma) & (away > near) & (away < _REACH)
    every = max(1, round(math.sqrt(np.count_nonzero(use) / _MOST)))
    row, col = (every * part for part in np.nonzero(use[::every, ::every]))
    if row.size < _FEWEST:
        return None
    x, y, z, sigma = (
        np.asarray(part[row, col], np.float64) for part in (surface.x, surface.y, surface.z, surface.sigma)
    )
    ends = zip((row, col), surface.common.shape[1:], strict=True)
    coarse = [np.minimum(np.rint(at / surface.step).astype(int), size - 1) for at, size in ends]
    modes = np.asarray(surface.common[:, *coarse], np.float64)
    rig, own = np.split(modes, [len(modes) - surface.motions])
    noise = math.sqrt(float(np.mean(sigma**2)))
    deepest = max(float(np.max(surface.z, where=surface.good, initial=0.0)), noise)
    rough = np.where(away[row, col] < _NEAR, tolerance * deepest, 0.0)
    root = 1 / np.sqrt(sigma**2 + noise**2 + rough**2)
    return _Cells(x, y, z, root, nearest[row, col], rig, own, noise)


def _inside(surface: Surface, x: float, y: float) -> bool:
    """Whether the measured cell that is nearest to a place lies within the box of all."""
    away = np.where(surface.good, np.hypot(surface.x - x, surface.y - y), np.inf)
    at = np.unravel_index(int(np.nanargmin(away)), away.shape)
    lines = (np.flatnonzero(surface.good.any(axis=axis)) for axis in (1, 0))
    return all(one[0] < line < one[-1] for line, one in zip(at, lines, strict=True))


def _solved(
    cells: _Cells, discs: _Discs, base: _Base, search: bool, start: Floats, mean: Floats, sigma: Floats
) -> _Solved:
    """Gauss-Newton steps; `unit`: standard deviation of a cell's residual, of so few independent ones."""
    count, terms, unit = discs.size.size, start.copy(), 1.0
    shapes, own = slice(0, 4 * count), slice(4 * count + discs.x.size, start.size - search)
    leaps = np.stack([discs.size, discs.size, np.ones(count), np.ones(count)], axis=1).ravel()
    for _ in range(_ROUNDS):
        total, by = _heights(discs, base, search, terms, cells.x, cells.y)
        by[own], rest = cells.own, cells.z - total - terms[own] @ cells.own
        weighted = by * cells.root
        normal = weighted @ weighted.T / unit**2 + np.diag(sigma**-2)
        scale = 1 / np.sqrt(np.diagonal(normal))
        inverse = np.linalg.inv(normal * np.multiply.outer(scale, scale)) * np.multiply.outer(scale, scale)
        step = inverse @ (weighted @ (rest * cells.root) / unit**2 + (mean - terms) / sigma**2)
        leap = max(float(np.max(np.abs(step[shapes]) / leaps)), abs(float(step[-1])) if search else 0.0)
        terms = terms + step * min(1.0, _LEAP / max(leap, 1e-9))
        terms[3 : 4 * count : 4] = np.clip(terms[3 : 4 * count : 4], *_POWERS)
        terms[2 : 4 * count : 4] = np.clip(terms[2 : 4 * count : 4], -1.5, 1.0)
        chi = float(np.mean(np.square(rest * cells.root)))
        unit = math.sqrt(rest.size * (max(chi - 1, 0) / _MISFIT + min(chi, 1) / _INDEPENDENT))
        if leap < _STEP:
            break
    by_rig = inverse @ (weighted * cells.root) @ cells.rig.T / unit**2
    parts = (np.bincount(cells.nearest, part, count) for part in (rest**2, np.square(rest * cells.root)))
    excess, misfit = (part / np.maximum(np.bincount(cells.nearest, minlength=count), 1) for part in parts)
    excess = np.sqrt(np.maximum(excess - cells.noise**2, 0.0))
    return _Solved(terms, inverse + by_rig @ by_rig.T, np.sqrt(2 * misfit), excess)


def _heights(
    discs: _Discs, base: _Base, search: bool, terms: Floats, x: Floats, y: Floats
) -> tuple[Floats, Floats]:
    """Heights (n,) at places by all discs, and their derivatives by the terms (t, n)."""
    total, by, contacts = np.zeros(x.size), np.zeros((terms.size, x.size)), 4 * discs.size.size
    if search:
        base = base._replace(thickness=math.exp(terms[-1]))
    for n, k in enumerate(discs.owner.tolist()):
        dx, dy, grown, m = terms[4 * k : 4 * k + 4].tolist()
        right, up = x - discs.x[n] - dx, y - discs.y[n] - dy
        r, load = np.hypot(right, up), float(terms[contacts + n])
        w, slope, by_size, by_power, by_thickness = _profile(
            r, float(discs.size[k]) * math.exp(grown), m, base
        )
        total += load * w
        by[contacts + n] = w
        toward = -load * slope / np.maximum(r, 1e-9)
        by[4 * k : 4 * k + 4] += [toward * right, toward * up, load * by_size, load * by_power]
        if search:
            by[-1] += load * by_thickness
    return total, by


def _profile(r: Floats, a: float, m: float, base: _Base) -> Floats:
    """w pi E* / F at distances r (n,), and its derivatives by r, log a, m and log h: (5, n), mm^-1."""
    q, h, w = r / a, base.thickness, np.zeros((5, r.size))
    for where, table, outside in zip((q < 1, q >= 1), _tables(), (False, True), strict=True):
        here = q[where]
        u = 1 / here if outside else here
        t = np.sqrt(np.maximum(1 - u, 1e-8))
        line = scipy.interpolate.PPoly(np.stack([table(m), table(m, 1)], axis=-1), _PLACES)
        (value, by_power), by_t = line(t).T, line(t, 1)[:, 0]
        by_q = by_t / (2 * t) * (u**2 if outside else -1)
        w[:4, where] = np.stack([value, by_q / a, -value - here * by_q, by_power]) / a
    if math.isfinite(h):
        at, spline, share = np.clip(r / h, 0.02, BONDED), bonded(base.poisson), (a / h) ** 2 / (4 * (m + 2))
        b, slope, bend, third = (spline(at, order) for order in range(4))
        disc = bend + slope / at
        added, steep = b + share * disc, slope + share * (third + (bend - slope / at) / at)
        by_size = 2 * share * disc
        near = added, steep / h, by_size, -share / (m + 2) * disc, -at * steep - by_size - added
        far, none = np.maximum(r, a), np.zeros(r.size)
        w += np.where(at < BONDED, np.stack(near) / h, [-1 / far, far**-2, none, none, none])
    return w


@lru_cache(maxsize=1)
def _tables() -> "tuple[scipy.interpolate.CubicSpline, ...]":
    """By m splines' pieces (4, n) of w pi E* a / F inside and outside between `_PLACES` of sqrt(1 - u),
    u = q and 1 / q: smooth at the disc's end."""
    m, u = np.linspace(_POWERS[0], _POWERS[1] + 0.05, 52)[:, None], 1 - _PLACES**2
    inside = (m + 1) * scipy.special.beta(0.5, m + 1) * scipy.special.hyp2f1(0.5, -0.5 - m, 1, u**2)
    outside = u * scipy.special.hyp2f1(0.5, 0.5, m + 2, u**2)
    lines = (scipy.interpolate.CubicSpline(_PLACES, each, axis=1).c for each in (inside, outside))
    return tuple(scipy.interpolate.CubicSpline(m[:, 0], np.moveaxis(each, 2, 0)) for each in lines)


def _figures(
    surface: Surface, solved: _Solved, discs: _Discs, base: _Base, search: bool, k: int
) -> ElasticFit:
    terms, contacts = solved.terms, 4 * discs.size.size
    mine = np.flatnonzero(discs.owner == k)
    x, y = discs.x[mine] + terms[4 * k], discs.y[mine] + terms[4 * k + 1]
    size, m = float(discs.size[k]) * math.exp(terms[4 * k + 2]), float(terms[4 * k + 3])
    heights = partial(_heights, discs, base, search, terms)
    depths, by = heights(x, y)
    deepest = int(depths.argmax())
    depth, turn = float(depths[deepest]), np.zeros((8, terms.size))
    turn[0, 4 * k] = turn[1, 4 * k + 1] = turn[5, 4 * k + 3] = 1.0
    turn[2, 4 * k + 2], turn[4, contacts + mine] = size, math.pi
    turn[3] = by[:, deepest]
    turn[3, 4 * k : 4 * k + 2] = 0.0  # the contact moves as one
    sides = [np.linspace(at.min() - _AROUND * size, at.max() + _AROUND * size, _FINE) for at in (x, y)]
    z, by = heights(*(part.ravel() for part in np.meshgrid(*sides)))
    cell = float(np.ptp(sides[0]) * np.ptp(sides[1])) / (_FINE - 1) ** 2
    rise = np.maximum(np.hypot(*np.gradient(z.reshape(_FINE, _FINE))).ravel(), 1e-9 * abs(depth))
    share = np.clip(0.5 + (z - 0.5 * depth) / rise, 0.0, 1.0) * cell
    turn[6] = (by - 0.5 * turn[3][:, None]) @ np.where((share > 0) & (share < cell), cell / rise, 0.0)
    turn[7] = by @ share + 0.5 * depth * turn[6]
    loads = terms[contacts + mine]
    load, area, volume = math.pi * float(loads.sum()), float(share.sum()), float(z @ share)
    values = np.array([x.mean(), y.mean(), size, depth, load, m, area, volume])
    sigmas = np.sqrt(np.einsum("it,ts,is->i", turn, solved.covariance, turn))
    h = math.exp(terms[-1]) if search else base.thickness
    sigmas[4] = norm(sigmas[4], (_FORCE + _THIN * (size / h) ** 4) * load)
    bound = m in _POWERS or not _inside(surface, x[deepest], y[deepest])
    left = float(solved.excess[k]) / max(abs(depth), 1e-300)
    more = (h, h * math.sqrt(solved.covariance[-1, -1])) if search else (None, None)
    pressure = (m + 1) * float(loads.max()) / size**2
    return ElasticFit(values, sigmas, pressure, False, bound, float(solved.misfit[k]), left, *more)
