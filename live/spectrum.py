"""Amplitude spectrum of a height over time, by least squares on the times as they are: frames may be missing.

Lines are found one after the other, the strongest over the floor around it first, fitted together with the
drift, and taken off (the periodogram of gaps would spread each over all frequencies); the floor is that of
what is left. Frames between which the height moves as by a press are left out, and the drift is a cubic of
its own before and after. A height is the mean over its exposure T, which lowers a vibration of f by
sin(pi f T) / (pi f T); times that scatter by s about a steady rate by exp(-2 pi^2 f^2 s^2): both are undone.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optolever.arrays import Floats, Mask

__all__ = ["Line", "Spectrum", "spectrum_of"]

_FINE = 4  # points of the spectrum in a bin of 1 / duration
_FEWEST = 16  # frames of a spectrum
_LEAST_SINC = 0.1  # beyond, the exposure has averaged a vibration away
_LINES = 8  # at most
_CLEAR = 5.0  # times the floor around it: noise alone reaches it once in 1e4 spectra
_AROUND = 65  # bins of that floor
_SLOWEST = 2  # periods of a line in the duration, at least
_DRIFT = 4  # terms of a cubic
_LAG_S = 0.25  # over which a move is looked for
_MOVE = 10.0  # times the usual change over that lag: a steady vibration or noise stays below 5
_REGULAR = 0.1  # of a period: steps that are whole within that are counted
_STEADY = 3.7  # over sqrt(N): times without a rate reach it once in a thousand
_REFINED = 2  # steps of the frequencies after each new line
_Complex = NDArray[np.complex64]


@dataclass(frozen=True, slots=True)
class Line:
    """A vibration: hz, amplitude (mm), each with sigma; folds: frequencies, Hz, below one and a half times
    the frame rate, whose samples are those of hz (aliases)."""

    hz: float
    hz_sigma: float
    amplitude: float
    sigma: float
    folds: tuple[float, ...] = ()

    def __str__(self) -> str:
        nm, sigma = 1e6 * self.amplitude, 1e6 * self.sigma
        digits = min(9, max(0, 1 - math.floor(math.log10(sigma)))) if sigma > 0 else 2
        others = ", or " + ", ".join(f"{hz:.2f}" for hz in self.folds) if self.folds else ""
        return f"{nm:.{digits}f} ± {sigma:.{digits}f} nm at {self.hz:.2f} Hz{others}"


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """Amplitudes (n,), mm, of vibrations at frequencies (n,), Hz, four to a bin, with the lines as
    peaks; NaN where the exposure hides them. lines: the strongest first. floor: median of the bins without
    the lines, mm; rate: frames a second that were taken, jitter: scatter of the times about it, s (NaN: no
    steady rate); seconds: duration; moving: s of it, left out because the height moved as by a press."""

    frequencies: Floats
    amplitudes: Floats
    lines: tuple[Line, ...]
    floor: float
    rate: float
    jitter: float
    seconds: float
    moving: float

    @property
    def peak(self) -> tuple[float, float]:
        """Frequency, Hz, and amplitude, mm, of the strongest line; without one, of the largest bin of two
        periods and more."""
        if self.lines:
            return self.lines[0].hz, self.lines[0].amplitude
        slow = self.frequencies * self.seconds < _SLOWEST
        at = int(np.nanargmax(np.where(slow, np.nan, self.amplitudes)))
        return float(self.frequencies[at]), float(self.amplitudes[at])

    @property
    def density(self) -> float:
        """The floor as density of white noise, mm / sqrt(Hz): a bin of 1 / T has a median amplitude of
        density sqrt(2 ln 2 / T)."""
        return self.floor * math.sqrt(self.seconds / (2 * math.log(2)))

    def __str__(self) -> str:
        parts = [str(line) for line in self.lines[:3]] or ["no line"]
        if math.isnan(self.jitter):
            parts.append("the times have no steady rate: amplitudes are lower bounds")
        parts += [f"floor {1e6 * self.floor:.3g} nm, resolution {1 / self.seconds:.2g} Hz"]
        return "; ".join(parts + [f"{self.moving:.1f} s of motion left out"] * (self.moving > 0))

    def to_dict(self) -> dict[str, Any]:
        """Plain values: figures, and the largest amplitude of every bin."""
        hertz, peak = self.peak
        bins = self.amplitudes[: self.amplitudes.size // _FINE * _FINE].reshape(-1, _FINE)
        nanometres = np.nan_to_num(1e6 * bins.max(axis=1)).round(3)
        numbers = [(one.hz, one.hz_sigma, 1e6 * one.amplitude, 1e6 * one.sigma) for one in self.lines]
        lines = [dict(zip(("hz", "hz_sigma", "nm", "nm_sigma"), one, strict=True)) for one in numbers]
        return {
            "text": str(self),
            "lines": [a | {"folds": list(b.folds)} for a, b in zip(lines, self.lines, strict=True)],
            "peak_hz": hertz,
            "peak_nm": 1e6 * peak,
            "floor_nm": 1e6 * self.floor,
            "density_nm": 1e6 * self.density,
            "rate_hz": self.rate,
            "seconds": self.seconds,
            "step_hz": 1 / self.seconds,
            "moving_s": self.moving,
            "nm": nanometres.tolist(),
        }


def spectrum_of(
    times: ArrayLike, heights: ArrayLike, exposure_s: float = 0.0, numbers: ArrayLike | None = None
) -> Spectrum | None:
    """Amplitude spectrum of heights over time. times (n,), s, rising; heights (n,), mm, NaN: none;
    exposure_s: of a frame; numbers (n,): of the camera's counter, by which a steady camera's times are the
    line through `times`. None of too few frames."""
    t, z = np.asarray(times, np.float64), np.asarray(heights, np.float64)
    if numbers is not None and t.size >= _FEWEST:
        t = _by_counter(t, np.asarray(numbers, np.float64))
    known = np.isfinite(z)
    t, z = t[known], z[known]
    if t.size < _FEWEST or not t[-1] > t[0]:
        return None
    rate, jitter = _rate(t)
    seconds, lag = float(t[-1] - t[0]) + 1 / rate, max(2, round(_LAG_S * rate))
    t = t - 0.5 * (t[0] + t[-1])
    moves = _moves(z, lag)
    fit = _fit(t, z, moves, seconds, rate / 2)
    again = _moves(z - fit.waves(t), lag)
    if (again != moves).any():
        moves = again
        fit = _fit(t, z, moves, seconds, rate / 2)
    f = fit.tables.frequencies
    sinc, blur = np.abs(np.sinc(f * exposure_s)), 2 * (math.pi * np.nan_to_num(jitter)) ** 2
    passed = np.where(sinc > _LEAST_SINC, sinc, np.nan) * np.exp(-blur * f**2)
    around, shown, lines = _floor_around(fit.spread), fit.spread, []
    for k, hz in enumerate(fit.place):
        at = round(hz * seconds * _FINE)
        if not _SLOWEST * _FINE <= at < f.size or np.isnan(passed[at]):
            continue
        noise = float(around[at]) * math.sqrt(fit.used / (4 * math.log(2)))  # of a frame, as around the line
        size, size_sigma, hz_sigma = fit.line(k, noise)
        folds = () if math.isnan(jitter) else _folds(float(hz), rate, exposure_s)
        share = float(passed[at])
        lines.append(Line(float(hz), hz_sigma, size / share, size_sigma / share, folds))
        near = np.clip((f - hz) * seconds, -1, 1)
        shown = np.maximum(shown, size * np.cos(0.5 * math.pi * near) ** 2)
    lines.sort(key=lambda line: -line.amplitude)
    floor, moving = float(np.nanmedian((around / passed)[_FINE:])), float(np.mean(moves)) * seconds
    return Spectrum(f, shown / passed, tuple(lines), floor, rate, jitter, seconds, moving)


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Lines at place (m,), Hz; slopes (3, m): cosine, sine, last change of place; gram: normal equations,
    three columns a line at their end; spread: spectrum of what is left; used: frames."""

    place: Floats
    slopes: Floats
    gram: Floats
    tables: "_Tables"
    spread: Floats
    used: int

    def waves(self, t: Floats) -> Floats:
        """Sum of the lines at times (n,)."""
        turns = 2 * math.pi * np.outer(t, self.place)
        return np.asarray(np.cos(turns) @ self.slopes[0] + np.sin(turns) @ self.slopes[1])

    def line(self, k: int, noise: float) -> tuple[float, float, float]:
        """Amplitude of a line, its sigma and that of the frequency, by the noise of a frame."""
        (a, b), base = self.slopes[:2, k], self.gram.shape[0] - 3 * (self.place.size - k)
        of = noise**2 * np.linalg.pinv(self.gram, hermitian=True)[base : base + 3, base : base + 3]
        size = float(np.hypot(a, b))
        variance = float(np.array([a, b]) @ of[:2, :2] @ np.array([a, b])) / max(size, 1e-300) ** 2
        return size, math.sqrt(max(variance, 0.0)), math.sqrt(max(float(of[2, 2]), 0.0))


def _fit(t: Floats, z: Floats, moves: Mask, seconds: float, highest: float) -> _Fit:
    """Lines of the frames that do not move, found one after the other."""
    part = np.cumsum(np.diff(moves.astype(np.int64), prepend=0) < 0)[~moves]
    t, z = t[~moves], z[~moves]
    tables, drift = _Tables(t, seconds, highest), _drift(t, part)
    place: Floats = np.zeros(0)
    left, slopes, gram = _fitted(t, z, drift, place)
    spread, first = tables.spectrum(left), _SLOWEST * _FINE
    while place.size < _LINES and spread.size > first:
        ratio = spread[first:] / np.maximum(_floor_around(spread)[first:], 1e-300)
        if not ratio.max() > _CLEAR:
            break
        place = np.append(place, tables.frequencies[first + int(ratio.argmax())])
        for step in range(_REFINED + 1):
            left, slopes, gram = _fitted(t, z, drift, place)
            if step < _REFINED:
                place = place + np.clip(slopes[2], -0.5 / seconds, 0.5 / seconds)
        spread = tables.spectrum(left)
    return _Fit(place, slopes, gram, tables, spread, t.size)


def _by_counter(t: Floats, number: Floats) -> Floats:
    """The line through the times where they scatter by less than a period about it, else the times."""
    if not (np.diff(number) > 0).all():
        return t
    line = np.polynomial.Polynomial.fit(number, t, 1)
    steady, period = line(number), float(line.convert().coef[-1])
    return np.asarray(steady) if np.std(steady - t) < period else t


class _Tables:
    """exp(-2 pi i f t) of a grid of frequencies f = k / (fine seconds) as products of two small tables."""

    def __init__(self, t: Floats, seconds: float, highest: float, lowest: float = 0.0, fine: int = _FINE):
        step = 1 / (fine * seconds)
        count = max(2, int((highest - lowest) / step) + 1)
        self._side, self._size = math.isqrt(count) + 1, t.size
        self.frequencies: Floats = lowest + step * np.arange(count, dtype=np.float64)
        self._near = _powers(np.zeros(t.size), step * t, self._side)
        self._far = _powers(lowest * t, step * self._side * t, -(-count // self._side))

    def spectrum(self, z: Floats) -> Floats:
        """Amplitudes of values at the times."""
        scale = max(float(np.abs(z).max()), 1e-300)
        sums = (self._far * (z / scale).astype(np.float32)) @ self._near.T
        sizes = np.abs(sums.ravel()[: self.frequencies.size])
        return np.asarray(sizes, np.float64) * (2 * scale / self._size)


def _powers(first: Floats, each: Floats, count: int) -> _Complex:
    """exp(-2 pi i (first + k each)) (count, n), by products: a sine takes ten times longer."""
    factor = np.exp(-2j * math.pi * each)
    table = np.empty((count, first.size), np.complex128)
    table[0] = np.exp(-2j * math.pi * first)
    for k in range(1, count):
        np.multiply(table[k - 1], factor, out=table[k])
    return table.astype(np.complex64)


def _rate(t: Floats) -> tuple[float, float]:
    """Frames a second of a steady camera, of which some may be missing, and how far the times scatter about
    it, s: exp(2 pi i f t) of a steady rate f has a mean of exp(-2 pi^2 f^2 jitter^2). NaN: there is none."""
    steps, duration = np.diff(t), float(t[-1] - t[0])
    least, usual = float(np.quantile(steps, 0.1)), float(np.median(steps))
    taken = np.rint(steps / max(least, 1e-12))
    if least > 0 and np.abs(steps - taken * least).max() < _REGULAR * least:
        number = np.concatenate([[0], np.cumsum(taken)])
        line = np.polynomial.Polynomial.fit(number, t, 1)
        return 1 / float(line.convert().coef[1]), float(np.std(t - line(number)))
    tables = _Tables(t - t[0], duration, 2.2 / usual, 0.7 / usual, 2)
    comb = 0.5 * tables.spectrum(np.ones(t.size))
    at = int(np.flatnonzero(comb > 0.8 * comb.max())[0])
    while at + 1 < comb.size and comb[at + 1] > comb[at]:
        at += 1
    close = tables.frequencies[at] + np.linspace(-0.5, 0.5, 41) / duration
    means = np.abs(np.exp(2j * math.pi * np.outer(close, t - t[0])).mean(axis=1))
    best = int(means.argmax())
    if means[best] < _STEADY / math.sqrt(t.size):
        return (t.size - 1) / duration, math.nan
    power = min(max(float(means[best] ** 2 - 1 / t.size) * t.size / (t.size - 1), 1e-12), 1.0)
    rate = float(close[best])
    return rate, math.sqrt(-math.log(power)) / (2 * math.pi * rate)


def _moves(z: Floats, lag: int) -> Mask:
    """Frames between which the height changes by far more than it does over most of the time."""
    lag = min(lag, z.size // 8)
    change = np.abs(z[lag:] - z[:-lag])
    usual = float(np.median(change))
    moved = np.zeros(z.size, bool)
    if usual > 0:
        for k in np.flatnonzero(change > _MOVE * usual):
            moved[k : k + lag + 1] = True
    edges = np.flatnonzero(np.diff(np.concatenate([[True], moved, [True]]).astype(np.int8)))
    for start, stop in edges.reshape(-1, 2):
        if stop - start < _FEWEST:
            moved[start:stop] = True
    return np.zeros(z.size, bool) if np.mean(moved) > 0.5 else moved


def _drift(t: Floats, part: NDArray[Any]) -> Floats:
    """Columns of a cubic for every part (n, 4 parts)."""
    columns = []
    for one in np.unique(part):
        inside = part == one
        low, high = float(t[inside].min()), float(t[inside].max())
        x = np.clip((2 * t - low - high) / (high - low), -1, 1)
        columns.append(np.where(inside[:, None], np.polynomial.chebyshev.chebvander(x, _DRIFT - 1), 0))
    return np.concatenate(columns, axis=1)


def _fitted(t: Floats, z: Floats, drift: Floats, place: Floats) -> tuple[Floats, Floats, Floats]:
    """Drift and lines at place (m,), Hz, fitted together: what is left (n,); cosine, sine and change of the
    frequency of the lines (3, m); the normal equations' matrix, three columns a line."""
    turns = 2 * math.pi * np.outer(t, place)
    waves = np.stack([np.cos(turns), np.sin(turns)], axis=2)
    base = np.concatenate([drift, waves.reshape(t.size, -1)], axis=1)
    found = _solved(base.T @ base, base.T @ z)
    a, b = found[drift.shape[1] :].reshape(-1, 2).T
    change = 2 * math.pi * t[:, None] * (b * waves[..., 0] - a * waves[..., 1])
    full = np.concatenate([drift, np.concatenate([waves, change[..., None]], 2).reshape(t.size, -1)], axis=1)
    gram, left = full.T @ full, z - base @ found
    steps = _solved(gram, full.T @ left)[drift.shape[1] :].reshape(-1, 3)
    return left, np.stack([a, b, steps[:, 2]]), gram


def _solved(gram: Floats, right: Floats) -> Floats:
    """Normal equations, scaled; where lines have run into one, the smallest solution."""
    scale = 1 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
    return np.asarray(scale * np.linalg.lstsq(gram * np.outer(scale, scale), right * scale, rcond=1e-10)[0])


def _floor_around(spread: Floats) -> Floats:
    """Median of the bins around every point."""
    bins = spread[_FINE::_FINE]
    if bins.size <= _AROUND:
        return np.full(spread.size, float(np.median(bins)) if bins.size else 0.0)
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(bins, _AROUND // 2, mode="reflect"), _AROUND)
    medians = np.median(windows[::_FINE], axis=1)
    return np.interp(np.arange(spread.size) / _FINE**2, np.arange(medians.size) + 1 / _FINE, medians)


def _folds(hz: float, rate: float, exposure_s: float) -> tuple[float, ...]:
    """What a rate does not tell from hz, and the exposure lets through."""
    others = (rate - hz, rate + hz, 2 * rate - hz)
    return tuple(f for f in others if abs(np.sinc(f * exposure_s)) > _LEAST_SINC and f < 1.5 * rate)
