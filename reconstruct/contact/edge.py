"""The edge of a contact, found in the slopes around a dent by what elastic contact does to them.

Under a smooth rigid indenter the surface follows the indenter; just outside it an elastic half-space is free,
and its slope along r, q = r / r_e, is a sum of free solutions (K. L. Johnson, Contact Mechanics, 1985, ch. 3)

    q asin(1/q),   sqrt(1 - 1/q^2)   (pressure that vanishes at the edge: Hertz),
    1/(q sqrt(q^2 - 1))              (infinite pressure there: an indenter with a sharp rim, a punch)

so that the curvature across the edge jumps to infinity: the slope there is steepest and has a kink that no
smooth surface has. In every sector around the dent that law, with its edge r_e free, and a polynomial of as
many parameters are fitted to the radial slope; where the law explains the slopes better, there is a contact
edge, at r_e.
"""

from dataclasses import dataclass

import numpy as np

from ..arrays import Floats

__all__ = ["Profile", "SectorEdge", "fit_edge"]

_REACH = (0.45, 1.7)  # of the first guess: where the slopes are compared
_SCAN = (0.6, 1.4)  # likewise: where the edge is looked for
_COARSE, _FINE = 61, 41  # places tried
_TERMS = 5  # of the contact law at most, in addition to the edge
_RINGS = 160
_NEAREST = 1e-3  # of q^2 - 1 where the slope of a punch is infinite
_RIDGE = 1e-10  # of the normal matrix' diagonal


@dataclass(frozen=True, slots=True)
class Profile:
    """Radial slope of one sector: r (mm), slope, its sigma, (N,) each, sorted by r; step: pixel size, mm."""

    r: Floats
    slope: Floats
    sigma: Floats
    step: float


@dataclass(frozen=True, slots=True)
class SectorEdge:
    """radius +- sigma (mm) of the edge; gain: by how much chi^2 of the polynomial exceeds that of the law, in
    units of the noise or of what neither explains.
    """

    radius: float
    sigma: float
    gain: float


def fit_edge(profile: Profile, guess: float, sharp: bool) -> SectorEdge | None:
    """The edge near a guess (mm), None without enough slopes around it; sharp: by an indenter with a rim."""
    r, s, w = _gathered(profile, _REACH[0] * guess, _REACH[1] * guess)
    inside = int(np.count_nonzero(r < guess))
    if inside < 3 or r.size - inside < 3 or r.size < 2 * (_TERMS + 1):
        return None
    radii = np.linspace(_SCAN[0] * guess, _SCAN[1] * guess, _COARSE)
    chi = _misfit(r, s, w, radii, sharp)
    best = int(np.argmin(chi))
    step = radii[1] - radii[0]
    fine = np.linspace(radii[best] - step, radii[best] + step, _FINE)
    chi_fine = _misfit(r, s, w, fine, sharp)
    at = int(np.argmin(chi_fine))
    least = float(chi_fine[at])
    terms = _TERMS if sharp else _TERMS - 1
    smooth = _smooth_misfit(r, s, w, guess, terms)
    unit = max(1.0, min(least, smooth) / (r.size - terms - 1))
    places, values = np.concatenate([radii, fine]), np.concatenate([chi, chi_fine])
    inner = places[values < least + unit]
    sigma = max(0.5 * float(np.ptp(inner)), float(fine[1] - fine[0]), 1e-3 * profile.step)
    if best in (0, _COARSE - 1):
        return None
    return SectorEdge(float(fine[at]), sigma, (smooth - least) / unit)


def _gathered(profile: Profile, low: float, high: float) -> tuple[Floats, Floats, Floats]:
    """r, slope and 1/sigma between two radii, in at most _RINGS rings of as many pixels each."""
    near = (profile.r > low) & (profile.r < high)
    r, s, weight = profile.r[near], profile.slope[near], 1.0 / profile.sigma[near] ** 2
    if r.size <= _RINGS:
        return r, s, np.sqrt(weight)
    starts = (np.arange(_RINGS) * r.size) // _RINGS
    total = np.add.reduceat(weight, starts)
    r, s = (np.add.reduceat(weight * part, starts) / total for part in (r, s))
    return r, s, np.sqrt(total)


def _misfit(r: Floats, s: Floats, w: Floats, radii: Floats, sharp: bool) -> Floats:
    """chi^2 of the contact law with its edge at every one of radii, (M,)."""
    q = r / radii[:, None]
    out = q >= 1.0
    q_out = np.where(out, q, 2.0)
    arc = np.arcsin(1.0 / q_out)
    terms = [
        np.where(out, 2.0 / np.pi * q_out * arc, 1.0),
        np.where(out, 0.0, q - 1.0),
        np.where(out, 0.0, (q - 1.0) ** 2),
        np.where(out, np.sqrt(1.0 - 1.0 / q_out**2), 0.0),
    ]
    if sharp:
        terms.append(np.where(out, 1.0 / (q_out * np.sqrt(np.maximum(q_out**2 - 1.0, _NEAREST))), 0.0))
    return _least_squares(np.stack(terms, axis=2) * w[:, None], s * w)


def _smooth_misfit(r: Floats, s: Floats, w: Floats, guess: float, degree: int) -> float:
    """chi^2 of the polynomial, which has as many parameters as the law with its edge."""
    low, high = _REACH[0] * guess, _REACH[1] * guess
    t = (2.0 * r - low - high) / (high - low)
    terms = np.polynomial.chebyshev.chebvander(t, degree)[None]
    return float(_least_squares(terms * w[:, None], s * w)[0])


def _least_squares(terms: Floats, values: Floats) -> Floats:
    """Smallest squared residual, (M,), of values (N,) by terms (M, N, K)."""
    normal = terms.transpose(0, 2, 1) @ terms
    diagonal = np.einsum("mkk->mk", normal)
    normal[:, range(terms.shape[2]), range(terms.shape[2])] += _RIDGE * diagonal + 1e-300
    found = np.linalg.solve(normal, terms.transpose(0, 2, 1) @ values[:, None])
    left = values - (terms @ found)[..., 0]
    squares: Floats = np.einsum("mn,mn->m", left, left)
    return squares
