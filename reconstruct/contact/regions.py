"""Contacts: depth, area, volume and position of every dent of a height map, with error bars.

On an elastic surface the dent is wider than the contact: under Hertz's ball the edge stands at half the
depth, and a tenth of it is reached at four times the radius. So the edge is looked for in the slopes, see
`edge`; where they show none, the numbers are those of the area deeper than half the depth, and the
evidence says so.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from optolever.contact import basins

from ..arrays import Floats, Mask
from ..heightmap import HeightMap
from ..outputs.slope_map import SlopeMap
from .dent import Deepest, Dent, deepest
from .edge import ANGLES, Outline, outline
from .record import Contact
from .relief import Relief

__all__ = ["contacts"]

_SIGNIFICANT = 3.0  # standard deviations: a dent exceeds its saddle and the surface at rest by more
_FEWEST = 24  # pixels of a dent
_SHALLOWEST, _MOST = 0.02, 16
_ROUNDING = 1 / np.sqrt(180)  # of a pixel: the share of an area that an outline cuts off at random
_UNDER = 0.85  # of the edge: where the surface follows the indenter


def contacts(height: HeightMap, slopes: SlopeMap) -> tuple[Contact, ...]:
    """Dents of a height map, the 16 deepest, deepest first: at least 0.02 times as deep as the deepest.

    A dent exceeds the saddle to a deeper one by three standard deviations of the height on either side, and
    the surface at rest by three of noise and rig; errors of the rig that the map shows do not count.
    slopes: of the same height map.
    Only pixels without a flag, or with STEEP alone, are used; holes of other pixels are interpolated.
    """
    relief = Relief.of(height, slopes)
    if relief is None:
        return ()
    labels, peaks = basins(relief.z, relief.sigma, relief.known, _SIGNIFICANT)
    row, col = np.unravel_index(peaks, relief.z.shape)
    modes = relief.modes[:, row, col]
    depths = relief.z.ravel()[peaks]
    sigma = np.hypot(relief.sigma.ravel()[peaks], np.linalg.norm(modes, axis=0))
    depths = np.where(depths > _SIGNIFICANT * sigma, depths, 0.0)
    deep = np.flatnonzero((depths > 0) & (depths >= _SHALLOWEST * depths.max()))
    dents = [Dent.of(relief, labels == number, int(peaks[number])) for number in deep]
    found = [_contact(dent) for dent in dents if np.count_nonzero(dent.inside) >= _FEWEST]
    return tuple(sorted(found, key=lambda contact: -contact.depth)[:_MOST])


class _Region(NamedTuple):
    """What area, volume and centroid belong to: weight (N,), mm^2 of every pixel in it; crossing (N,): growth
    of the area (mm^2) by a height in mm that is added there, 0 where slopes place its edge; level: height at
    the edge, mm; noise of area and centroid, by their own; about: the centroid; hidden: see `_hidden`."""

    weight: Floats
    crossing: Floats
    level: float
    area_noise: float
    centroid_noise: float
    about: tuple[float, float]
    hidden: float


def _contact(dent: Dent) -> Contact:
    top = deepest(dent)
    dent, edge = outline(dent)
    if isinstance(edge, str):
        return _measured(dent, top, _half_depth(dent, top), f"no contact evidence: {edge}")
    region = _within_edge(dent, edge, top)
    indenter, indenter_sigma = _indenter(dent, (dent.r < _UNDER * edge.at(dent.phi)) & dent.measured)
    if indenter == float("inf"):  # half of what a punch's law falls by within half a pixel of its rim
        radius = float(np.mean(edge.radius))
        doubt = float(np.arccos(radius / (radius + 0.5 * dent.pitch)) / np.pi) * top.depth
        top = top._replace(
            depth_sigma=float(np.hypot(top.depth_sigma, doubt)),
            depth_noise=float(np.hypot(top.depth_noise, doubt)),
        )
    share = region.level / top.depth
    follows = "of unknown radius" if indenter is None else f"of radius {indenter:.3g} mm"
    evidence = (
        f"contact: the slope has the kink of a contact's edge "
        f"(chi^2 below a smooth surface's by {edge.gain:.2g}); the edge stands at {share:.2f} of the depth, "
        f"inside it the surface is {'flat' if indenter == float('inf') else follows}"
    )
    around = np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)
    return replace(
        _measured(dent, top, region, evidence),
        found=True,
        edge=dent.middle + edge.radius[:, None] * around,
        edge_share=share,
        indenter_radius=indenter,
        indenter_radius_sigma=indenter_sigma,
    )


def _within_edge(dent: Dent, edge: Outline, top: Deepest) -> _Region:
    """The area inside the edge."""
    at, (x, y) = edge.at(dent.phi), edge.centroid
    member = np.clip(0.5 + (at - dent.r) / dent.pitch, 0.0, 1.0)
    area, hidden = edge.area, _hidden(dent, member)
    step, radius = 2 * np.pi / ANGLES.size, edge.radius
    turned = [
        step / area * (radius**2 * way - by * radius) @ edge.root
        for way, by in ((np.cos(ANGLES), x), (np.sin(ANGLES), y))
    ]
    if hidden > 0:
        member = np.where(dent.r <= at, 1.0, member)
        area = float(dent.cell[dent.r <= at].sum())
    rim = np.abs(dent.r - at) < 0.75 * dent.pitch
    weight = member * dent.cell
    return _Region(
        weight=area / max(float(weight.sum()), 1e-300) * weight,
        crossing=np.zeros(dent.z.size),
        level=float(np.mean(dent.z[rim])) if rim.any() else 0.5 * top.depth,
        area_noise=step * float(np.linalg.norm(radius @ edge.root)),
        centroid_noise=float(np.linalg.norm(turned)) / np.sqrt(2),
        about=(dent.middle[0] + x, dent.middle[1] + y),
        hidden=hidden,
    )


def _half_depth(dent: Dent, top: Deepest) -> _Region:
    """The area deeper than half the depth."""
    level, slope = 0.5 * top.depth, np.hypot(*dent.slopes)
    rise = np.maximum(slope, 1e-12) * dent.pitch
    member = np.where(dent.inside, np.clip(0.5 + (dent.z - level) / rise, 0.0, 1.0), 0.0)
    weight = member * dent.cell
    area = max(float(weight.sum()), 1e-300)
    crossing = np.where((member > 0) & (member < 1), dent.cell / rise, 0.0)
    rim = dent.inside & (np.abs(dent.z - level) < rise)
    peak = float(dent.sigma[dent.peak])
    at_outline = float(np.median(dent.sigma[rim])) if rim.any() else peak
    # noise of heights is smooth: what the outline and the deepest pixel share is in half the depth
    error = float(np.sqrt(0.25 * top.depth_noise**2 + max(at_outline**2 - peak**2, 0.0)))
    guessed = float(np.sum((dent.error / rise * dent.cell)[rim]))
    # the outline crosses each rim pixel somewhere: the rounding of its share, independent of the others'
    rounding = float(np.linalg.norm(dent.cell[rim])) * _ROUNDING
    reach, at_rim = float(np.sqrt(area / np.pi)), float(np.median(slope[rim])) if rim.any() else 0.0
    drift = min(error / at_rim, reach) if at_rim > 0 else reach
    return _Region(
        weight=weight,
        crossing=crossing,
        level=level,
        area_noise=float(np.linalg.norm([error * crossing.sum(), guessed, rounding])),
        centroid_noise=float(np.hypot(drift, guessed / area * reach)),
        about=(float(weight @ dent.x / area), float(weight @ dent.y / area)),
        hidden=_hidden(dent, member),
    )


def _measured(dent: Dent, top: Deepest, region: _Region, evidence: str) -> Contact:
    """The figures of a dent by its region. Errors of the rig move heights, the level by half as much as the
    depth, and positions; a region that the image cuts lacks what is hidden of it."""
    weight, (x, y), hidden = region.weight, region.about, region.hidden
    area, volume = max(float(weight.sum()), 1e-300), float(weight @ dent.z)
    modes = np.zeros((len(dent.displacement), dent.z.size))
    modes[: len(dent.modes)] = dent.modes
    grown = (modes - 0.5 * modes[:, dent.peak : dent.peak + 1]) * region.crossing
    stretch = dent.displacement[:, 0, 1] + dent.displacement[:, 1, 2]
    areas = stretch * area + grown.sum(axis=1)
    volumes = stretch * volume + modes @ weight + region.level * grown.sum(axis=1)
    centres = dent.moved(x, y) + grown @ np.stack([dent.x - x, dent.y - y], axis=1) / area
    common = float(weight @ (dent.sigma + dent.error))
    interpolated = float(weight[~dent.measured].sum() / area)
    depth_sigma, reach = top.depth_sigma, float(np.sqrt((area + hidden) / np.pi))
    if interpolated > 0.01:
        evidence += f"; {100 * interpolated:.0f} % of its area is interpolated across flagged pixels"
    if not dent.measured[dent.peak]:
        evidence += "; its deepest point lies in a hole: the depth is a lower bound"
    if region.crossing.any() and (dent.saddle & (weight > 0.5 * dent.cell)).any():
        evidence += "; at half the depth it merges with another dent: the area ends at the saddle"
    if hidden > 0:
        evidence += (
            "; the image's edge or flagged pixels cut it: area and volume are those of the visible part, "
        )
        evidence += "lower bounds"
    if hidden > 0 and dent.border[dent.peak]:
        evidence += ", and so is the depth"
        depth_sigma = float(np.hypot(depth_sigma, np.hypot(*dent.slopes[:, dent.peak]) * reach))
    lacking = hidden / (area + hidden) * reach
    return Contact(
        found=False,
        evidence=evidence,
        **(top._asdict() | {"depth_sigma": depth_sigma}),
        area=area,
        area_sigma=float(np.linalg.norm([hidden, region.area_noise, *areas])),
        volume=volume,
        volume_sigma=float(
            np.linalg.norm([hidden * volume / area, common, region.level * region.area_noise, *volumes])
        ),
        centroid=region.about,
        centroid_sigma=float(
            np.linalg.norm([lacking, region.centroid_noise, np.linalg.norm(centres) / np.sqrt(2)])
        ),
        edge=np.empty((0, 2)),
        cut=hidden > 0,
        interpolated=interpolated,
    )


def _hidden(dent: Dent, member: Floats) -> float:
    """Area (mm^2) that the visible part of an area lacks of the circle about the deepest point that holds it,
    where unknown pixels cut its outline; at least that of the pixels on the cut. 0 where it is closed."""
    weight = np.where(member > 0.5, member * dent.cell, 0.0)
    edge = float(weight[dent.border].sum())
    if edge == 0:
        return 0.0
    farthest = (dent.x - dent.x[dent.peak]) ** 2 + (dent.y - dent.y[dent.peak]) ** 2
    return max(edge, float(np.pi * farthest[weight > 0].max() - weight.sum()))


def _indenter(dent: Dent, inside: Mask) -> tuple[float | None, float | None]:
    """Radius of the surface under the indenter and its sigma: the radial slope is a - k r, R = 1/k; inf where
    it is flat, None where unknown."""
    if np.count_nonzero(inside) < 6:
        return None, None
    slope, sigma = (part[inside] for part in dent.radial)
    phi, w = dent.phi[inside], 1.0 / sigma
    terms: Floats = np.stack([np.cos(phi), np.sin(phi), dent.r[inside]], axis=1) * w[:, None]
    covariance = np.linalg.inv(terms.T @ terms)
    k = float(-(covariance @ (terms.T @ (slope * w)))[2])
    modes = covariance @ terms.T @ ((dent.slope_modes * dent.direction).sum(axis=1)[:, inside] * w).T
    k_sigma = float(np.linalg.norm([np.sqrt(covariance[2, 2]), *modes[2]]))
    if abs(k) < 2 * k_sigma:
        return float("inf"), None
    return 1.0 / k, k_sigma / k**2
