"""Deviations that no sequence describes: lag of a display so slow that a frame contains a share of earlier
ones, misfit of samples, and stray light, as by a second reflection of the pattern."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..frames import Light
from ..plan import Fringe, Plan
from .noise import Noise, Sample, bulk, harmonics, product, trimmed_variance, unexplained

__all__ = [
    "Before",
    "Between",
    "held_before",
    "misfit_between",
    "misfit_within",
    "stray_light",
    "whole",
    "without_before",
]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
#: Largest sample, and fewest pixels.
_ASKED, _FEWEST = 1024, 64
#: Smallest significant misfit, share of the noise's variance; deviations of a sure lag; earlier frames.
_BEYOND, _SURE, _EARLIER = 0.2, 5.0, 3
#: Trial ratios, an odd number of them, up to the largest.
_RATIOS, _LONGEST = 361, 0.9
_FAINT = 1e-9
#: Share of consistent pixels beyond which the others have another fault.
_MOSTLY = 0.75
#: Parts of the sample for the error that neighbours share; pixels for the variance of a bit's levels.
_PARTS, _MANY = 16, 4096
#: Of bits: level over the amplitude below which a pixel is at an edge, largest share of such pixels, quantile
#: over the bits, least share of stray light (clean drawn rigs: 0.004 by blurred edges; `lab pairs`).
_EDGE, _AT_EDGES, _QUANTILE, _LEAST = 0.75, 0.08, 0.65, 0.005


def misfit_within(fringe: Fringe, lit: Sample, noise: Noise) -> float:
    """Variance of a fringe's samples beyond noise, of the bulk of pixels, over its squared amplitude.

    Harmonics of a response are excluded (they do not shift a phase unless they alias), and so is chance. 0
    for three samples, or too few pixels.
    """
    few, rows = whole(lit, fringe.index), fringe.unlike
    freedom, pixels = len(rows), few.levels.shape[1]
    if freedom < 1 or pixels < _FEWEST:
        return 0.0
    levels, own = few.levels.astype(np.float64), few.variance(noise)
    waves = harmonics(fringe, levels)[1:]
    left = unexplained(product(rows, levels[list(fringe.index)]), waves[2:])
    power = np.square(waves[:2]).sum(axis=0) + _FAINT
    return _excess((left / np.sqrt(own)).ravel()) * float(np.median(own / power))


def _excess(residuals: Any, sure: float = 3.0) -> float:
    """Variance of normalised residuals (K,) beyond 1; 0: chance explains it (`sure` deviations)."""
    times = trimmed_variance(residuals)
    chance = max(_BEYOND, sure * float(np.sqrt(2 / len(residuals))))
    return times - 1 if times > 1 + chance else 0.0


class Between(NamedTuple):
    """Variance (turns^2) of a phase by contradictions between periods, and the part that neighbours share."""

    variance: float = 0.0
    common: float = 0.0


def misfit_between(fringes: tuple[Fringe, ...], known: Any, place: F64, few: Sample, noise: Noise) -> Between:
    """Phase variance beyond noise and known variances (turns^2, of each fringe), from contradictions between
    periods at the decoded places (K,).

    It includes errors that no single fringe reveals: aliased harmonics, errors of three-step fringes, motion
    of the map between fringes. Errors by harmonics alternate along a fringe; neighbours share the shift by a
    second reflection.
    """
    own = few.variance(noise) / (2 * np.pi) ** 2
    phases = [_phase(fringe, few, own, more) for fringe, more in zip(fringes, known, strict=True)]
    (turn, finest), fine, found = phases[-1], fringes[-1].period, Between()
    at = fine * (turn + np.rint(place / fine - turn))
    for fringe, (turn, variance) in zip(fringes[:-1], phases, strict=False):
        ratio2 = (fine / fringe.period) ** 2
        off, expected = turn - at / fringe.period, variance + ratio2 * finest
        off = (off - np.rint(off)) / np.sqrt(expected)
        if excess := _excess(off):
            usual = float(np.median(expected)) / (1 + ratio2)
            common = _common(off, turn, 1 + excess)
            found = Between(max(found.variance, excess * usual), max(found.common, common * usual))
    return found


def _common(off: F64, turn: F64, variance: float) -> float:
    """Mean square of what neighbours among sampled deviations (K,) of a variance share, beyond chance; 0:
    insignificant. turn: phase; gains of single frames give waves of one and two periods a turn."""
    usual = off**2 < _SURE**2 * variance
    phase, off = 2 * np.pi * turn[usual], off[usual]
    waves = np.stack([one(k * phase) for k in (1, 2) for one in (np.cos, np.sin)] + [np.ones_like(phase)])
    off = off - np.linalg.lstsq(waves.T, off)[0][:4] @ waves[:4]
    means = np.array([part.mean() for part in np.array_split(off, _PARTS)])
    chance = variance * _PARTS / len(off)
    shared = float(np.mean(means**2)) - chance
    return shared if shared > 3 * chance * float(np.sqrt(2 / _PARTS)) else 0.0


def stray_light(plan: Plan, lit: Sample, noise: Noise) -> float:
    """Light of other places of the pattern in a pixel, rms over the amplitude. 0 without white and black.

    A bit is as bright as white, or as dark as black, of its own pixel; a second reflection adds the bit of
    another place. Bits with few pixels at their edges count. The stripes of some are wider than the
    reflection's displacement and show it in few pixels: hence a quantile above the median.
    """
    if min(plan.white, plan.black) < 0:
        return 0.0
    lit = whole(lit, [plan.white], _MANY)
    if len(lit.places) < _FEWEST:
        return 0.0
    white, black = lit.levels[[plan.white, plan.black]]
    amplitude, middle = np.maximum(0.5 * (white - black), np.float32(_FAINT)), 0.5 * (white + black)
    own, found = lit.variance(noise) / amplitude**2, []
    for code in (axis.code for axis in plan.axes if axis.code is not None):
        for plain, inverse in zip(code.plain.tolist(), code.inverse.tolist(), strict=True):
            high, low = (middle if i < 0 else lit.levels[i] for i in (plain, inverse))
            both = min(plain, inverse) >= 0  # a pair's difference holds four samples, a bit's two
            level, times = ((high - low) / (2 * amplitude), 1) if both else ((high - low) / amplitude, 2)
            if np.mean(np.abs(level) < _EDGE) <= _AT_EDGES:
                found += [_spread2(sign * level, times * own) for sign in (1, -1)]
    share = float(np.quantile(found, _QUANTILE)) ** 0.5 if found else 0.0
    return share if share > _LEAST else 0.0


def _spread2(level: F32, variance: F32) -> float:
    """Variance of a bit's levels (K,) where it is 1, beyond that by noise (K,); 0: insignificant."""
    at = np.flatnonzero(level > 0)
    if len(at) < _FEWEST:
        return 0.0
    off = (level[at] - np.median(level[at])) / np.sqrt(variance[at])
    return _excess(off, _SURE) * float(np.median(variance[at]))


def _phase(fringe: Fringe, few: Sample, own: Any, known: float) -> tuple[F64, F64]:
    """Phase (K,), turns, of sampled pixels, and its variance; own: variance of a sample over (2 pi)^2."""
    inverse = fringe.inverse[1:]
    c, s = product(inverse, few.levels[list(fringe.index)])
    variance = own * (float(np.square(inverse).sum()) / 2) / (c * c + s * s + _FAINT)
    return np.arctan2(s, c) / (2 * np.pi), variance + known


class Before(NamedTuple):
    """Lag model: frames contain earlier ones if the display is slow, or the camera exposes too early.

    I_i = (1 - m) L_i + m S_(i-1), S_i = (1 - e) L_i + e S_(i-1): a share m of the display's state S after the
    last frame. L is (I_i - sum_k a r^(k-1) I_(i-k)) / (1 - m), r = (e - m) / (1 - m), a = e - r.

    first, ratio  a and r over the image, which are corrected; a < 0: overdriven
    left          residual share of fringes (by their frames); least: of fringes without an estimate
    """

    first: float = 0.0
    ratio: float = 0.0
    left: Mapping[tuple[int, ...], float] = {}
    least: float = 0.0

    @property
    def share(self) -> float:
        """Share m of the last frame's light in a frame."""
        return self.first / (1 - self.ratio)

    @property
    def noisier(self) -> float:
        """Ratio of the variance of a sample of L to that of I."""
        return (1 + self.first**2 / (1 - self.ratio**2)) / (1 - self.share) ** 2


class _Moments(NamedTuple):
    """Moments of the combinations that vanish for fringes, of a fringe's samples and of those 1, 2, ...
    frames before, M in all, in one part of the image; or sums of such.

    square  (M, M) sums of products; noise: the same for noise of variance 1
    """

    fringe: tuple[int, ...]
    part: int
    square: F64
    noise: F64

    def of_light(self, before: Before) -> tuple[float, float]:
        """Sums of squares of the combinations after lag removal, and for noise."""
        weights = self._weights(before)
        return float(weights @ self.square @ weights), float(weights @ self.noise @ weights)

    def left(self, before: Before) -> float:
        """Residual lag: significant share of earlier frames, rms, relative to them; 1 at most."""
        whole, noise = self.of_light(before)
        both = (self.square - whole / noise * self.noise)[1:] @ self._weights(before)
        more = np.linalg.lstsq(self.square[1:, 1:], both)[0]
        own = whole / float(self.noise[0, 0])
        shown = float(np.trace(self.square[1:, 1:])) / len(more)
        found = float(more @ both)
        return min(found / shown, 1.0) ** 0.5 if found > _SURE**2 * own else 0.0

    def _weights(self, before: Before) -> F64:
        return np.append(1.0, -before.first * before.ratio ** np.arange(len(self.square) - 1))


def held_before(plan: Plan, lit: Sample) -> Before:
    """Estimate the lag over the image, and the residual lag in parts of it.

    Combinations of L that vanish for fringes must be noise, in the quarters of the image and in all fringes
    of more than three samples with enough frames before them. If these disagree, the lag is not removed;
    without equal exposures there is no estimate.
    """
    every = [fringe for axis in plan.axes for fringe in axis.fringes]
    if not all((fringe.exposure == 1).all() for fringe in every):
        return Before()
    many = [fringe for fringe in every if len(fringe.index) > 3]
    earlier = min(_EARLIER, max([min(fringe.index) for fringe in many], default=0))
    told = [one for f in many if earlier and min(f.index) >= earlier for one in _moments(f, earlier, lit)]
    none = _left(told, Before())
    if not any(none.left.values()):
        return none
    before = _left(told, _fitted(told))
    # most fringes must agree everywhere; a frame that mostly repeats the one before is another fault
    agreed = max(before.left.values()) < 0.5 * abs(before.first) and abs(before.share) < 0.5
    return before if agreed else none


def _fitted(told: list[_Moments]) -> Before:
    """Lag with the least power over its noise: a by a generalised eigenvalue, and r if that is significantly
    better. (Least squares alone would mistake noise for lag where frames cancel.)"""
    whole = _sum(told)
    sure = _SURE**2 / float(whole.noise[0, 0])
    ratios = np.linspace(-_LONGEST, _LONGEST, _RATIOS)
    weights = np.zeros((_RATIOS, 2, len(whole.square)))
    weights[:, 0, 0], weights[:, 1, 1:] = 1, -(ratios[:, None] ** np.arange(len(whole.square) - 1))
    square, noise = (weights @ one @ weights.swapaxes(1, 2) for one in (whole.square, whole.noise))
    values, vectors = np.linalg.eig(np.linalg.solve(noise, square))
    least = values.real.argmin(axis=1), np.arange(_RATIOS)
    rest, (one, share) = values.real[least[::-1]], vectors.real[least[1], :, least[0]].T
    shares = share / one
    best, alone = int(rest.argmin()), _RATIOS // 2
    if rest[alone] - rest[best] > sure * rest[best]:
        return Before(float(shares[best]), float(ratios[best]))
    none = float(whole.square[0, 0] / whole.noise[0, 0])
    return Before(float(shares[alone]) if none - rest[alone] > sure * rest[alone] else 0.0)


def _left(told: list[_Moments], before: Before) -> Before:
    """Add the residual lag of each fringe: its largest estimate in a part of the image or in all. The floor
    is the largest pooled estimate in a part, without the fringe of the largest lag, which may have a wrong
    frame."""
    left = {}
    for fringe in {one.fringe for one in told}:
        own = [one for one in told if one.fringe == fringe]
        left[fringe] = max(one.left(before) for one in [*own, _sum(own)])
    others = [one for one in told if one.fringe != max(left, key=lambda fringe: left[fringe])]
    parts = [[one for one in others if one.part == part] for part in range(4)]
    least = max([_sum(part).left(before) for part in parts if part], default=0.0)
    return before._replace(left={each: max(size, least) for each, size in left.items()}, least=least)


def _moments(fringe: Fringe, earlier: int, lit: Sample) -> list[_Moments]:
    """Moments in the quarters of the image, from pixels unsaturated in these and the earlier frames."""
    frames = np.array(fringe.index) - np.arange(earlier + 1)[:, None]
    few, rows = whole(lit, np.unique(frames)), fringe.unlike
    levels = few.levels.astype(np.float64)
    if levels.shape[1] < _FEWEST:
        return []
    seen = np.concatenate([product(rows, levels[each]) for each in frames])
    usual = np.flatnonzero(bulk(seen).all(axis=0))
    if len(usual) > _MOSTLY * seen.shape[1]:  # a deviation in a small part of the image is no lag
        few, seen, levels = few.only(usual), seen[:, usual], levels[:, usual]
    seen = unexplained(seen, harmonics(fringe, levels)).reshape(len(frames), len(rows), -1)
    # noise of a frame is common to all combinations that contain it
    holds = np.zeros((len(frames), len(rows), len(levels)))
    for one, each in zip(holds, frames, strict=True):
        one[:, each] = rows
    noise = np.einsum("mrn,orn->mo", holds, holds)
    parts, found = (few.places > np.median(few.places, axis=0)) @ (1, 2), []
    for part in np.unique(parts).tolist():
        own = seen[..., parts == part]
        square = np.einsum("mrk,ork->mo", own, own)
        found.append(_Moments(fringe.index, part, square, noise * own.shape[2]))
    return found


def _sum(told: list[_Moments]) -> _Moments:
    square = np.sum([one.square for one in told], axis=0)
    return told[0]._replace(square=square, noise=np.sum([one.noise for one in told], axis=0))


def without_before(light: Light, plan: Plan, before: Before) -> Light:
    """Remove the lag; samples of fringes are saturated if the previous frame is, too."""
    raw, clipped = light.raw.astype(np.float32), light.raw >= light.clip
    # bits are compared: the lag of a saturated frame does not change their sign
    fringes = [fringe for axis in plan.axes for fringe in (*axis.fringes, *axis.singles)]
    for i in {i for fringe in fringes for i in fringe.index if i > 0}:
        clipped[i] |= raw[i - 1] >= light.clip
    share, ratio = np.float32(before.share), np.float32(before.ratio)
    decay = np.float32(before.first + before.ratio)
    mended = raw.copy()
    for i in range(1, len(raw)):
        mended[i] = (raw[i] - decay * raw[i - 1]) / (1 - share) + ratio * mended[i - 1]
    highest = float(light.clip / (1 - max(before.share, 0.0)))
    mended[clipped] = highest
    return replace(light, raw=mended, clip=highest, rounding=light.rounding * before.noisier)


def whole(lit: Sample, frames: Any, most: int = _ASKED) -> Sample:
    """A sample of the pixels that are unsaturated in these frames."""
    some = np.flatnonzero((lit.levels[list(frames)] < lit.white).all(axis=0))
    return lit.only(some[:: max(1, len(some) // most)])
