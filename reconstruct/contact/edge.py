"""The edge of a contact, found in the slopes around a dent by what elastic contact does to them.

Under a smooth rigid indenter the surface follows the indenter; just outside it an elastic half-space is free,
and its slope along r, q = r / r_e, is a sum of free solutions (K. L. Johnson, Contact Mechanics, 1985, ch. 3)

    q asin(1/q),   sqrt(1 - 1/q^2)   (pressure that vanishes at the edge: Hertz),
    1/(q sqrt(q^2 - 1))              (infinite pressure there: an indenter with a sharp rim, a punch)

so that the curvature across the edge jumps to infinity. One least-squares fit to the radial slopes of all
pixels around: the outline r_e(phi) and the amplitudes of the solutions are Fourier series. A polynomial in r
of as many amplitudes is the alternative; the difference of both chi^2 is twice the logarithm of a likelihood
ratio.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..arrays import Floats
from .dent import Dent

__all__ = ["ANGLES", "Outline", "outline"]

ANGLES = np.linspace(-np.pi, np.pi, 72, endpoint=False)
_TIP = 3.0  # pixels: steepest so near to the middle is a tip
_RING = 1.5  # pixels: width of the rings in which the steepest slope is looked for
_REACH = (0.45, 1.7)  # of that radius: where the slopes are compared
_SCAN = np.linspace(-1, 1, 31)
_SEARCH = (0.4, 0.2, 0.1, 0.05)  # around it, relative: where the edge is looked for
_WAVES = 4  # around, of the outline; of the amplitudes: 2
_MOST = 16_000  # pixels of the dent
_STEPS = 8  # of Gauss and Newton
_GAIN = 50.0  # of chi^2
_TERMS = (4, 5)  # of the law, in addition to the edge: of Hertz, of a punch
_NEAREST = 1e-3  # of q^2 - 1 where the slope of a punch is infinite
_RIDGE = 1e-10  # of the normal matrix' diagonal


@dataclass(frozen=True, slots=True)
class Outline:
    """Edge of a contact about the dent's middle: radius (n,) at ANGLES, mm; root (n, p) of its covariance;
    gain: chi^2 of a smooth surface above that of the law, in units of
    the noise or of what neither explains."""

    radius: Floats
    root: Floats
    gain: float

    @property
    def area(self) -> float:
        """Inside, mm^2."""
        return float(np.pi * np.mean(self.radius**2))

    @property
    def centroid(self) -> Floats:
        """Of the area inside, from the middle, mm."""
        ways = np.stack([np.cos(ANGLES), np.sin(ANGLES)])
        centroid: Floats = 2 / 3 * (ways * self.radius**3).mean(axis=1) / np.mean(self.radius**2)
        return centroid

    def at(self, phi: Floats) -> Floats:
        """Radius in other directions."""
        radius: Floats = np.interp(phi, ANGLES, self.radius, period=2 * np.pi)
        return radius


def outline(dent: Dent) -> tuple[Dent, Outline | str]:
    """The dent about its contact's middle and the edge, or why there is none, in words."""
    few = dent.thinned(_MOST)
    guess = _steepest(few)
    if guess < _TIP * dent.pitch:
        return dent, "the slope is steepest at the deepest point, a tip"
    fits = [fit for fit in (_fitted(few, guess, terms) for terms in _TERMS) if fit is not None]
    if not fits:
        return dent, "too few slopes, or the image cuts it"
    middle, edge = fits[-1] if fits[-1][1].gain > fits[0][1].gain + _GAIN else fits[0]
    if edge.gain > _GAIN:
        return replace(dent, middle=middle), edge
    return dent, "a smooth surface explains the slopes as well or better than a contact's edge"


def _steepest(dent: Dent) -> float:
    """Radius of the steepest descent, mm."""
    near = dent.measured & (dent.r < 1.2 * dent.r[dent.inside].max())
    if not near.any():
        return 0.0
    (slope, sigma), width = dent.radial, _RING * dent.pitch
    ring = (dent.r[near] / width).astype(np.intp)
    count = np.maximum(np.bincount(ring), 1)
    mean = np.bincount(ring, slope[near]) / count
    noise = np.sqrt(np.bincount(ring, sigma[near] ** 2)) / count
    return float(np.argmin(mean + 2.0 * noise) + 0.5) * width


def _fitted(dent: Dent, guess: float, terms: int) -> tuple[tuple[float, float], Outline] | None:
    """Middle and edge of a law of so many terms: a circle, moved and searched ever more finely, then its
    waves. None without enough slopes or with an edge out of reach."""
    radius, low, high = guess, _REACH[0] * guess, _REACH[1] * guess
    for search, waves in zip(_SEARCH, (1, 1, 1, min(_WAVES, int(guess / dent.pitch / _TIP))), strict=True):
        r, (slope, sigma) = dent.r, dent.radial
        use = np.flatnonzero(dent.measured & (r > low) & (r < high))
        freedom = use.size - 5 * terms - 2 * waves - 1
        if freedom < use.size / 4:
            return None
        r, phi, values = r[use], dent.phi[use], slope[use] / sigma[use]
        turns = _waves(phi, 2) / sigma[use, None]
        left = partial(_misfit, r, values, _waves(phi, waves), turns, terms)
        circles = [radius * (1 + search * share) * np.eye(2 * waves + 1)[0] for share in _SCAN]
        start = min(circles, key=lambda edge: float(np.square(left(edge)).sum()))
        edge, law, normal = _least(left, start, dent.pitch)
        radius, around = float(edge[0]), _waves(ANGLES, waves) @ edge
        if not 0.5 * guess < around.min() <= around.max() < 1.6 * guess:
            return None
        if waves == 1 and search != _SEARCH[-1]:
            dent = replace(dent, middle=(dent.middle[0] + edge[1], dent.middle[1] + edge[2]))
    smooth = np.polynomial.chebyshev.chebvander((2.0 * r - low - high) / (high - low), terms)
    plain = _residual(np.asarray(smooth.T, np.float64), turns, values)
    chi, chi_plain = float(law @ law), float(plain @ plain)
    unit = max(1.0, min(chi, chi_plain) / freedom)
    root = _waves(ANGLES, waves) @ np.linalg.cholesky(np.linalg.inv(normal) * unit)
    return dent.middle, Outline(around, root, (chi_plain - chi) / unit)


def _misfit(r: Floats, values: Floats, around: Floats, turns: Floats, terms: int, edge: Floats) -> Floats:
    """Residual of the law with its edge at the Fourier series."""
    return _residual(_law(r / np.maximum(around @ edge, 1e-9), terms), turns, values)


def _waves(phi: Floats, count: int) -> Floats:
    """1, cos, sin of so many waves around, (N, 2 count + 1)."""
    pairs = [part(k * phi) for k in range(1, count + 1) for part in (np.cos, np.sin)]
    return np.stack([np.ones_like(phi), *pairs], axis=1)


def _law(q: Floats, count: int) -> Floats:
    """Slopes of the contact law (count, N)."""
    out = q >= 1.0
    far = np.where(out, q, 2.0)
    terms = (
        np.where(out, 2.0 / np.pi * far * np.arcsin(1.0 / far), 1.0),
        np.where(out, 0.0, q - 1.0),
        np.where(out, 0.0, (q - 1.0) ** 2),
        np.where(out, np.sqrt(1.0 - 1.0 / far**2), 0.0),
        np.where(out, 1.0 / (far * np.sqrt(np.maximum(far**2 - 1.0, _NEAREST))), 0.0),
    )
    return np.stack(terms[:count])


def _residual(terms: Floats, turns: Floats, values: Floats) -> Floats:
    """Of values (N,) by terms (K, N) whose amplitudes go by turns (N, 5), weighted."""
    matrix = (terms[:, :, None] * turns).transpose(1, 0, 2).reshape(values.size, -1)
    normal = matrix.T @ matrix
    normal.flat[:: len(normal) + 1] *= 1 + _RIDGE
    normal.flat[:: len(normal) + 1] += 1e-300
    residual: Floats = values - matrix @ np.linalg.solve(normal, matrix.T @ values)
    return residual


def _least(left: Callable[[Floats], Floats], edge: Floats, step: float) -> tuple[Floats, Floats, Floats]:
    """Parameters of the smallest residual, that, and their normal matrix: steps of Gauss and Newton by
    differences that shrink, as pixels cross the edge one by one."""
    residual, every = left(edge), np.eye(edge.size)
    for _ in range(_STEPS):
        jacobian = np.stack(
            [(left(edge + row) - left(edge - row)) / (2 * step) for row in step * every], axis=1
        )
        normal = jacobian.T @ jacobian
        normal += _RIDGE * np.trace(normal) * every
        change = np.linalg.solve(normal, jacobian.T @ residual)
        for reach in (1.0, 0.3, 0.1):
            other = left(edge - reach * change)
            if other @ other < residual @ residual:
                edge, residual = edge - reach * change, other
                break
        else:
            step *= 0.5
    return edge, residual, normal
