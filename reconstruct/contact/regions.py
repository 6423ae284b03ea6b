"""Contacts: depth, area, volume and centroid of what presses on the mirror, with error bars.

On an elastic surface the dent is wider than the contact: under Hertz's ball the edge stands at half the
depth, and a tenth of it is reached at four times the radius. So the edge is looked for in the slopes, see
`edge`; where they show none, the numbers are those of the area deeper than half the depth, and the
evidence says so.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.ndimage

from ..arrays import Floats, Mask
from ..heightmap import HeightFlag, HeightMap
from ..resampling import natural_pitch
from ..slope_map import SlopeMap
from .dent import Dent, cells
from .edge import Profile, SectorEdge, fit_edge

__all__ = ["Contact", "contacts"]

_SIGNIFICANT = 5.0  # sigmas of height that make a dent
_FEWEST = 24  # pixels of a dent
_GUESSES = 24  # directions in which the steepest slope is looked for
_SECTOR = 3.0  # pixels along the edge
_POPULATED = 3.6  # size^2 per sector that leaves about 30 pixels to each
_SECTORS = (6, 90)
_OUTLINE = 4  # waves around: how smooth a contact's outline is
_TIP = 3.0  # pixels: steepest so near to the middle is a tip
_SHARE = 0.6  # of the sectors
_GAIN = (25.0, 6.0)  # of chi^2: five sigma, and what n sectors scatter by, per sqrt(n)
_STEP = 0.05  # of a mode, by which it is differenced
_UNDER = 0.85  # of the edge: where the surface follows the indenter


@dataclass(frozen=True, slots=True)
class Contact:
    """One dent. Lengths in mm, sigma: standard deviations; those of depth, volume, half depth's area and the
    indenter's radius hold the errors of a calibrated rig.

    found: whether the slopes show the edge of a contact; evidence: in words; x, y, depth: of the deepest
    point. area, volume, centroid (x, y): of the contact if one is found, else of what is deeper than half the
    depth; volume_sigma is an upper bound: the height's error is taken as common to the whole area.
    With an edge: edge (N, 2): points around the contact; edge_share: height there over the depth (Hertz: 0.5,
    flat punch: 1); indenter_radius: of the surface inside, inf where it is flat; directions: in how many the
    edge was looked for; share: of them, that show it; gain: chi^2 of a smooth surface above that of the law.
    """

    found: bool
    evidence: str
    x: float
    y: float
    depth: float
    depth_sigma: float
    area: float
    area_sigma: float
    volume: float
    volume_sigma: float
    centroid: tuple[float, float]
    centroid_sigma: float
    edge: Floats
    edge_share: float = float("nan")
    indenter_radius: float = float("nan")
    indenter_radius_sigma: float = float("nan")
    directions: int = 0
    share: float = 0.0
    gain: float = 0.0

    @property
    def region(self) -> str:
        """What area, volume and centroid belong to."""
        return "contact" if self.found else "half depth"

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        names = [name for name in self.__slots__ if name != "edge"]
        return {name: getattr(self, name) for name in names} | {
            "region": self.region,
            "edge": self.edge.tolist(),
        }


def contacts(
    height: HeightMap, slopes: SlopeMap, shallowest: float = 0.4, most: int = 16
) -> tuple[Contact, ...]:
    """Dents (z > 0) at least `shallowest` times as deep as the deepest, deepest first, at most `most`.

    slopes: of the same height map. Only pixels without a flag, or with STEEP alone, are used.
    """
    usable = (height.flags & ~np.uint16(HeightFlag.STEEP)) == 0
    usable &= np.isfinite(height.z) & np.isfinite(slopes.sigma_x + slopes.sigma_y) & np.isfinite(height.sigma)
    usable &= (slopes.sigma_x > 0) & (slopes.sigma_y > 0)
    if not usable.any():
        return ()
    dented = usable & (height.z > _SIGNIFICANT * height.sigma)
    if not dented.any():
        return ()
    deepest = float(height.z[dented].max())
    labels, count = scipy.ndimage.label(dented & (height.z > shallowest * deepest))
    area = cells(height)
    pitch = natural_pitch(height.x, height.y, usable)
    large = 1 + np.flatnonzero(np.bincount(labels.ravel(), minlength=count + 1)[1:] >= _FEWEST)
    peaks = scipy.ndimage.maximum(height.z, labels, large) if large.size else np.empty(0)
    chosen = large[np.argsort(-np.asarray(peaks), kind="stable")][:most]
    found = [_contact(Dent.of(height, slopes, usable, labels == label, area, pitch)) for label in chosen]
    return tuple(sorted(found, key=lambda contact: -contact.depth))


def _contact(dent: Dent) -> Contact:
    guesses = _steepest(dent)
    if np.median(guesses) < _TIP * dent.pitch:
        return _half_depth(dent, "no contact evidence: the slope is steepest at the deepest point, a tip")
    (seen, edges), (seen_sharp, sharp) = (_looked_for(dent, guesses, rim) for rim in (False, True))
    limit = _GAIN[0] + _GAIN[1] * np.sqrt(len(edges))
    if _gain(sharp) > _gain(edges) + limit:
        seen, edges = seen_sharp, sharp
    gain, share = _gain(edges), sum(edge is not None and edge.gain > 0 for edge in edges) / len(edges)
    if gain > limit and share >= _SHARE:
        return _within_edge(seen, edges, share, gain)
    why = f"no contact evidence: the edge's kink shows in {100 * share:.0f} % of {len(edges)} directions"
    return _half_depth(dent, f"{why}, a smooth surface explains the slopes as well or better")


def _steepest(dent: Dent) -> Floats:
    """Radius of the steepest descent in every of _GUESSES directions, mm."""
    found = np.full(_GUESSES, np.nan)
    for k, (r, slope, sigma, inside) in enumerate(_sectors(dent, _GUESSES)):
        if not inside.any():
            continue
        near = r < 1.2 * r[inside].max()
        ring = (r[near] / (1.5 * dent.pitch)).astype(np.intp)
        count = np.bincount(ring)
        mean = np.bincount(ring, slope[near]) / np.maximum(count, 1)
        noise = np.sqrt(np.bincount(ring, sigma[near] ** 2)) / np.maximum(count, 1)
        found[k] = (np.argmin(np.where(count > 0, mean + 2.0 * noise, np.inf)) + 0.5) * 1.5 * dent.pitch
    found = np.where(np.isfinite(found), found, np.nanmedian(found))
    smooth: Floats = scipy.ndimage.median_filter(found, size=5, mode="wrap")
    return smooth


def _gain(edges: Sequence[SectorEdge | None]) -> float:
    return sum(edge.gain for edge in edges if edge is not None)


def _looked_for(dent: Dent, guesses: Floats, sharp: bool) -> tuple[Dent, list[SectorEdge | None]]:
    """The edge around the guesses, then around what was found there and seen from its own middle."""
    edges = _edges(dent, guesses, sharp)
    if sum(edge is not None for edge in edges) < 0.5 * len(edges):
        return dent, edges
    radius, _ = _polar(edges)
    shift = _centroid(radius)
    centred = replace(dent, middle=(dent.middle[0] + shift[0], dent.middle[1] + shift[1]))
    return centred, _edges(centred, scipy.ndimage.median_filter(radius, size=5, mode="wrap"), sharp)


def _edges(dent: Dent, guesses: Floats, sharp: bool) -> list[SectorEdge | None]:
    """The edge in every sector, around guesses at evenly spaced directions."""
    size = np.median(guesses) / dent.pitch
    count = int(np.clip(min(2 * np.pi * size / _SECTOR, size**2 / _POPULATED), *_SECTORS))
    around = np.interp(_angles(count), _angles(guesses.size), guesses, period=2 * np.pi)
    return [
        fit_edge(Profile(r, slope, sigma, dent.pitch), guess, sharp)
        for (r, slope, sigma, _), guess in zip(_sectors(dent, count), around, strict=True)
    ]


def _polar(edges: Sequence[SectorEdge | None]) -> tuple[Floats, Floats]:
    """Radius and sigma at every sector's middle; sigma at least what the radii scatter by about a smooth
    outline.
    """
    angles = _angles(len(edges))
    known = np.array([edge is not None for edge in edges])
    values = ([getattr(edge, name) for edge in edges if edge is not None] for name in ("radius", "sigma"))
    radius, sigma = (np.interp(angles, angles[known], value, period=2 * np.pi) for value in values)
    waves = np.arange(1, min(_OUTLINE, (len(edges) - 4) // 2) + 1)
    terms = [np.ones((1, angles.size)), np.cos(np.outer(waves, angles)), np.sin(np.outer(waves, angles))]
    outline = np.concatenate(terms).T
    left = radius - outline @ np.linalg.lstsq(outline, radius, rcond=None)[0]
    scatter = float(np.linalg.norm(left)) / np.sqrt(angles.size - outline.shape[1])
    return radius, np.maximum(sigma, scatter)


def _centroid(radius: Floats) -> tuple[float, float]:
    """Of the area inside a polar outline, from its origin."""
    angles, third = _angles(radius.size), radius**3 / (1.5 * np.sum(radius**2))
    return float(np.sum(third * np.cos(angles))), float(np.sum(third * np.sin(angles)))


def _within_edge(dent: Dent, edges: list[SectorEdge | None], share: float, gain: float) -> Contact:
    """Everything about the area inside the edge."""
    count, angles = len(edges), _angles(len(edges))
    radius, sigma = _polar(edges)
    r, phi = dent.r, dent.phi
    step, cos, sin = 2 * np.pi / count, np.cos(angles), np.sin(angles)
    area = 0.5 * step * float(np.sum(radius**2))
    shift = _centroid(radius)
    moves = [
        step / area * float(np.linalg.norm(sigma * (radius**2 * part - by * radius)))
        for part, by in zip((cos, sin), shift, strict=True)
    ]
    area_sigma = step * float(np.linalg.norm(radius * sigma))
    at = np.interp(phi, angles, radius, period=2 * np.pi)
    member = np.clip(0.5 + (at - r) / dent.pitch, 0.0, 1.0)
    rim = np.abs(r - at) < 0.75 * dent.pitch
    depth, depth_sigma = _depth(dent)
    edge_height = float(np.mean(dent.z[rim])) if rim.any() else float("nan")
    indenter, indenter_sigma = _indenter(dent, r < _UNDER * at)
    volume, common = _volume(dent, member, area)
    edge_share = edge_height / depth
    follows = "flat" if np.isinf(indenter) else f"of radius {indenter:.3g} mm"
    evidence = (
        f"contact: the slope has the kink of a contact's edge in {100 * share:.0f} % of {count} directions "
        f"(chi^2 below a smooth surface's by {gain:.2g}); the edge stands at {edge_share:.2f} of the depth, "
        f"inside it the surface is {follows}"
    )
    x, y = (dent.middle[k] + shift[k] for k in (0, 1))
    return Contact(
        found=True,
        evidence=evidence,
        x=float(dent.x[dent.peak]),
        y=float(dent.y[dent.peak]),
        depth=depth,
        depth_sigma=depth_sigma,
        area=area,
        area_sigma=area_sigma,
        volume=volume,
        volume_sigma=float(np.hypot(common, area_sigma * np.nan_to_num(edge_height))),
        centroid=(x, y),
        centroid_sigma=float(max(moves)),
        edge=np.stack([dent.middle[0] + radius * cos, dent.middle[1] + radius * sin], axis=1),
        edge_share=edge_share,
        indenter_radius=indenter,
        indenter_radius_sigma=indenter_sigma,
        directions=count,
        share=share,
        gain=gain,
    )


def _half_depth(dent: Dent, evidence: str) -> Contact:
    """Everything about the area deeper than half the depth."""
    depth, depth_sigma = _depth(dent)
    slope = np.hypot(*dent.slopes)
    rise = np.maximum(slope, 1e-12) * dent.pitch

    def member(level: float, z: Floats = dent.z) -> Floats:
        share: Floats = np.where(dent.inside, np.clip(0.5 + (z - level) / rise, 0.0, 1.0), 0.0)
        return share

    def moved(mode: Floats) -> Floats:
        """What a mode does to area and volume: the rim and the level move with it."""
        sides = []
        for step in (_STEP, -_STEP):
            z = dent.z + step * mode
            cells_in = member(0.5 * (depth + step * mode[dent.peak]), z) * dent.cell
            sides.append([cells_in.sum(), cells_in @ z])
        change: Floats = (np.array(sides[0]) - np.array(sides[1])) / (2 * _STEP)
        return change

    half = member(0.5 * depth)
    area = float(np.sum(half * dent.cell))
    rim = dent.inside & (np.abs(dent.z - 0.5 * depth) < rise)
    noise = float(dent.sigma[dent.peak])
    error = float(np.hypot(np.median(dent.sigma[rim]) if rim.any() else noise, 0.5 * noise))
    shifted = [float(np.sum(member(0.5 * depth + by) * dent.cell)) for by in (-error, error)]
    area_noise = 0.5 * abs(shifted[0] - shifted[1])
    rig = np.linalg.norm(np.array([moved(mode) for mode in dent.modes]).reshape(-1, 2), axis=0)
    volume, common = _volume(replace(dent, modes=dent.modes[:0]), half, area)
    weight = half * dent.cell / max(area, 1e-300)
    centroid = float(np.sum(weight * dent.x)), float(np.sum(weight * dent.y))
    at_rim = float(np.median(slope[rim])) if rim.any() else 0.0
    return Contact(
        found=False,
        evidence=evidence,
        x=float(dent.x[dent.peak]),
        y=float(dent.y[dent.peak]),
        depth=depth,
        depth_sigma=depth_sigma,
        area=area,
        area_sigma=float(np.hypot(area_noise, rig[0])),
        volume=volume,
        volume_sigma=float(np.linalg.norm([common, 0.5 * depth * area_noise, rig[1]])),
        centroid=centroid,
        centroid_sigma=error / at_rim if at_rim > 0 else float("nan"),
        edge=np.empty((0, 2)),
    )


def _depth(dent: Dent) -> tuple[float, float]:
    """Height of the deepest point and its sigma: the top of a paraboloid through the pixels around it where
    one fits, else of the deepest pixel.
    """
    z = float(dent.z[dent.peak])
    sigma = float(np.linalg.norm([dent.sigma[dent.peak], *dent.modes[:, dent.peak]]))
    dx, dy = dent.x - dent.x[dent.peak], dent.y - dent.y[dent.peak]
    near = np.hypot(dx, dy) < 3.2 * dent.pitch
    if np.count_nonzero(near) < 12:
        return z, sigma
    dx, dy = dx[near], dy[near]
    terms = np.stack([np.ones_like(dx), dx, dy, dx * dx, dx * dy, dy * dy], axis=1)
    c = np.linalg.lstsq(terms, dent.z[near], rcond=None)[0]
    bent = np.array([[2 * c[3], c[4]], [c[4], 2 * c[5]]])
    if abs(c[0] - z) > max(sigma, 1e-3 * z) or not np.all(np.linalg.eigvalsh(bent) < 0):
        return z, sigma
    top = -np.linalg.solve(bent, c[1:3])
    if np.hypot(*top) > 3.2 * dent.pitch:
        return float(c[0]), sigma
    return float(c[0] + 0.5 * c[1:3] @ top), sigma


def _volume(dent: Dent, member: Floats, area: float) -> tuple[float, float]:
    """Volume over an area, and what errors of the height add: noise as if it were common to all of it, and
    the rig's modes."""
    weight = area * member * dent.cell / max(float((member * dent.cell).sum()), 1e-300)
    sigma = float(np.linalg.norm([weight @ dent.sigma, *(dent.modes @ weight)]))
    return float(weight @ dent.z), sigma


def _indenter(dent: Dent, inside: Mask) -> tuple[float, float]:
    """Radius of the surface under the indenter and its sigma: the radial slope is a - k r, R = 1/k."""
    if np.count_nonzero(inside) < 6:
        return float("nan"), float("nan")
    slope, sigma = (part[inside] for part in dent.radial)
    phi, w = dent.phi[inside], 1.0 / sigma
    terms: Floats = np.stack([np.cos(phi), np.sin(phi), dent.r[inside]], axis=1) * w[:, None]
    covariance = np.linalg.inv(terms.T @ terms)
    k = float(-(covariance @ (terms.T @ (slope * w)))[2])
    modes = covariance @ terms.T @ ((dent.slope_modes * dent.direction).sum(axis=1)[:, inside] * w).T
    k_sigma = float(np.linalg.norm([np.sqrt(covariance[2, 2]), *modes[2]]))
    if abs(k) < 2 * k_sigma:
        return float("inf"), float("nan")
    return 1.0 / k, k_sigma / k**2


def _angles(count: int) -> Floats:
    """Middles of sectors of equal angle from -pi on."""
    middles: Floats = np.linspace(-np.pi, np.pi, count, endpoint=False, dtype=np.float64) + np.pi / count
    return middles


def _sectors(dent: Dent, count: int) -> Iterator[tuple[Floats, Floats, Floats, Mask]]:
    """Radius, radial slope, its sigma and whether inside, of every sector's pixels, sorted by radius."""
    sector = ((dent.phi + np.pi) / (2 * np.pi) * count).astype(np.intp) % count
    order = np.lexsort((dent.r, sector))
    ends = np.searchsorted(sector[order], np.arange(1, count))
    slope, sigma = dent.radial
    fields = (np.split(part[order], ends) for part in (dent.r, slope, sigma, dent.inside))
    return zip(*fields, strict=True)
