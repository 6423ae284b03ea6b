"""Shift of frames: motion of camera, mirror or display between frames.

At the place u of a pixel, common to all frames of an axis, a sample is v_f = o + a t_f(u); a shift d_f of the
frame adds a t_f'(u) d_f. The residual of a fit of offset and contrast (of each fringe; or common, if some
have too few frames for a phase) and of one place is r = P v, with the projection P of each pixel. Normal
equations over many pixels give the part of the shifts that a place does not absorb:

    M d = b,  M_fg = <a t_f' P_fg a t_g'>,  b_f = <a t_f' r_f>.

In the well-conditioned directions of M, d is a handful of coefficients. In a steady motion all are
proportional to time, and places belong to a moment that may differ from that of the scene's pose; with
vibration they are not. Gains of single frames (a lamp, an exposure) contribute to the coefficients, too; the
mean levels give their size.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, fdtri

from optolever.patterns import Frame

from ..display import FINER, through
from ..plan import AxisPlan, Fringe, Plan
from .noise import Sample, bulk, product

__all__ = ["Moved", "Seen", "frames_moved"]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
#: Fewest pixels for a variance (18 %), most pixels, and thinning for mean products.
_FEWEST, _MOST, _THIN = 64, 8192, 8
#: Parts of the sample for the variance of a coefficient.
_PARTS = 16
#: Share of the largest eigenvalue of M from which on a direction is well conditioned.
_KNOWN = 0.1
#: False-alarm probability of motion by noise or gains, and of steady motion by vibration.
_CHANCE = 0.01
_FAINT = np.float32(1e-9)
#: Amplitude of a displayed fringe, grey levels.
_SHOWN = 127.5


class Seen(NamedTuple):
    """Sampled pixels of an axis: places (K,), NaN: unknown; width of a pixel (None: fringes are ideal
    cosines) and rms of its response, pattern px."""

    place: F32
    width: float | None
    spread: float


class Moved(NamedTuple):
    """Motion of frames: standard deviation of the common shift of an axis, pattern px; share of frame gains
    in the variance of noise."""

    shift: float
    gains: float


def frames_moved(plan: Plan, lit: Sample, seen: dict[str, Seen]) -> dict[str, Moved]:
    """Motion of each axis; empty if noise, or gains of frames, explain it."""
    every = [_numbers(plan, axis, lit, seen[axis.axis]) for axis in plan.axes]
    told = [one for one in every if one is not None]
    if not told or not _surely_moved(told):
        return {}
    whole, rest = (
        np.concatenate(each) for each in zip(*((one.moved, one.shaken) for one in told), strict=True)
    )
    freedom, power, left = len(whole) - len(told), float(whole @ whole), float(rest @ rest)
    least = fdtri(len(told), freedom, 1 - _CHANCE) if freedom > 0 else np.inf
    steady = (power - left) / len(told) > least * left / max(freedom, 1)
    noise = float(np.mean(np.concatenate([one.variance for one in told])))
    variance = max((left / freedom if steady else power / len(whole)) - noise, 0.0)
    found, span = {}, len(plan.frames)
    for one in told:
        # the scene's pose holds at some moment of the capture, or at none
        away2 = one.rate**2 * ((one.moment - span / 2) ** 2 + span**2 / 12) if steady else 0.0
        shift = float(np.sqrt(variance * np.square(one.shares).sum() + away2))
        found[one.axis] = Moved(shift, min(float(np.mean(one.gains**2)) * one.light, 1.0))
    return found


class _Numbers(NamedTuple):
    """Motion estimate of an axis: coefficients (R,), px, their response to a drift of one px per frame, and
    their noise variance; summed squared response to gains of variance 1; gains (G,); mean square of the light
    over the variance of noise; times of the frames (N,) and their weights in a place."""

    axis: str
    moved: F64
    by_time: F64
    variance: F64
    by_gains: float
    gains: F64
    light: float
    times: F64
    shares: F64

    @property
    def rate(self) -> float:
        """Rate of the best-fitting steady motion, px per frame."""
        return float(self.by_time @ self.moved) / max(float(self.by_time @ self.by_time), float(_FAINT))

    @property
    def shaken(self) -> F64:
        """The coefficients (R,) without steady motion."""
        return self.moved - self.rate * self.by_time

    @property
    def moment(self) -> float:
        """Mean time of a place, weighted by the frames."""
        return float(self.shares @ self.times)


def _surely_moved(told: list[_Numbers]) -> bool:
    """F test of motion against frame gains, and chi2 test against noise."""
    moved, variance, gains = (
        np.concatenate([getattr(one, name) for one in told]) for name in ("moved", "variance", "gains")
    )
    by_gains = sum(one.by_gains for one in told) * float(np.mean(gains**2))
    most = by_gains * fdtri(len(moved), len(gains), 1 - _CHANCE)
    by_noise = moved**2 / np.maximum(variance, np.finfo(float).tiny)
    return bool(moved @ moved > most and by_noise.sum() > chdtri(len(moved), _CHANCE))


def _numbers(plan: Plan, axis: AxisPlan, lit: Sample, seen: Seen) -> _Numbers | None:
    """None with too few frames or pixels."""
    fringes = (*axis.fringes, *axis.singles)
    index = np.array([i for fringe in fringes for i in fringe.index], np.int64)
    fits = 1 if axis.singles else len(fringes)
    freedom = len(index) - 2 * fits - 1
    whole = np.flatnonzero(np.isfinite(seen.place) & (lit.levels[index] < lit.white).all(axis=0))
    if freedom < 1 or len(whole) < _FEWEST:
        return None
    whole = whole[:: 1 + len(whole) // (_MOST + 1)]
    rounding = _rounding(tuple(plan.frames[i] for i in index), axis.axis, axis.extent, seen.width)
    seen = seen._replace(place=seen.place[whole])
    fit = _fitted(fringes, fits, lit.levels[index[:, None], whole], seen, rounding)
    usual = bulk(fit.residual).all(axis=0)
    few = fit.only(np.flatnonzero(usual)[::_THIN])
    if few.residual.shape[1] < _FEWEST // _THIN:
        return None
    size, inwards = _known(few.products(few.slope, few.slope))
    size_of_gains, of_gains = _known(few.products(few.offset, few.offset))
    kept = fit.residual * usual
    parts = inwards @ _means(fit.slope * kept) / size[:, None]
    times, moves = index.astype(np.float64), few.taken[2] * few.slope
    return _Numbers(
        axis.axis,
        parts.mean(axis=1),
        inwards @ (times - times.mean()),
        parts.var(axis=1, ddof=1) / _PARTS,
        float(np.square(inwards @ few.products(few.slope, few.light) / size[:, None]).sum()),
        of_gains @ _means(fit.offset * kept).mean(axis=1) / size_of_gains,
        float(np.square(few.light).mean() / np.square(few.residual).mean()) * freedom / len(index),
        times,
        np.mean(moves / (moves.sum(axis=0) + _FAINT), axis=1, dtype=np.float64),
    )


def _means(of: F32) -> F64:
    """Means over pixels (N, K), in parts (N, _PARTS); a remainder is dropped."""
    count = of.shape[1] // _PARTS
    whole = of[:, : count * _PARTS].reshape(len(of), _PARTS, count)
    return np.asarray(whole.mean(axis=2, dtype=np.float64))


def _known(products: F64) -> tuple[F64, F64]:
    """The larger eigenvalues (R,) and their directions (R, N)."""
    values, vectors = np.linalg.eigh(products)
    known = values > _KNOWN * values[-1]
    return values[known], vectors.T[known]


@lru_cache(maxsize=16)
def _rounding(frames: tuple[Frame, ...], axis: str, extent: int, width: float | None) -> F32:
    """Rounding of displayed grey values, as read by pixels of a width (cells), over a fringe's amplitude,
    (N, FINER * extent)."""
    if width is None:
        return np.zeros((len(frames), 1), np.float32)
    at, which = np.arange(float(extent)), "uv".index(axis)
    off = [one.tables(extent, extent)[which] - one.ideal_levels(at, axis) for one in frames]
    return np.asarray(through(np.stack(off), width)[..., 0].T / _SHOWN, np.float32)


@dataclass(frozen=True, slots=True)
class _Fit:
    """Samples of K pixels in N frames, fitted by fringes at one place: residual, change per px, offset, and
    total light (N, K); unit vectors (N, K) of the fit's parameters: offset and contrast (both per group of
    frames), and place; same (N, N): 1 for frames of one group."""

    residual: F32
    slope: F32
    offset: F32
    light: F32
    taken: tuple[F32, F32, F32]
    same: F64

    def only(self, keep: Any) -> "_Fit":
        """Some of the pixels."""
        residual, slope, offset, light, *taken = (
            one[:, keep] for one in (self.residual, self.slope, self.offset, self.light, *self.taken)
        )
        return _Fit(residual, slope, offset, light, (taken[0], taken[1], taken[2]), self.same)

    def products(self, one: F32, other: F32) -> F64:
        """Mean over the pixels of one_f P_fg other_g (N, N)."""
        level, wave, place = (product(one * part, (other * part).T) for part in self.taken)
        whole = np.diag((one * other).sum(axis=1, dtype=np.float64))
        return np.asarray((whole - self.same * (level + wave) - place) / one.shape[1])


def _fitted(fringes: tuple[Fringe, ...], fits: int, levels: F32, seen: Seen, rounding: F32) -> _Fit:
    """Fit of levels (N, K); fits: number of groups, each fringe or all together; rounding: see _rounding."""
    counts = [len(fringe.index) for fringe in fringes]
    turn = np.repeat([2 * np.pi / fringe.period for fringe in fringes], counts).astype(np.float32)[:, None]
    shifts = np.concatenate([fringe.shifts for fringe in fringes]).astype(np.float32)[:, None]
    light = np.concatenate([fringe.exposure for fringe in fringes]).astype(np.float32)[:, None]
    phase, swung = (
        turn * seen.place - shifts,
        light * np.exp(-0.5 * np.square(np.float32(seen.spread) * turn)),
    )
    cell = np.clip(np.rint(FINER * seen.place), 0, rounding.shape[1] - 1).astype(np.int64)
    maps = light, levels, swung * np.cos(phase), -swung * turn * np.sin(phase), swung * rounding[:, cell]
    group = np.repeat(np.arange(fits), counts if fits > 1 else sum(counts))
    groups = [_without_light(*(one[group == k] for one in maps)) for k in range(fits)]
    residual, along, *others = (np.concatenate(parts) for parts in zip(*groups, strict=True))
    along /= np.sqrt(np.square(along).sum(axis=0)) + _FAINT
    residual -= along * (along * residual).sum(axis=0)
    slope, offset, shown, level, swing = others
    same = (group[:, None] == group).astype(np.float64)
    return _Fit(residual, slope, offset, shown, (level, swing, along), same)


def _without_light(light: F32, levels: F32, wave: F32, slope: F32, rounding: F32) -> tuple[F32, ...]:
    """Frames of one group: levels and their change per px, orthogonal to offset and contrast; that change,
    offset, fitted levels; unit vectors of offset and contrast."""
    level = np.broadcast_to(light / np.sqrt(np.square(light).sum()), wave.shape)
    swing = wave - level * (level * wave).sum(axis=0)
    swing /= np.sqrt(np.square(swing).sum(axis=0)) + _FAINT
    contrast = (swing * levels).sum(axis=0) / ((swing * wave).sum(axis=0) + _FAINT)
    levels, slope = levels - contrast * rounding, contrast * slope
    offset = level * (level * (levels - contrast * wave)).sum(axis=0)

    def left(of: F32) -> F32:
        of = of - level * (level * of).sum(axis=0)
        return np.asarray(of - swing * (swing * of).sum(axis=0))

    return left(levels), left(slope), slope, offset, offset + contrast * wave, level, swing
