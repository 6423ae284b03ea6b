"""Noise of a decoded fringe in closed form: contrast that is left, Cramer-Rao phase noise, failure of the
order.

The contrast of a period of P cells under a display's cells, a pixel that covers w cells along its columns
and w' along its rows, and a Gaussian blur of b cells: sinc(1/P) sinc(w/P) sinc(w'/P) exp(-2 (pi b / P)^2).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc

from optolever.errors import InputError
from optolever.patterns import Frame

__all__ = [
    "DOUBT",
    "MUCH_FINER",
    "Fringe",
    "combined",
    "contrast",
    "grouped",
    "search_failure",
    "step_failure",
    "step_flagged",
    "turn_variance",
]

Floats = NDArray[np.float64]
PHASES = 64  # over which variances that depend on the phase are averaged
#: As in the decoder: a period so many times coarser than the next gives only the order.
MUCH_FINER = 4.0
#: The decoder flags a pixel whose order is wrong with a probability above this.
DOUBT = 1e-4
#: Distance, in sigma, from which on one order is not taken for another.
CERTAIN = 14.0


@dataclass(frozen=True, slots=True)
class Fringe:
    """Frames of one period: I_i = e_i (A + B cos(phase - d_i))."""

    period: float
    shifts: Floats
    exposure: Floats

    def solve(self) -> Floats:
        """Least squares (3, N) for A, B cos phase, B sin phase. InputError if it is not determined."""
        columns = [np.ones(len(self.shifts)), np.cos(self.shifts), np.sin(self.shifts)]
        design = self.exposure[:, None] * np.stack(columns, axis=1)
        if len(design) < 3 or np.linalg.cond(design) > 1e3:
            raise InputError(
                f"sequence: period {self.period:g} px has {len(design)} frames, must have 3 distinct shifts"
            )
        return np.asarray(np.linalg.pinv(design))


def grouped(frames: list[Frame]) -> list[Fringe]:
    """Phase frames of one axis by period, coarse to fine; an inverted fringe is half a turn on."""
    groups: dict[float, list[Frame]] = {}
    for frame in frames:
        groups.setdefault(frame.period_px or 1.0, []).append(frame)
    return [
        Fringe(
            period,
            np.array([(f.shift or 0.0) + (math.pi if f.inverted else 0.0) for f in group]),
            np.array([f.exposure for f in group]),
        )
        for period, group in sorted(groups.items(), reverse=True)
    ]


def contrast(period: float, widths: tuple[Floats, Floats], blur: float) -> Floats:
    """Share of the modulation that is left, of the shape of the widths."""
    soft = np.sinc(1 / period) * math.exp(-2 * (math.pi * blur / period) ** 2)
    left: Floats = soft * np.abs(np.sinc(widths[0] / period) * np.sinc(widths[1] / period))
    return left


def turn_variance(
    fringe: Fringe, amplitude: Floats, mean: Floats, read2: float, shot: float
) -> tuple[Floats, float]:
    """Variance of the phase in turns^2, averaged over the phase, and what noise^2 of a sample makes of the
    amplitude's variance (2/N for even steps).

    With even steps and no shot noise: 2/N (sigma/B)^2 / (2 pi)^2, the Cramer-Rao bound.
    """
    solve = fringe.solve()
    phase = 2 * np.pi * (np.arange(PHASES) + 0.5) / PHASES
    gain = np.cos(phase)[:, None] * solve[2] - np.sin(phase)[:, None] * solve[1]
    square = gain**2
    cosines = np.cos(phase[:, None] - fringe.shifts)
    by_read = float(square.sum(axis=1).mean())
    by_mean = float((square * fringe.exposure).sum(axis=1).mean())
    by_fringe = float((square * fringe.exposure * cosines).sum(axis=1).mean())
    noise = by_read * read2 + shot * (by_mean * mean + by_fringe * amplitude)
    with np.errstate(divide="ignore", invalid="ignore"):
        variance: Floats = np.where(amplitude > 0, noise / amplitude**2, np.inf) / (4 * np.pi**2)
    return variance, by_read


def combined(periods: list[float], variances: list[Floats]) -> Floats:
    """Variance (cells^2) of the coordinate from all periods, coarse to fine, as the decoder combines them."""
    total = variances[0]
    for k in range(1, len(periods)):
        with np.errstate(divide="ignore", invalid="ignore"):
            both = total * variances[k] / (total + variances[k])
        total = variances[k] if MUCH_FINER * periods[k] < periods[k - 1] else both
    return total


def step_failure(period: float, both: Floats) -> Floats:
    """Probability that the order nearest to an estimate is wrong: both = variance of estimate and fringe."""
    with np.errstate(divide="ignore"):
        failure: Floats = erfc(period / (2 * np.sqrt(2 * both)))
    return failure


def step_flagged(period: float, both: Floats) -> Floats:
    """Probability that the decoder calls that order doubtful: exp(-P (P - 2 |step|) / (2 both)) > 1e-4."""
    with np.errstate(divide="ignore", invalid="ignore"):
        least = 0.5 * period + both * math.log(DOUBT) / period
        share: Floats = erfc(np.maximum(least, 0.0) / np.sqrt(2 * both))
    return np.where(np.isfinite(both), share, 1.0)


def search_failure(periods: list[float], variances: list[Floats], extent: float) -> tuple[Floats, Floats]:
    """(failure, flagged) of periods that are unambiguous only together, on a surface of `extent` cells.

    Order m of the coarsest period leaves the residuals r_g = m P_0 mod P_g; after the best common shift they
    differ by chi2 = sum w r^2 - (sum w r)^2 / sum w, w = 1 / variance: m is taken for 0 with Q(sqrt(chi2)
    / 2). Two periods of v1 and v2 fringes, |v1 - v2| = 1: erfc(pi / (sqrt 2 sigma_phi sqrt(v1^2 + v2^2))).
    """
    with np.errstate(divide="ignore"):
        weights = [1 / variance for variance in variances]
    whole = sum(weights[1:], weights[0])
    failure = np.zeros(np.shape(whole))
    flagged = np.zeros(np.shape(whole))
    limit = -math.log(DOUBT)
    lit = np.asarray(whole > 0)
    least = [float(weight[lit].min(initial=np.inf)) if lit.any() else 0.0 for weight in weights]
    for order in range(1, math.ceil(extent / periods[0])):
        residuals = [
            order * periods[0] - period * round(order * periods[0] / period) for period in periods[1:]
        ]
        if _apart(residuals, least) > CERTAIN:
            continue
        square, mean = np.zeros(np.shape(whole)), np.zeros(np.shape(whole))
        for residual, weight in zip(residuals, weights[1:], strict=True):
            square, mean = square + weight * residual**2, mean + weight * residual
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = np.nan_to_num(np.sqrt(np.maximum(square - mean**2 / whole, 0.0)))
        share = 1 - order * periods[0] / extent  # of the surface from which that order leads onto it
        failure += share * erfc(distance / (2 * math.sqrt(2)))
        with np.errstate(divide="ignore", invalid="ignore"):
            flagged += share * erfc(np.maximum(distance / 2 - limit / distance, 0.0) / math.sqrt(2))
    failure, flagged = (np.where(lit, part, 1.0) for part in (failure, np.nan_to_num(flagged, nan=1.0)))
    return np.minimum(failure, 1.0), np.minimum(flagged, 1.0)


def _apart(residuals: list[float], weights: list[float]) -> float:
    """sqrt(chi2) of residuals under the least weights, which is the least anywhere."""
    spread = [weight * residual**2 for weight, residual in zip(weights[1:], residuals, strict=True)]
    mean = sum(weight * residual for weight, residual in zip(weights[1:], residuals, strict=True))
    return math.sqrt(max(sum(spread) - mean**2 / sum(weights), 0.0)) if sum(weights) > 0 else 0.0
