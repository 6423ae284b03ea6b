"""The edge of a contact, found in the slopes around a dent by what elastic contact does to them.

Under a smooth rigid indenter the surface follows the indenter; just outside it an elastic half-space is free,
and its slope along r, q = r / r_e, is a sum of free solutions (K. L. Johnson, Contact Mechanics, 1985, ch. 3)

    q asin(1/q),   sqrt(1 - 1/q^2)   (pressure that vanishes at the edge: Hertz),
    1/(q sqrt(q^2 - 1))              (infinite pressure there: an indenter with a sharp rim, a punch)

so that the curvature across the edge jumps to infinity: the slope there is steepest and has a kink that no
smooth surface has. In every sector around the dent that law, with its edge r_e free, and a polynomial of as
many parameters are fitted to the radial slope; the sum of the differences of their chi^2 is twice the
logarithm of a likelihood ratio: where it is large, there is a contact edge, at r_e.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy.ndimage

from ..arrays import Floats, Mask
from .dent import Dent

__all__ = ["Outline", "outline"]

_GUESSES = 24  # directions in which the steepest slope is looked for
_TIP = 3.0  # pixels: steepest so near to the middle is a tip
_SECTOR = 3.0  # pixels along the edge
_POPULATED = 3.6  # size^2 per sector that leaves about 30 pixels to each
_SECTORS = (6, 90)
_WAVES = 4  # around: how smooth a contact's outline is
_SHARE = 0.6  # of the sectors
_GAIN = (25.0, 6.0)  # of chi^2: five sigma, and what n sectors scatter by, per sqrt(n)
_REACH = (0.45, 1.7)  # of the first guess: where the slopes are compared
_SCAN = (0.6, 1.4)  # likewise: where the edge is looked for
_COARSE, _FINE = 61, 41  # places tried
_TERMS = (4, 5)  # of the law, in addition to the edge: of Hertz, of a punch
_RINGS = 160
_NEAREST = 1e-3  # of q^2 - 1 where the slope of a punch is infinite
_RIDGE = 1e-10  # of the normal matrix' diagonal


@dataclass(frozen=True, slots=True)
class Outline:
    """Edge of a contact in sectors about the dent's middle: radius and its sigma (n,), mm; share: of the
    sectors that show it; gain: chi^2 of a smooth surface above that of the law, in units of the noise or of
    what neither explains."""

    radius: Floats
    sigma: Floats
    share: float
    gain: float

    @property
    def angles(self) -> Floats:
        """Middles of the sectors, rad."""
        return _angles(self.radius.size)

    @property
    def centroid(self) -> tuple[float, float]:
        """Of the area inside, from the middle, mm."""
        third = self.radius**3 / (1.5 * np.sum(self.radius**2))
        return float(np.sum(third * np.cos(self.angles))), float(np.sum(third * np.sin(self.angles)))


def outline(dent: Dent) -> tuple[Dent, Outline | str]:
    """The dent about its contact's middle and the edge, or why there is none, in words."""
    guesses = _steepest(dent)
    if np.median(guesses) < _TIP * dent.pitch:
        return dent, "the slope is steepest at the deepest point, a tip"
    (dent, found), (other, sharp) = (_centred(dent, guesses, terms) for terms in _TERMS)
    if sharp is not None and (found is None or sharp.gain > found.gain + _limit(sharp)):
        dent, found = other, sharp
    if found is not None and found.gain > _limit(found) and found.share >= _SHARE:
        return dent, found
    shown = 0.0 if found is None else found.share
    why = f"the edge's kink shows in {100 * shown:.0f} % of the directions"
    return dent, f"{why}, a smooth surface explains the slopes as well or better"


def _centred(dent: Dent, guesses: Floats, terms: int) -> tuple[Dent, Outline | None]:
    """The edge around guesses, then around the first result, in sectors about its centroid."""
    found = _looked_for(dent, guesses, terms)
    if found is None:
        return dent, None
    x, y = found.centroid
    dent = replace(dent, middle=(dent.middle[0] + x, dent.middle[1] + y))
    return dent, _looked_for(dent, scipy.ndimage.median_filter(found.radius, size=5, mode="wrap"), terms)


def _limit(found: Outline) -> float:
    return _GAIN[0] + _GAIN[1] * float(np.sqrt(found.radius.size))


def _angles(count: int) -> Floats:
    """Middles of sectors of equal angle from -pi on."""
    middles: Floats = np.linspace(-np.pi, np.pi, count, endpoint=False, dtype=np.float64) + np.pi / count
    return middles


def _sectors(dent: Dent, count: int) -> Iterator[tuple[Floats, Floats, Floats, Mask]]:
    """Radius, radial slope, its sigma and whether inside, of every sector's measured pixels, sorted by
    radius."""
    sector = ((dent.phi + np.pi) / (2 * np.pi) * count).astype(np.intp) % count
    order = np.lexsort((dent.r, sector))
    order = order[dent.measured[order]]
    ends = np.searchsorted(sector[order], np.arange(1, count))
    fields = (np.split(part[order], ends) for part in (dent.r, *dent.radial, dent.inside))
    return zip(*fields, strict=True)


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


def _looked_for(dent: Dent, guesses: Floats, terms: int) -> Outline | None:
    """The edge around guesses at evenly spaced directions; None where half of the sectors have none. sigma is
    at least the scatter of the radii about a smooth outline."""
    size = np.median(guesses) / dent.pitch
    count = int(np.clip(min(2 * np.pi * size / _SECTOR, size**2 / _POPULATED), *_SECTORS))
    angles = _angles(count)
    around = np.interp(angles, _angles(guesses.size), guesses, period=2 * np.pi)
    fits = [
        _fit(*_gathered(r, slope, sigma, guess), guess, dent.pitch, terms)
        for (r, slope, sigma, _), guess in zip(_sectors(dent, count), around, strict=True)
    ]
    radius, sigma, gain = np.array(fits).T
    known = np.isfinite(radius)
    if np.count_nonzero(known) < 0.5 * count:
        return None
    radius, sigma = (
        np.interp(angles, angles[known], part[known], period=2 * np.pi) for part in (radius, sigma)
    )
    waves = np.arange(1, min(_WAVES, (count - 4) // 2) + 1)
    phases = np.outer(angles, waves)
    smooth = np.column_stack([np.ones(count), np.cos(phases), np.sin(phases)])
    left = radius - smooth @ np.linalg.lstsq(smooth, radius, rcond=None)[0]
    scatter = float(np.linalg.norm(left)) / np.sqrt(count - smooth.shape[1])
    return Outline(radius, np.maximum(sigma, scatter), np.count_nonzero(gain > 0) / count, np.nansum(gain))


def _fit(
    r: Floats, s: Floats, w: Floats, guess: float, pitch: float, terms: int
) -> tuple[float, float, float]:
    """Radius of the edge near a guess and its sigma (mm), and its gain; NaN without enough slopes."""
    inside, none = int(np.count_nonzero(r < guess)), (np.nan, np.nan, np.nan)
    if inside < 3 or r.size - inside < 3 or r.size < 2 * (_TERMS[-1] + 1):
        return none
    radii = np.linspace(_SCAN[0] * guess, _SCAN[1] * guess, _COARSE)
    chi = _misfit(r, s, w, radii, terms)
    best = int(np.argmin(chi))
    step = radii[1] - radii[0]
    fine = np.linspace(radii[best] - step, radii[best] + step, _FINE)
    chi_fine = _misfit(r, s, w, fine, terms)
    at = int(np.argmin(chi_fine))
    low, high = _REACH[0] * guess, _REACH[1] * guess
    smooth = np.polynomial.chebyshev.chebvander((2.0 * r - low - high) / (high - low), terms)[None]
    least, plain = float(chi_fine[at]), float(_least_squares(smooth * w[:, None], s * w)[0])
    unit = max(1.0, min(least, plain) / (r.size - terms - 1))
    if best in (0, _COARSE - 1):
        return none
    places, values = np.concatenate([radii, fine]), np.concatenate([chi, chi_fine])
    spread = 0.5 * float(np.ptp(places[values < least + unit]))
    return float(fine[at]), max(spread, float(fine[1] - fine[0]), 1e-3 * pitch), (plain - least) / unit


def _gathered(r: Floats, slope: Floats, sigma: Floats, guess: float) -> tuple[Floats, Floats, Floats]:
    """r, slope and 1/sigma around a guess, in at most _RINGS rings of as many pixels each."""
    near = (r > _REACH[0] * guess) & (r < _REACH[1] * guess)
    r, s, weight = r[near], slope[near], 1.0 / sigma[near] ** 2
    if r.size <= _RINGS:
        return r, s, np.sqrt(weight)
    starts = (np.arange(_RINGS) * r.size) // _RINGS
    total = np.add.reduceat(weight, starts)
    r, s = (np.add.reduceat(weight * part, starts) / total for part in (r, s))
    return r, s, np.sqrt(total)


def _misfit(r: Floats, s: Floats, w: Floats, radii: Floats, count: int) -> Floats:
    """chi^2 of the contact law of so many terms with its edge at every one of radii, (M,)."""
    q = r / radii[:, None]
    out = q >= 1.0
    q_out = np.where(out, q, 2.0)
    terms = [
        np.where(out, 2.0 / np.pi * q_out * np.arcsin(1.0 / q_out), 1.0),
        np.where(out, 0.0, q - 1.0),
        np.where(out, 0.0, (q - 1.0) ** 2),
        np.where(out, np.sqrt(1.0 - 1.0 / q_out**2), 0.0),
        np.where(out, 1.0 / (q_out * np.sqrt(np.maximum(q_out**2 - 1.0, _NEAREST))), 0.0),
    ]
    return _least_squares(np.stack(terms[:count], axis=2) * w[:, None], s * w)


def _least_squares(terms: Floats, values: Floats) -> Floats:
    """Smallest squared residual, (M,), of values (N,) by terms (M, N, K)."""
    normal = terms.transpose(0, 2, 1) @ terms
    diagonal = np.einsum("mkk->mk", normal)
    normal[:, range(terms.shape[2]), range(terms.shape[2])] += _RIDGE * diagonal + 1e-300
    found = np.linalg.solve(normal, terms.transpose(0, 2, 1) @ values[:, None])
    left = values - (terms @ found)[..., 0]
    squares: Floats = np.einsum("mn,mn->m", left, left)
    return squares
