"""Contacts: the figures of every region of a map less rest, with their standard deviations."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import scipy.ndimage

from optolever.arrays import Floats, Map, Mask, norm
from optolever.blocks import blas_on_one
from optolever.quantities import quantity
from optolever.scene import Layer
from optolever.schema import built

from .elastic import CLEAR, ElasticFit
from .pressure import forces_on
from .regions import Region, areas
from .surface import Surface, filled, spread

__all__ = ["Contact", "contacts"]

_HALF = 0.5  # of the depth: where a region ends
_SURE = 3.0  # standard deviations of a depth: others come last
_INNER = 0.7  # of the depth: cells of a second fit of the radius
_FEWEST = 12  # cells of a fit of the radius
_CURVED = 3.0  # sigma of a curvature, from which on its radius is finite
_DIPOLE = 1 / 3  # of the noise at an outline: what moves its centroid
_ROUNDING = 1 / math.sqrt(180)  # of a cell: the share of an area that an outline cuts off at random
_ROUGH, _UNSEEN = 0.02, 0.12  # of a fit's depth: least sigma, of one that is not measured
_ROUND = 0.6  # power of a pressure: below, a ball's or a flat punch's


@dataclass(frozen=True, slots=True)
class Contact:
    """One contact; lengths in mm, sigmas: standard deviations by noise and by the map's modes.

    x, y: centroid of the cells deeper than half the depth, position_sigma: of either; depth: of the deepest
    cell; area (mm^2), volume (mm^3): of these cells; their
    sigmas are upper bounds: noise is taken as common to them. cut: the map's end or unknown
    cells end the region; hole: cells that are not measured are inside, or beside its deepest cell.
    indenter_radius: of the surface inside, inf: flat within three sigma, None: of too few cells. force (N),
    force_sigma, pressure (the largest, of a flat punch in the middle, N/mm^2): where the elastic layer is
    known. row, col: the deepest cell. depth_at_least, force_at_least: lower bounds, the other one with area
    and volume: part of the contact is not measured, and the field around it does not follow an elastic
    layer, or not as far. layer_thickness, mm: of the bonded layer that makes the field around, where none is
    given.
    """

    x: float
    y: float
    position_sigma: float
    depth: float
    depth_sigma: float
    area: float
    area_sigma: float
    volume: float
    volume_sigma: float
    indenter_radius: float | None
    indenter_radius_sigma: float | None
    cut: bool
    hole: bool
    row: int
    col: int
    force: float | None = None
    force_sigma: float | None = None
    pressure: float | None = None
    depth_at_least: bool = False
    force_at_least: bool = False
    layer_thickness: float | None = None
    layer_thickness_sigma: float | None = None

    @property
    def radius(self) -> float:
        """Of a circle of its area, mm."""
        return math.sqrt(self.area / math.pi)

    def __str__(self) -> str:
        """With units and standard deviations, to their second digit."""
        deep, cut = ("at least " if bound else "" for bound in (self.depth_at_least, self.force_at_least))

        def give(name: str, unit: str) -> str:
            return quantity(getattr(self, name), unit, getattr(self, f"{name}_sigma"))

        parts = [
            f"depth {deep}{give('depth', 'mm')}",
            f"x {quantity(self.x, 'mm', self.position_sigma)}",
            f"y {quantity(self.y, 'mm', self.position_sigma)}",
            f"area {cut}{give('area', 'mm²')}",
            f"volume {cut}{give('volume', 'mm³')}",
        ]
        if self.indenter_radius is not None:
            flat = math.isinf(self.indenter_radius)
            parts.append("flat" if flat else f"radius {give('indenter_radius', 'mm')}")
        if self.force is not None:
            parts.append(f"force {cut}{quantity(self.force, 'N', self.force_sigma or math.nan)}")
        if self.pressure is not None and not self.force_at_least:  # a cut is a cliff
            parts.append(f"at most {quantity(self.pressure, 'N/mm²')}")
        if self.layer_thickness is not None:
            parts.append(f"as if on a layer of {give('layer_thickness', 'mm')}: give [layer] thickness_mm")
        return ", ".join(parts)

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {entry.name: getattr(self, entry.name) for entry in fields(self)}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> "Contact":
        """The inverse of to_dict; InputError where a value is missing."""
        found: Contact = built(cls, values, "contacts")
        return found


class _Dent(NamedTuple):
    """A region in its box, (r, c) each: x, y from the centroid, z, area of every cell, its share in the
    region, growth of the area by a height that is added there, mm^2/mm; modes (m,
    r, c); measured: cells that are; peak: the deepest cell in the box."""

    x: Floats
    y: Floats
    z: Floats
    sigma: Floats
    cell: Floats
    share: Floats
    growth: Floats
    slope: Floats
    modes: Floats
    inside: Mask
    holes: Mask
    measured: Mask
    peak: tuple[int, int]


@blas_on_one()
def contacts(
    surface: Surface,
    regions: Sequence[Region],
    layer: Layer | None,
    fits: Sequence[ElasticFit | None] = (),
) -> tuple[Contact, ...]:
    """The figures of a surface's regions, in their order, but last those whose depth is below three of its
    standard deviations; layer: elastic; None: no force is known; fits: of the regions by `elastic_fits`:
    their forces, and depths that are not measured, take the place of the map's."""
    if not regions:
        return ()
    z, known, holes = filled(surface.z, surface.good)
    fits = fits or [None] * len(regions)
    pairs = list(zip(regions, fits, strict=True))
    found: Sequence[Contact] = [_contact(surface, *pair, z, known, holes) for pair in pairs]
    if layer is not None:
        if None in fits:
            found = _pressed(surface, z, regions, found, layer)
        found = [_forced(one, fit, layer) for one, fit in zip(found, fits, strict=True)]
    return tuple(sorted(found, key=lambda one: one.depth < _SURE * one.depth_sigma))


def _forced(one: Contact, fit: ElasticFit | None, layer: Layer) -> Contact:
    """With the force of the fit."""
    if fit is None:
        return one
    modulus, load = layer.plane_modulus, float(fit.values[4])
    sigma = modulus * norm(fit.sigmas[4], load * layer.relative_sigma)
    return replace(one, force=modulus * load, force_sigma=sigma, pressure=modulus * fit.pressure)


def _contact(
    surface: Surface, region: Region, fit: ElasticFit | None, z: Map, known: Mask, holes: Mask
) -> Contact:
    dent = _dent(surface, region, z, known, holes)
    weight = dent.share * dent.cell
    depth, noise, tip, ended = _depth(dent)
    at_least, (radius, radius_sigma) = ended, _indenter(dent, depth)
    dark = float(dent.measured[dent.inside].mean()) < CLEAR
    shift = np.zeros((len(dent.modes), 2, 3)) if surface.displacement is None else surface.displacement
    modes = np.pad(dent.modes, ((0, len(shift) - len(dent.modes)), (0, 0), (0, 0)))
    depth_sigma = norm(noise, tip, *modes[:, *dent.peak])
    if fit is None or not (region.cut or dark):
        area, volume = float(weight.sum()), float((weight * dent.z).sum())
        x, y = (float((weight * part).sum() / area) for part in (dent.x, dent.y))
        noises = _noises(dent, noise, tip, area, depth, weight, region.cut)
        grown = (modes - _HALF * modes[:, *dent.peak, None, None]) * dent.growth
        by_area, arms = grown.sum(axis=(1, 2)), np.stack([dent.x - x, dent.y - y]) / area
        by_volume = (modes * weight).sum(axis=(1, 2)) + _HALF * depth * by_area
        by_place = np.einsum("krc,arc->ka", grown, arms)
    else:
        x, y, area, volume = (fit.values[[0, 1, 6, 7]] - (region.x, region.y, 0, 0)).tolist()
        wide, large = (norm(fit.sigmas[k], _ROUGH * fit.values[k]) for k in (6, 7))
        noises = wide, large, norm(*fit.sigmas[:2]) / math.sqrt(2)
        by_area, by_volume, by_place = (np.zeros((len(shift), *more)) for more in ((), (), (2,)))
    stretch = shift[:, 0, 1] + shift[:, 1, 2]
    by_place += shift @ np.array([1.0, region.x + x, region.y + y])
    if fit is not None:
        sigma = norm(fit.sigmas[3], (_ROUGH if fit.whole and not region.hole else _UNSEEN) * fit.values[3])
        # of a ball and a flat punch the deepest cells lie on the rim
        rim = fit.whole and fit.values[5] < _ROUND and sigma < depth_sigma
        if rim or (at_least and (region.cut or dark)):
            depth, depth_sigma, at_least = float(fit.values[3]), sigma, at_least and fit.bound
    return Contact(
        x=region.x + x,
        y=region.y + y,
        position_sigma=norm(noises[2], np.linalg.norm(by_place) / math.sqrt(2)),
        depth=depth,
        depth_sigma=depth_sigma,
        area=area,
        area_sigma=norm(noises[0], *(by_area + stretch * area)),
        volume=volume,
        volume_sigma=norm(noises[1], *(by_volume + stretch * volume)),
        indenter_radius=radius,
        indenter_radius_sigma=radius_sigma,
        cut=region.cut,
        hole=region.hole or ended,
        row=region.row,
        col=region.col,
        depth_at_least=at_least,
        force_at_least=region.cut and fit is None,
        layer_thickness=None if fit is None else fit.thickness,
        layer_thickness_sigma=None if fit is None else fit.thickness_sigma,
    )


def _dent(surface: Surface, region: Region, z: Map, known: Mask, holes: Mask) -> _Dent:
    box = region.box
    x, y, heights, sigma = (
        np.asarray(part[box], np.float64) for part in (surface.x, surface.y, z, surface.sigma)
    )
    cell = areas(x, y)
    pitch = math.sqrt(float(np.median(cell)))
    peak = region.row - box[0].start, region.col - box[1].start
    slope = _steepness(heights, x, y)
    rise = np.maximum(slope, 1e-12) * pitch
    near = scipy.ndimage.binary_dilation(region.inside)
    share = np.where(near, np.clip(0.5 + (heights - _HALF * heights[peak]) / rise, 0.0, 1.0), 0.0)
    own = scipy.ndimage.binary_dilation(region.inside & (share > 0))
    share[near & ~own] = 0.0  # cut off from it by another peak
    growth = np.where((share > 0) & (share < 1), cell / rise, 0.0)
    places = [np.arange(part.start, part.stop) for part in box]
    modes = np.reshape([spread(one, surface.step, *places) for one in surface.common], (-1, *heights.shape))
    finite = np.isfinite(sigma)
    sigma = np.where(finite, sigma, np.median(sigma[finite]) if finite.any() else 0.0)
    x, y = np.nan_to_num(x - region.x), np.nan_to_num(y - region.y)
    maps = x, y, heights, sigma, cell, share, growth, slope
    return _Dent(*maps, modes, region.inside, holes[box], (known & ~holes)[box], peak)


def _steepness(z: Floats, x: Floats, y: Floats) -> Floats:
    """|dz/d(x, y)|, 0 where it is not known."""
    (z_row, z_col), (x_row, x_col), (y_row, y_col) = (np.gradient(part) for part in (z, x, y))
    with np.errstate(divide="ignore", invalid="ignore"):
        area = x_col * y_row - x_row * y_col
        by_x, by_y = (z_col * y_row - z_row * y_col) / area, (x_col * z_row - x_row * z_col) / area
    return np.asarray(np.nan_to_num(np.hypot(by_x, by_y), posinf=0.0))


def _depth(dent: _Dent) -> tuple[float, float, float, bool]:
    """Depth; its noise; its standard deviation by what lies between cells; whether deeper ones may not be
    measured."""
    (row, col), depth = dent.peak, float(dent.z[dent.peak])
    beside = np.s_[row : row + 3, col : col + 3]
    near, seen = np.pad(dent.z, 1)[beside], np.pad(dent.measured, 1)[beside]
    before, after = ([0, 1], [1, 0]), ([2, 1], [1, 2])
    low, high = depth - near[before], depth - near[after]
    # the parabola through three cells; a cone ends higher by so much, rms
    between = seen[before] & seen[after] & (np.minimum(low, high) > 0)
    low, high = low[between], high[between]
    rise, tip = np.sum((high - low) ** 2 / (8 * (low + high))), np.max(0.25 * (low + high), initial=0.0)
    hidden = not seen.all() or (dent.inside & ~dent.measured & (dent.z > _INNER * depth)).any()
    return depth + float(rise), float(dent.sigma[dent.peak]), float(tip), bool(hidden)


def _doubtful(dent: _Dent) -> float:
    """Standard deviation of the area, mm^2, by holes that the outline crosses: anywhere in them."""
    labels, count = scipy.ndimage.label(dent.holes, np.ones((3, 3)))
    if not count:
        return 0.0
    every = np.arange(1, count + 1)
    least, most = (part(dent.share, labels, every) for part in (scipy.ndimage.minimum, scipy.ndimage.maximum))
    size = scipy.ndimage.sum_labels(dent.cell, labels, every)
    return float(np.sum(size[(least < 1) & (most > 0)])) / math.sqrt(12)


def _noises(
    dent: _Dent, noise: float, tip: float, area: float, depth: float, weight: Floats, cut: bool
) -> tuple[float, float, float]:
    """Sigmas of area, volume and centroid by noise, by the tip between cells and by holes."""
    rim, reach, doubt = dent.growth > 0, math.sqrt(area / math.pi), _doubtful(dent)
    # the outline crosses each rim cell somewhere: the rounding of its share, independent of the others'
    rounding = float(np.linalg.norm(dent.cell[rim])) * _ROUNDING
    at_rim = float(np.median(dent.sigma[rim])) if rim.any() else noise
    # noise of heights is smooth: what the outline and the deepest cell share is in half the depth
    error = math.sqrt(0.25 * noise**2 + max(at_rim**2 - noise**2, 0.0))
    flank = float(np.median(dent.slope[rim])) if rim.any() else 0.0
    drift = min(_DIPOLE * error / flank, reach) if flank > 0 else reach
    inward = _HALF * (tip + depth - float(dent.z[dent.peak]))  # half of a higher tip lies farther inside
    by_area = norm(rounding, doubt, *np.array([error, inward]) * float(dent.growth.sum()))
    by_volume = norm(float((weight * dent.sigma).sum()), _HALF * depth * by_area)
    return (
        by_area,
        by_volume,
        norm(drift, rounding / area * reach / math.sqrt(2), reach * (doubt / area + cut)),
    )


def _indenter(dent: _Dent, depth: float) -> tuple[float | None, float | None]:
    """Radius of the surface inside, from z = a + b x + c y - k (x^2 + y^2) / 2, R = 1 / k, and its sigma: by
    noise, by modes and by what cells nearer to the middle say."""
    inside = dent.inside & dent.measured
    wide, narrow = (_curvature(dent, inside & (dent.z > share * depth)) for share in (_HALF, _INNER))
    if wide is None or narrow is None:
        return None, None
    k, weights, used = wide
    modes = [float(mode[used] @ weights) for mode in dent.modes]
    size = float(np.hypot(dent.x[used], dent.y[used]).max())
    noise = 4 * float(np.median(dent.sigma[used])) / size**2
    sigma = norm(noise, *modes, k - narrow[0])
    return (1 / k, sigma / k**2) if k > _CURVED * sigma else (math.inf, None)


def _curvature(dent: _Dent, used: Mask) -> tuple[float, Floats, Mask] | None:
    """k and the weights of heights in it."""
    if np.count_nonzero(used) < _FEWEST:
        return None
    x, y = dent.x[used], dent.y[used]
    size = float(np.hypot(x, y).max())
    basis = np.stack([np.ones(x.size), x / size, y / size, -np.square(np.hypot(x, y) / size) / 2])
    weights = (np.linalg.pinv(basis @ basis.T) @ basis)[3] / size**2
    return float(weights @ dent.z[used]), weights, used


def _pressed(
    surface: Surface, z: Map, regions: Sequence[Region], found: Sequence[Contact], layer: Layer
) -> tuple[Contact, ...]:
    """The contacts of the regions with their forces."""
    means, box = partial(_means, surface.index()), regions[0].box
    own = math.sqrt(float(np.median(areas(surface.x[box], surface.y[box]))))
    every = np.stack([surface.x, surface.y], axis=-1)
    places = (every[one.box][one.inside] for one in regions)
    cells = [at[np.isfinite(at).all(axis=1)] for at in places]
    radii = [one.radius for one in found]
    behind = forces_on(layer, cells, radii, lambda at, pitch: means(z[None], at, round(pitch / own))[0])
    at, pitch, area = behind.places, behind.pitch, behind.pitch**2
    by_modes = np.linalg.norm(means(surface.common, at, 1, surface.step) @ behind.weights.T, axis=0)
    noise = np.where(np.isfinite(surface.sigma), surface.sigma, 0)
    by_noise = np.abs(behind.weights @ means(noise[None], at, round(pitch / own))[0])
    result = []
    for k, one in enumerate(found):
        under = behind.pressure[behind.owner == k]
        newton, most = float(under.sum() * area), float(under.max(initial=0.0))
        sigma = norm(area * by_modes[k], area * by_noise[k], newton * layer.relative_sigma)
        result.append(replace(one, force=newton, force_sigma=sigma, pressure=most))
    return tuple(result)


def _means(index: Callable[[Floats], Floats], maps: Map, places: Floats, side: int, step: int = 1) -> Floats:
    """Of maps (m, r, c) on every step-th cell, in squares of so many cells around places (n, 2): (m, n),
    linear between cells."""
    at = index(places) / step
    low = np.clip(np.floor(at.min(axis=1)).astype(np.int64) - side, 0, np.array(maps.shape[1:]) - 1)
    last = np.ceil(at.max(axis=1)).astype(np.int64) + side + 2
    near = np.asarray(maps[:, low[0] : last[0], low[1] : last[1]], np.float64)
    if side > 1:
        near = scipy.ndimage.uniform_filter(near, (0, side, side))
    at -= low[:, None]
    means = [scipy.ndimage.map_coordinates(one, at, order=1, mode="nearest") for one in near]
    return np.reshape(means, (-1, len(places)))
