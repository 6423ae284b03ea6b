"""Swept stripes: a line that moves over the surface; its place when it lit a pixel most, between frames.

The light of a stripe over its distance is a raised cosine through the display's cells, a pixel's footprint
and a blur, of which the frames tell how wide it is. Stripes follow each other: where frames were lost or
doubled, pixels that look there saw them at distances that no place explains, and that tells from which frame
on all places are wrong.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from optolever.blocks import Work

from .arrays import chi_squared_limit
from .display_kernels import MOST_LOST
from .noise import QUANTISATION, Noise
from .plan import AxisPlan, Stripes
from .sweep_kernels import StripeFit, Swept, stripe_rows
from .table_decoder import flags_of_fit, sampled_rows, store

__all__ = ["Sweep", "calibrated", "stripe_step", "sweep_faults", "swept_alone"]

Map = NDArray[Any]
F64 = NDArray[np.float64]
_ORDER, _OFF = 8, 16
_DOUBT = 1e-4
#: Widths from a stripe at which it lights nothing; frames that show that at least.
_AWAY, _FRAMES = 2.5, 4
#: Share by which variances of light and dark samples differ though they are the same: the profile is a model.
_SAME = 0.15
#: Samples of the profile per pattern pixel; blurs that are tried (rms, stripe widths; None: no cells either).
_PER_PX = 16
_BLURS = (None, 0.0, 0.03, 0.06, 0.12, 0.18, 0.25, 0.35, 0.5)
#: Noise over the least of all, up to which blurs are compared pixel by pixel.
_ALIKE = 1.5
#: Squared residuals over the usual ones beyond which no blur explains a pixel.
_UNEXPLAINED = 3.0
#: Rms blur that stands for none.
_LEAST = 0.1
#: Rms blur, in widths of the stripe, by whose square that of a measured one is off.
_TELLS = 0.05
#: Share of a stripe's pixels that no place explains, above which its frame is suspect; fewest of them.
_SUSPECT, _FEWEST = 0.5, 12
#: Share of their misfit that a fault may leave and still explain them.
_LEFT = 0.25


@dataclass(frozen=True, slots=True)
class Sweep:
    """Stripes, the profile that they have (at 0, 1, 2, ... / _PER_PX pattern pixels), frames on either side
    of the brightest that are fitted, noise of a sample. blur: rms, of pixels and cells, too.
    """

    stripes: Stripes
    profile: F64
    blur: float
    window: int
    noise: Noise

    @property
    def limit(self) -> float:
        """Squared residuals, over the variance, that noise does not reach."""
        return chi_squared_limit(2 * self.window - 2)

    @property
    def least_blur(self) -> float:
        """Rms blur of the display, cells, that it surely has: without a box of one cell each for pixels and
        cells, and without what widths are wrong by."""
        square = self.blur**2 - 1 / 6 - (_TELLS * self.stripes.width) ** 2
        return float(np.sqrt(max(square, 0.0)))


def _profile(width: float, blur: float | None) -> F64:
    """Light at distances 0, 1, 2, ... / _PER_PX of a stripe: cosine, cell, footprint of a cell, Gaussian."""
    reach = int(np.ceil((width + 1 + 4 * (blur or 0.0)) * _PER_PX)) + 1
    place = np.arange(-reach, reach + 1) / _PER_PX
    light = np.where(np.abs(place) < width, 0.5 + 0.5 * np.cos(np.pi * place / width), 0.0)
    if blur is None:
        return light[reach:]
    box = np.full(_PER_PX + 1, 1 / _PER_PX)
    box[[0, -1]] /= 2
    gauss = np.exp(-0.5 * (place / max(blur, 0.3 / _PER_PX)) ** 2)
    for kernel in (box, box, gauss / gauss.sum()):
        light = np.convolve(light, kernel, mode="same")
    return light[reach:]


def _sweep(stripes: Stripes, share: float | None) -> Sweep:
    blur = None if share is None else share * stripes.width
    pitch = float(np.median(np.diff(stripes.at)))
    window = max(2, int(np.ceil((1.25 * stripes.width + 2 * (blur or 0.0)) / pitch)))
    # a cell and a footprint of one are boxes of variance 1/12
    wide = _LEAST if blur is None else float(np.hypot(blur, 6**-0.5))
    return Sweep(stripes, _profile(stripes.width, blur), wide, window, Noise(QUANTISATION))


@dataclass(frozen=True, slots=True)
class _Trial:
    """A blur (share of the stripe's width), what the sample shows of it, which pixels are lit, and the
    variance of a sample about it."""

    share: float | None
    sweep: Sweep
    found: StripeFit
    lit: Map
    noise2: float


def _tried(sample: Map, clip: float, stripes: Stripes, share: float | None) -> _Trial:
    sweep = _sweep(stripes, share)
    found = _measure(sample, clip, sweep, 0, sample.shape[1])
    lit = (found.scale > 0.25 * np.percentile(found.scale, 95)) & (found.samples > 3)
    each = found.misfit[lit] / np.maximum(found.samples[lit] - 3, 1)
    return _Trial(share, sweep, found, lit, max(_usual(each) if lit.any() else 0.0, QUANTISATION))


def calibrated(frames: Map, clip: float, stripes: Stripes, noise: Noise | None = None) -> Sweep:
    """Blur and noise from some rows; the noise as it is given, if it is."""
    sample = np.ascontiguousarray(frames[:, sampled_rows(frames.shape[1])])
    trials = [_tried(sample, clip, stripes, share) for share in _BLURS]
    least = min(trial.noise2 for trial in trials)
    alike = [k for k, trial in enumerate(trials) if trial.noise2 <= _ALIKE * least]
    nearest = alike[int(np.argmin(_left_by([trials[k] for k in alike])))]
    best = trials[nearest]
    if 1 < nearest < len(trials) - 1:
        best = _tried(sample, clip, stripes, _lowest(trials[nearest - 1 : nearest + 2]))
    return replace(best.sweep, noise=noise or _noise(sample, stripes, best.found, best.lit, best.noise2))


def _left_by(trials: list[_Trial]) -> F64:
    """Mean squared residuals of each: of the same pixels, so that it is the same noise, without those that no
    blur explains, which may see a wrong frame."""
    lit = np.logical_and.reduce([trial.lit for trial in trials])
    if not lit.any():
        return np.array([trial.noise2 for trial in trials])
    left = np.array([trial.found.misfit[lit] for trial in trials], np.float64)
    least = left.min(axis=0)
    return np.asarray(left[:, least <= _UNEXPLAINED * np.median(least)].mean(axis=1))


def _lowest(three: list[_Trial]) -> float:
    """Blur where a parabola through what they leave, over the blur's square, is lowest."""
    at = np.array([float(trial.share or 0.0) ** 2 for trial in three])
    bend, slope, _ = np.polyfit(at, _left_by(three), 2)
    return float(np.sqrt(np.clip(-slope / (2 * bend), at[0], at[-1])) if bend > 0 else np.sqrt(at[1]))


def _usual(squares: Map) -> float:
    """Mean of squared residuals, from their quartiles: some pixels see two places, or another sweep.

    Cube roots of chi squared are normal (Wilson & Hilferty): mean 1 - x^2, sigma x = sqrt(2 / (9 freedom)).
    """
    low, middle, high = np.cbrt(np.quantile(squares, (0.25, 0.5, 0.75)))
    spread = max((high - low) / (2 * 0.6745 * max(middle, 1e-12)), 1e-6)
    x = (np.sqrt(1 + 4 * spread**2) - 1) / (2 * spread)
    return float((middle / (1 - x**2)) ** 3)


def _noise(sample: Map, stripes: Stripes, found: StripeFit, lit: Map, noise2: float) -> Noise:
    """Of the levels: noise2 where a stripe passed, and what the frames show long before and after that. Where
    they do not, more than quantisation grows with the light: sigma is rather too large.
    """
    away = np.abs(stripes.at[:, None, None] - found.coord) > _AWAY * stripes.width
    count = np.count_nonzero(away, axis=0)
    known = lit & (count >= _FRAMES)
    dark, spread = found.offset[lit], QUANTISATION
    if np.count_nonzero(known) >= _FEWEST:
        levels = sample[stripes.index][:, known].astype(np.float64)
        away, count = away[:, known], count[known]
        dark = np.sum(levels, axis=0, where=away) / count
        squares = np.sum((levels - dark) ** 2, axis=0, where=away) / (count - 1)
        spread = max(_usual(squares), QUANTISATION)
        lit = known
    more = noise2 - spread
    if not lit.any() or abs(more) < _SAME * noise2:
        return Noise(noise2)
    # a response's inverse magnifies dark levels' noise, nothing else
    if more < 0 and sample.dtype.kind != "f":
        return Noise(spread)
    gain = more / max(float(np.median(found.mean[lit] - dark)), 1e-9)
    return Noise(noise2 - gain * float(np.median(found.mean[lit])), gain)


def _variance(noise: Noise, level: Map) -> Map:
    """Of samples at these levels; a response's inverse may magnify the noise of dark ones."""
    return np.maximum(noise.read2 + noise.gain * level, QUANTISATION)


def _measure(frames: Map, clip: float, sweep: Sweep, start: int, stop: int) -> StripeFit:
    def room(kind: Any = np.float32) -> Map:
        return np.empty((stop - start, frames.shape[2]), kind)

    stripes = sweep.stripes
    swept = Swept(stripes.index, stripes.at, sweep.profile, float(_PER_PX), sweep.window)
    found = StripeFit(
        coord=room(np.float64),
        curvature=room(),
        misfit=room(),
        offset=room(),
        scale=room(),
        samples=room(np.int32),
        rival=room(),
        level=room(),
        mean=room(),
    )
    stripe_rows(frames, clip, start, stop, swept, found)
    return found


def swept_alone(axis: AxisPlan) -> bool:
    """Whether swept stripes are all that was shown along an axis."""
    return axis.stripes is not None and not (axis.code or axis.fringes or axis.levels)


def stripe_step(
    frames: Map,
    clip: float,
    sweep: Sweep,
    axis: AxisPlan,
    joined: bool,
    maps: tuple[Map, Map],
    common: tuple[Map, ...],
) -> Work:
    """Work on a block of rows of a swept stripe."""

    def step(start: int, stop: int) -> None:
        found = _measure(frames, clip, sweep, start, stop)
        noise2 = _variance(sweep.noise, found.mean)
        why = flags_of_fit(
            found.curvature, found.misfit, found.scale, found.samples, found.offset, noise2, sweep.limit
        )
        odds = np.clip((found.scale**2 - np.maximum(found.rival, 0) ** 2) / (2 * noise2), 0, 80)
        wrong = 1 / (1 + np.exp(odds))
        why |= np.where((wrong > _DOUBT) | (found.rival > 0.6 * found.scale), _ORDER, 0)
        lost, shift = _border(found.coord, axis.extent, sweep.blur)
        why |= np.where(lost > MOST_LOST, _OFF, 0)
        with np.errstate(divide="ignore"):
            variance = _variance(sweep.noise, found.level) / found.curvature + shift**2
        store(
            *(start, stop, found.coord, variance, why, wrong, found.scale, found.offset),
            *(axis, joined, maps, common),
        )

    return step


def _border(coord: Map, extent: int, blur: float) -> tuple[Map, Map]:
    """Share of a pixel's light that falls beyond the border, and how far that moves the rest (pattern px).

    With d to the border: lost = Q(d / b), moved by b phi(d / b) / (1 - lost).
    """
    inside = (0.5 * extent - np.abs(coord - 0.5 * (extent - 1))) / blur
    lost = ndtr(-inside)
    moved = blur * np.exp(-0.5 * inside**2) / np.sqrt(2 * np.pi) / np.maximum(1 - lost, 0.5)
    return lost, moved


def sweep_faults(
    frames: Map, clip: float, stripes: Stripes, extent: int
) -> tuple[str, tuple[int, ...]] | None:
    """What happened to a sweep over `extent` cells (replaced | swapped | lost | repeated), and to which.

    Of `lost` and `repeated` the first frame is the one from which on all are in wrong places. None: nothing.
    """
    sweep = calibrated(frames, clip, stripes)
    sample = np.ascontiguousarray(frames[:, sampled_rows(frames.shape[1])])

    def misfits(trial: Stripes) -> tuple[Map, Map]:
        found = _measure(sample, clip, replace(sweep, stripes=trial), 0, sample.shape[1])
        lit = found.scale > 0.25 * np.percentile(found.scale, 95)
        # at the border, light is missing whatever was shown
        lit &= _border(found.coord, extent, sweep.blur)[0] <= MOST_LOST
        noise2 = _variance(sweep.noise, found.mean)
        return found.coord, np.where(lit, np.minimum(found.misfit / (sweep.limit * noise2), 4.0), 0.0)

    coord, misfit = misfits(stripes)
    slot = np.searchsorted(stripes.at, coord)
    pixels = np.bincount(slot.ravel(), minlength=len(stripes.at) + 1)
    bad = np.bincount(slot.ravel(), (misfit > 1).ravel(), len(stripes.at) + 1)
    suspect = np.flatnonzero((bad > _SUSPECT * pixels) & (bad >= _FEWEST))
    if len(suspect) == 0:
        return None
    near = (slot >= suspect[0] - 2) & (slot <= suspect[-1] + 2)
    before = float(np.maximum(misfit[near] - 0.5, 0).sum())
    tried = [
        (float(np.maximum(misfits(trial)[1][near] - 0.5, 0).sum()), kind, index)
        for kind, index, trial in _trials(stripes, max(suspect[0] - 2, 0), suspect[-1] + 2)
    ]
    left, kind, index = min(tried, key=lambda trial: trial[0])
    return (kind, index) if left < _LEFT * before else None


def _trials(stripes: Stripes, low: int, high: int) -> Iterator[tuple[str, tuple[int, ...], Stripes]]:
    """Single faults of the frames low..high in the order of their places, and the sweep as it was then."""
    index, at = stripes.index, stripes.at
    last = len(at) - 1
    for k in range(low, min(high, last) + 1):
        yield "replaced", (int(index[k]),), replace(stripes, index=np.delete(index, k), at=np.delete(at, k))
        if k < last:
            swapped = index.copy()
            swapped[[k, k + 1]] = index[[k + 1, k]]
            yield "swapped", (int(index[k]), int(index[k + 1])), replace(stripes, index=swapped)
            early = np.append(at[k + 1 :], 2 * at[-1] - at[-2])
            yield "lost", (int(index[k]),), replace(stripes, at=np.concatenate([at[:k], early]))
            late = np.delete(index, k + 1)
            yield "repeated", (int(index[k + 1]),), replace(stripes, index=late, at=at[:-1])
