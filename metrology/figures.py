"""Figures of a surface's residual: rms less its noise, PVr; limits in the sense of ISO 14253-1."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from optolever.arrays import Floats
from optolever.errors import InputError

from .zernike_terms import FRINGE, zernike

__all__ = ["Verdict", "in_waves", "judge", "pvr", "rms_less_noise"]

_MOST = 40_000  # points of the fit of PVr
_COVERAGE = 2.0  # sigmas of the guard band
_UNITS = {"mm": 1.0, "um": 1e-3, "µm": 1e-3, "nm": 1e-6, "mrad": 1e-3, "urad": 1e-6, "µrad": 1e-6}


def pvr(x: Floats, y: Floats, z: Floats) -> float:
    """Robust peak to valley (n,), mm: PV of the fit by the 36 first fringe Zernike terms, and three times the
    rms of its residual. C. J. Evans, Opt. Eng. 48 (2009) 043605. NaN with fewer than 72 points."""
    if len(z) < 2 * len(FRINGE):
        return math.nan
    step = max(1, -(-len(z) // _MOST))
    u, v, z = (np.asarray(part[::step], np.float64) for part in (x, y, z))
    u, v = u - 0.5 * (u.min() + u.max()), v - 0.5 * (v.min() + v.max())
    r, theta = np.hypot(u, v), np.arctan2(v, u)
    terms = np.stack([zernike(n, m, r / r.max(), theta) for n, m in FRINGE], axis=1)
    smooth = terms @ np.linalg.lstsq(terms, z, rcond=None)[0]
    return float(np.ptp(smooth) + 3 * np.sqrt(np.mean((z - smooth) ** 2)))


def in_waves(height: float, nm: float) -> float:
    """Waves of nm in the wavefront that a surface of this height (mm) reflects: twice the height.

    >>> round(in_waves(316.4e-6, 632.8), 9)
    1.0
    """
    return 2e6 * height / nm


def rms_less_noise(rms: float, noise_rms: float) -> float:
    """Rms of the surface, whose measured rms holds noise of this rms; 0 where noise explains all of it."""
    return math.sqrt(max(rms**2 - noise_rms**2, 0.0))


@dataclass(frozen=True, slots=True)
class Verdict:
    """A figure against its limit: pass, fail, or undecided where the limit lies within two sigma, or sigma is
    unknown (NaN)."""

    name: str
    value: float
    sigma: float
    limit: float
    verdict: str


def judge(limit: str, figures: Mapping[str, tuple[float, ...]]) -> Verdict:
    """The verdict on NAME=LIMIT (a length such as 50nm, a slope such as 20urad) by the figures' values and
    standard deviations, which add in square. InputError for an unknown name or unit.

    With an uncertainty the conforming zone ends two sigma below the limit (ISO 14253-1).
    """
    name, equals, text = limit.partition("=")
    digits = text.rstrip("munradµ")
    if name not in figures or not equals:
        raise InputError(f"limit {limit!r}: must be NAME=LIMIT, NAME one of {', '.join(figures)}")
    try:
        most = float(digits) * _UNITS[text[len(digits) :]]
    except (KeyError, ValueError):
        raise InputError(
            f"limit {limit!r}: must be a number with its unit, such as {name}=50nm or slope_x=20urad"
        ) from None
    if not most > 0:
        raise InputError(f"limit {limit!r}: must be above 0; it holds for magnitudes, such as {name}=4um")
    value, *sigmas = figures[name]
    sigma = math.hypot(*sigmas)
    band = _COVERAGE * sigma
    verdict = "pass" if value + band <= most else "fail" if value - band > most else "undecided"
    return Verdict(name, value, sigma, most, verdict)
