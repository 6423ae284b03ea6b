"""Contacts: depth, area, volume and position of every dent of a height map, with error bars.

On an elastic surface the dent is wider than the contact: under Hertz's ball the edge stands at half the
depth, and a tenth of it is reached at four times the radius. So the edge is looked for in the slopes, see
`edge`; where they show none, the numbers are those of the area deeper than half the depth, and the
evidence says so.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.ndimage

from ..arrays import Floats, Mask
from ..heightmap import HeightMap
from ..outputs.slope_map import SlopeMap
from .deepest import deepest
from .dent import Dent, sector_angles, sectors
from .edge import Profile, SectorEdge, fit_edge
from .peaks import basins
from .record import Contact
from .relief import Relief, levelled
from .rim import Rim, posterior

__all__ = ["contacts"]

_SIGNIFICANT = 3.0  # standard deviations: a dent exceeds its saddle and its surroundings by more
_FEWEST = 24  # pixels of a dent
_GUESSES = 24  # directions in which the steepest slope is looked for
_SECTOR = 3.0  # pixels along the edge
_POPULATED = 3.6  # size^2 per sector that leaves about 30 pixels to each
_SECTORS = (6, 90)
_OUTLINE = 4  # waves around: how smooth a contact's outline is
_TIP = 3.0  # pixels: steepest so near to the middle is a tip
_SHARE = 0.6  # of the sectors
_GAIN = (25.0, 6.0)  # of chi^2: five sigma, and what n sectors scatter by, per sqrt(n)
_ROUNDING = 1 / np.sqrt(180)  # of a pixel: the share of an area that an outline cuts off at random
_WORTH_SAYING = 0.01  # of the area
_STEP = 0.05  # of a standard deviation, by which measures are differenced
_UNDER = 0.85  # of the edge: where the surface follows the indenter


def contacts(
    height: HeightMap, slopes: SlopeMap, shallowest: float = 0.02, most: int = 16
) -> tuple[Contact, ...]:
    """Dents of a height map, deepest first: at least `shallowest` times as deep as the deepest, at most
    `most`.

    A dent exceeds the saddle to a deeper one by three standard deviations of the height on either side, and
    its surroundings by three of noise and rig; errors of the rig that both share do not count.
    slopes: of the same height map.
    Only pixels without a flag, or with STEEP alone, are used; holes of other pixels are interpolated.
    """
    relief = Relief.of(height, slopes)
    if relief is None:
        return ()
    z = levelled(relief)
    labels, peaks = basins(z, relief.sigma, relief.known, _SIGNIFICANT)
    rims = {}
    for number, peak in enumerate(peaks):
        rim = Rim.of(relief, z, labels == number, int(peak))
        if rim is not None and _stands_out(relief, rim):
            rims[number] = rim
    deep = max((rim.depth for rim in rims.values()), default=0.0)
    rims = {number: rim for number, rim in rims.items() if rim.depth >= shallowest * deep}
    others = list(rims.values())
    dents = [
        Dent.of(height, slopes, relief, labels == number, rim, posterior(relief, rim, others))
        for number, rim in rims.items()
    ]
    found = [
        _contact(dent) for dent in dents if dent is not None and np.count_nonzero(dent.inside) >= _FEWEST
    ]
    return tuple(sorted(found, key=lambda contact: -contact.depth)[:most])


def _stands_out(relief: Relief, rim: Rim) -> bool:
    """Whether the peak exceeds its surroundings by _SIGNIFICANT standard deviations of noise and rig."""
    noise = np.hypot(relief.sigma.ravel()[rim.peak], np.linalg.norm(rim.means(relief.sigma) * rim.weights))
    sigma = float(np.hypot(noise, np.linalg.norm(rim.rise(relief.modes))))
    return float(rim.rise(relief.z)) > _SIGNIFICANT * sigma


def _contact(dent: Dent) -> Contact:
    guesses = _steepest(dent)
    if np.median(guesses) < _TIP * dent.pitch:
        return _half_depth(dent, "no contact evidence: the slope is steepest at the deepest point, a tip")
    (seen, edges), (seen_sharp, sharp) = (_looked_for(dent, guesses, rim) for rim in (False, True))
    limit = _GAIN[0] + _GAIN[1] * np.sqrt(len(edges))
    rimmed = _gain(sharp) > _gain(edges) + limit
    if rimmed:
        seen, edges = seen_sharp, sharp
    gain, share = _gain(edges), sum(edge is not None and edge.gain > 0 for edge in edges) / len(edges)
    if gain > limit and share >= _SHARE:
        return _within_edge(seen, edges, share, gain, rimmed)
    why = f"no contact evidence: the edge's kink shows in {100 * share:.0f} % of {len(edges)} directions"
    return _half_depth(dent, f"{why}, a smooth surface explains the slopes as well or better")


def _steepest(dent: Dent) -> Floats:
    """Radius of the steepest descent in every of _GUESSES directions, mm."""
    found = np.full(_GUESSES, np.nan)
    for k, (r, slope, sigma, inside) in enumerate(sectors(dent, _GUESSES)):
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
    """The edge around the guesses, then around the first result, in sectors about its centroid."""
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
    around = np.interp(sector_angles(count), sector_angles(guesses.size), guesses, period=2 * np.pi)
    return [
        fit_edge(Profile(r, slope, sigma, dent.pitch), guess, sharp)
        for (r, slope, sigma, _), guess in zip(sectors(dent, count), around, strict=True)
    ]


def _polar(edges: Sequence[SectorEdge | None]) -> tuple[Floats, Floats]:
    """Radius and sigma at every sector's middle; sigma at least the scatter of the radii about a smooth
    outline.
    """
    angles = sector_angles(len(edges))
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
    angles, third = sector_angles(radius.size), radius**3 / (1.5 * np.sum(radius**2))
    return float(np.sum(third * np.cos(angles))), float(np.sum(third * np.sin(angles)))


def _within_edge(
    dent: Dent, edges: list[SectorEdge | None], share: float, gain: float, rimmed: bool
) -> Contact:
    """Everything about the area inside the edge; rimmed: of an indenter with a rim."""
    count, at_angles = len(edges), sector_angles(len(edges))
    radius, sigma = _polar(edges)
    r, phi = dent.r, dent.phi
    step, cos, sin = 2 * np.pi / count, np.cos(at_angles), np.sin(at_angles)
    at = np.interp(phi, at_angles, radius, period=2 * np.pi)
    member = np.clip(0.5 + (at - r) / dent.pitch, 0.0, 1.0)
    shift = _centroid(radius)
    centre = (dent.middle[0] + shift[0], dent.middle[1] + shift[1])
    full = 0.5 * step * float(np.sum(radius**2))
    turned = [
        step / full * sigma * (radius**2 * part - by * radius)
        for part, by in zip((cos, sin), shift, strict=True)
    ]
    noise = [float(np.linalg.norm(part)) for part in turned]
    area_noise = step * float(np.linalg.norm(radius * sigma))
    hidden = _hidden(dent, member)
    area = full
    if hidden > 0:
        member = np.where(r <= at, 1.0, member)
        area = float((np.where(r <= at, 1.0, 0.0) * dent.cell).sum())
    moved = dent.moved(*centre)
    rim = np.abs(r - at) < 0.75 * dent.pitch
    top = deepest(dent)
    doubt = _unresolved(dent, float(np.mean(radius))) * top.depth if rimmed else 0.0
    edge_height = float(np.mean(dent.z[rim])) if rim.any() else 0.5 * top.depth
    indenter, indenter_sigma = _indenter(dent, (r < _UNDER * at) & dent.measured)
    weight = area * member * dent.cell / max(float((member * dent.cell).sum()), 1e-300)
    edge_share = edge_height / top.depth
    follows = "of unknown radius" if indenter is None else f"of radius {indenter:.3g} mm"
    evidence = (
        f"contact: the slope has the kink of a contact's edge in {100 * share:.0f} % of {count} directions "
        f"(chi^2 below a smooth surface's by {gain:.2g}); the edge stands at {edge_share:.2f} of the depth, "
        f"inside it the surface is {'flat' if indenter == float('inf') else follows}"
    )
    rig = np.abs(dent.stretch) * area
    return _with_limits(
        dent,
        member,
        Contact(
            found=True,
            evidence=evidence,
            x=top.x,
            y=top.y,
            depth=top.depth,
            depth_sigma=float(np.hypot(top.depth_sigma, doubt)),
            area=area,
            area_sigma=float(np.linalg.norm([area_noise, *rig])),
            volume=float(weight @ dent.z),
            volume_sigma=float(
                np.linalg.norm([weight @ dent.sigma, area_noise * edge_height, *_volume_moves(dent, weight)])
            ),
            centroid=centre,
            centroid_sigma=float(np.linalg.norm([*noise, *moved.ravel()]) / np.sqrt(2)),
            edge=np.stack([dent.middle[0] + radius * cos, dent.middle[1] + radius * sin], axis=1),
            edge_share=edge_share,
            indenter_radius=indenter,
            indenter_radius_sigma=indenter_sigma,
            directions=count,
            share=share,
            gain=gain,
            rim_depth=dent.rim_depth,
            rim_depth_sigma=dent.rim_depth_sigma,
            x_sigma=top.x_sigma,
            y_sigma=top.y_sigma,
            depth_noise=float(np.hypot(top.depth_noise, doubt)),
        ),
    )


def _volume_moves(dent: Dent, weight: Floats) -> Floats:
    """Change of the volume over a fixed outline by every error of the rig, (m,)."""
    moves = dent.stretch * float(weight @ dent.z)
    moves[: len(dent.modes)] += dent.modes @ weight
    return moves


def _half_depth(dent: Dent, evidence: str) -> Contact:
    """Everything about the area deeper than half the depth."""
    top = deepest(dent)
    slope = np.hypot(*dent.slopes)
    rise = np.maximum(slope, 1e-12) * dent.pitch

    def member(level: float, z: Floats = dent.z) -> Floats:
        share: Floats = np.where(dent.inside, np.clip(0.5 + (z - level) / rise, 0.0, 1.0), 0.0)
        return share

    def measures(z: Floats, x: Floats, y: Floats, cell: Floats, level: float) -> Floats:
        """Area, volume, centroid."""
        weight = member(level, z) * cell
        area = max(float(weight.sum()), 1e-300)
        return np.array([area, weight @ z, weight @ x / area, weight @ y / area])

    def moved(k: int) -> Floats:
        """Change of the measures by the error k of the rig, which moves heights, level and positions."""
        mode = dent.modes[k] if k < len(dent.modes) else np.zeros_like(dent.z)
        dx, dy = dent.displacement[k] @ np.stack([np.ones_like(dent.x), dent.x, dent.y])
        sides = [
            measures(
                dent.z + step * mode,
                dent.x + step * dx,
                dent.y + step * dy,
                dent.cell * (1.0 + step * dent.stretch[k]),
                0.5 * (top.depth + step * mode[dent.peak]),
            )
            for step in (_STEP, -_STEP)
        ]
        change: Floats = (sides[0] - sides[1]) / (2 * _STEP)
        return change

    half = member(0.5 * top.depth)
    area, volume, x, y = measures(dent.z, dent.x, dent.y, dent.cell, 0.5 * top.depth)
    rim = dent.inside & (np.abs(dent.z - 0.5 * top.depth) < rise)
    at_outline = float(np.median(dent.sigma[rim])) if rim.any() else float(dent.sigma[dent.peak])
    error = _level_error(at_outline, float(dent.sigma[dent.peak]), top.depth_noise)
    shifted = [float(np.sum(member(0.5 * top.depth + by) * dent.cell)) for by in (-error, error)]
    guessed = float(np.sum((dent.error / rise * dent.cell)[rim]))
    # the outline crosses each rim pixel somewhere: the rounding of its share, independent of the others'
    rounding = float(np.linalg.norm(dent.cell[rim])) * _ROUNDING
    area_noise = float(np.linalg.norm([0.5 * (shifted[0] - shifted[1]), guessed, rounding]))
    rig = np.linalg.norm(np.array([moved(k) for k in range(len(dent.displacement))]).reshape(-1, 4), axis=0)
    weight = half * dent.cell
    common = float(weight @ (dent.sigma + dent.error))
    at_rim = float(np.median(slope[rim])) if rim.any() else 0.0
    reach = float(np.sqrt(area / np.pi))
    drift = min(error / at_rim, reach) if at_rim > 0 else reach
    centroid_noise = float(np.hypot(drift, guessed / area * reach))
    return _with_limits(
        dent,
        half,
        Contact(
            found=False,
            evidence=evidence,
            x=top.x,
            y=top.y,
            depth=top.depth,
            depth_sigma=top.depth_sigma,
            area=float(area),
            area_sigma=float(np.hypot(area_noise, rig[0])),
            volume=float(volume),
            volume_sigma=float(np.linalg.norm([common, 0.5 * top.depth * area_noise, rig[1]])),
            centroid=(float(x), float(y)),
            centroid_sigma=float(np.hypot(centroid_noise, np.linalg.norm(rig[2:]) / np.sqrt(2))),
            edge=np.empty((0, 2)),
            rim_depth=dent.rim_depth,
            rim_depth_sigma=dent.rim_depth_sigma,
            x_sigma=top.x_sigma,
            y_sigma=top.y_sigma,
            depth_noise=top.depth_noise,
        ),
    )


def _unresolved(dent: Dent, radius: float) -> float:
    """Share of a flat punch's depth in doubt: half of the drop that the law, 2/pi asin(a/r), puts within half
    a pixel outside its rim, where the slope is infinite and pixels do not resolve it."""
    return float(np.arccos(radius / (radius + 0.5 * dent.pitch)) / np.pi)


def _level_error(outline: float, peak: float, depth: float) -> float:
    """Standard deviation of the height at the outline less half the depth, from those of the height there, of
    the height of the deepest pixel and of the depth: noise of heights is smooth, so that the smaller of the
    first two is shared, and half of it remains."""
    shared = min(outline, peak)
    apart = outline**2 - shared**2 + 0.25 * max(depth**2 - shared**2, 0.0)
    return float(np.sqrt(0.25 * shared**2 + apart))


def _hidden(dent: Dent, member: Floats) -> float:
    """Area (mm^2) that the visible part of an area lacks of the circle about the deepest point that holds it,
    where unknown pixels cut its outline; at least that of the pixels on the cut. 0 where it is closed."""
    weight = np.where(member > 0.5, member * dent.cell, 0.0)
    edge = float(weight[dent.border].sum())
    if edge == 0:
        return 0.0
    farthest = (dent.x - dent.x[dent.peak]) ** 2 + (dent.y - dent.y[dent.peak]) ** 2
    return max(edge, float(np.pi * farthest[weight > 0].max() - weight.sum()))


def _with_limits(dent: Dent, member: Floats, contact: Contact) -> Contact:
    """The contact with its cut, its neighbour and its interpolated share."""
    weight = member * dent.cell
    filled = float(weight[~dent.measured].sum() / max(weight.sum(), 1e-300))
    text, hidden = contact.evidence, _hidden(dent, member)
    if filled > _WORTH_SAYING:
        text += f"; {100 * filled:.0f} % of its area is interpolated across flagged pixels"
    if not contact.found and (dent.saddle & (member > 0.5)).any():
        text += "; at half the depth it merges with another dent: the area ends at the saddle"
    contact = replace(contact, evidence=text, interpolated=filled)
    return contact if hidden == 0 else _cut(dent, contact, hidden)


def _cut(dent: Dent, contact: Contact, hidden: float) -> Contact:
    """The contact with the uncertainty of an unknown area `hidden`, mm^2."""
    text = f"{contact.evidence}; the image's edge or flagged pixels cut it: area and volume are those of the "
    text += "visible part, lower bounds"
    sigma, reach = contact.depth_sigma, float(np.sqrt((contact.area + hidden) / np.pi))
    if dent.border[dent.peak]:
        text += ", and so is the depth"
        sigma = float(np.hypot(sigma, np.hypot(*dent.slopes[:, dent.peak]) * reach))
    lacking = hidden / (contact.area + hidden) * reach
    return replace(
        contact,
        evidence=text,
        cut=True,
        depth_sigma=sigma,
        area_sigma=float(np.hypot(contact.area_sigma, hidden)),
        volume_sigma=float(np.hypot(contact.volume_sigma, hidden * contact.volume / contact.area)),
        centroid_sigma=float(np.hypot(contact.centroid_sigma, lacking)),
    )


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
