"""Probes: the height of single cells over time, and its amplitude spectrum.

One cell each: noise is common to neighbours, so that their mean gains little. A camera takes frames at a
steady rate while their times of arrival scatter: the grid is that of the frames' numbers; frames that are
lost stay out of it. A height is the mean over its exposure T, which lowers a vibration of f by
sin(pi f T) / (pi f T): the spectrum is divided by it."""

import math
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.signal
from numpy.typing import ArrayLike

from optolever.errors import InputError

from .arrays import Float
from .prepared import Prepared
from .reading import Reading

__all__ = ["Probe", "Probed", "Probes", "Spectrum", "noise_floor", "spectrum_of"]

_FINE = 8  # points of the spectrum in a bin of 1 / duration: between them a line loses 0.6 % at most
_TAPERED = 0.25  # of the duration: a strong line then ends within a few bins, noise grows by 5 %
_FEWEST = 16  # frames of a spectrum
_LEAST_SINC = 0.1  # beyond, the exposure has averaged a vibration away
_KEPT = 1 << 14  # frames


@dataclass(frozen=True, slots=True)
class Probed:
    """One cell in one frame: x, y, z, mm; sigma: of the noise from frame to frame; z is None where the height
    is not measured or trusted."""

    x: float
    y: float
    z: float | None
    sigma: float | None


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """Amplitudes (n,), mm, of a height's vibrations at frequencies (n,), Hz, eight to a bin; NaN where the
    exposure hides them. floor: median of the bins, mm; rate: frames a second; seconds: duration."""

    frequencies: Float
    amplitudes: Float
    floor: float
    rate: float
    seconds: float

    @property
    def peak(self) -> tuple[float, float]:
        """Frequency, Hz, and amplitude, mm, of the strongest vibration of two periods and more."""
        slow = self.frequencies * self.seconds < 2
        at = int(np.nanargmax(np.where(slow, np.nan, self.amplitudes)))
        return float(self.frequencies[at]), float(self.amplitudes[at])

    @property
    def density(self) -> float:
        """The floor as density of white noise, mm / sqrt(Hz): a bin of 1 / T has a median amplitude of
        density sqrt(2 ln 2 / T)."""
        return self.floor * math.sqrt(self.seconds / (2 * math.log(2)))

    def to_dict(self) -> dict[str, Any]:
        """Plain values: figures, and the largest amplitude of every bin."""
        hertz, peak = self.peak
        bins = self.amplitudes[: self.amplitudes.size // _FINE * _FINE].reshape(-1, _FINE)
        nanometres = np.nan_to_num(1e6 * bins.max(axis=1)).round(3)
        return {
            "peak_hz": hertz,
            "peak_nm": 1e6 * peak,
            "floor_nm": 1e6 * self.floor,
            "density_nm": 1e6 * self.density,
            "rate_hz": self.rate,
            "seconds": self.seconds,
            "step_hz": 1 / self.seconds,
            "nm": nanometres.tolist(),
        }


def spectrum_of(
    times: ArrayLike, heights: ArrayLike, exposure_s: float = 0.0, numbers: ArrayLike | None = None
) -> Spectrum | None:
    """times (n,), s; heights (n,), mm, NaN: none; exposure_s: of a frame; numbers (n,): of the frames,
    rising; None: none is lost. Returns None of too few frames."""
    t, z = np.asarray(times, np.float64), np.asarray(heights, np.float64)
    number = np.arange(t.size) if numbers is None else np.asarray(numbers, np.int64)
    known = np.isfinite(z)
    if np.count_nonzero(known) < _FEWEST or not t[-1] > t[0]:
        return None
    place = (number - number[0])[known]
    count, rate = int(number[-1] - number[0]) + 1, float((number[-1] - number[0]) / (t[-1] - t[0]))
    drift = np.polynomial.Polynomial.fit(place, z[known], 1)
    grid = np.zeros(count)
    weight = scipy.signal.windows.tukey(count, _TAPERED)[place]
    grid[place] = weight * (z[known] - drift(place))
    lines = np.abs(np.fft.rfft(grid, _FINE * count)) * 2 / weight.sum()
    frequencies: Float = np.arange(lines.size) * rate / (_FINE * count)
    passed = np.abs(np.sinc(frequencies * exposure_s))
    lines = np.asarray(np.where(passed > _LEAST_SINC, lines / np.maximum(passed, _LEAST_SINC), np.nan))
    return Spectrum(frequencies, lines, float(np.nanmedian(lines[_FINE::_FINE])), rate, count / rate)


class Probe:
    """The heights of one cell over time."""

    def __init__(self, row: int, col: int, x: float, y: float) -> None:
        self.row, self.col, self.x, self.y = row, col, x, y
        self._frames: deque[tuple[float, float, float]] = deque(maxlen=_KEPT)

    def read(self, reading: Reading, number: int | None = None) -> Probed:
        """Take the height of a frame. number: the camera's, None without."""
        at = self.row, self.col
        measured = reading.trusted and bool(reading.good[at])
        z, sigma = float(reading.z[at]), float(reading.noise[at])
        last = self._frames[-1][2] if self._frames else -1.0
        self._frames.append(
            (reading.time, z if measured else math.nan, last + 1 if number is None else number)
        )
        return Probed(self.x, self.y, *((z, sigma) if measured else (None, None)))

    def spectrum(self, exposure_s: float, seconds: float = math.inf) -> Spectrum | None:
        """Of the last `seconds`; None: too few frames."""
        if not self._frames:
            return None
        times, heights, numbers = np.array(self._frames).T
        last = times > times[-1] - seconds
        steady = bool((np.diff(numbers[last]) > 0).all())
        return spectrum_of(times[last], heights[last], exposure_s, numbers[last] if steady else None)


class Probes:
    """The probes of a prepared rig, in the order in which they were added. exposure_s: of a frame."""

    def __init__(self, prepared: Prepared, exposure_s: float = 0.0) -> None:
        self._prepared, self.exposure_s = prepared, exposure_s
        self.each: list[Probe] = []

    def add(self, x: float, y: float) -> Probe:
        """A probe at the cell that is nearest to x, y, mm. InputError where the camera sees no mirror."""
        points, lit = self._prepared.points, self._prepared.rig.lit & ~self._prepared.rig.rim
        away = np.where(lit, np.hypot(points[0] - x, points[1] - y), np.inf)
        row, col = (int(at) for at in np.unravel_index(int(away.argmin()), away.shape))
        if not away[row, col] <= 2 * math.sqrt(self._prepared.area):
            (x0, x1), (y0, y1) = ((float(part[lit].min()), float(part[lit].max())) for part in points[:2])
            raise InputError(
                f"probe {x:g},{y:g}: must be on the part of the mirror that the camera sees, "
                f"x {x0:.3g} to {x1:.3g} mm, y {y0:.3g} to {y1:.3g} mm"
            )
        probe = Probe(row, col, float(points[0, row, col]), float(points[1, row, col]))
        self.each.append(probe)
        return probe

    def read(self, reading: Reading, number: int | None = None) -> tuple[Probed, ...]:
        """All of them in one frame."""
        return tuple(probe.read(reading, number) for probe in self.each)

    def spectra(self, seconds: float = math.inf) -> list[Spectrum | None]:
        """Of all of them, of the last `seconds`."""
        return [probe.spectrum(self.exposure_s, seconds) for probe in self.each]


def noise_floor(prepared: Prepared, rate: float) -> tuple[float, float]:
    """Noise of the height of a typical cell: mm a frame, and mm / sqrt(Hz) at so many frames a second."""
    sigma = float(np.median(prepared.noise.sigma[prepared.rig.lit]))
    return sigma, sigma * math.sqrt(2 / rate) if rate > 0 else math.nan
