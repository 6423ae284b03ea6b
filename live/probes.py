"""Probes: the height of single cells over time, and its amplitude spectrum.

One cell each: noise is common to neighbours, so that their mean gains little. A camera that trembles moves
the whole picture, which reads as height. So a trace is offered in three ways (TRACES): raw; steady, less what
the shift and roll of the whole picture, measured in that frame, do to the height, which also takes off a
mirror that sinks or tilts as a whole; difference, raw less the first probe's, which takes off what both have
in common."""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from optolever.errors import InputError

from .reading import Reading
from .rest.prepared import Prepared
from .spectrum import Spectrum, spectrum_of

__all__ = ["TRACES", "Probe", "Probed", "Probes", "noise_floor"]

#: Ways in which a trace is offered, and their names.
TRACES = {"raw": "raw", "steady": "less the picture's shift", "difference": "less probe 1"}
_KEPT = 1 << 14  # frames


@dataclass(frozen=True, slots=True)
class Probed:
    """One cell in one frame: x, y, z, mm; z: from the picture as it is; steady: less the effect of the
    picture's shift and roll; None where the height is not measured or trusted; sigma: of the noise from frame
    to frame."""

    x: float
    y: float
    z: float | None
    steady: float | None
    sigma: float | None


class Probe:
    """The heights of one cell over time."""

    def __init__(self, row: int, col: int, x: float, y: float) -> None:
        self.row, self.col, self.x, self.y = row, col, x, y
        self._frames: deque[tuple[float, float, float, float]] = deque(maxlen=_KEPT)

    def read(self, reading: Reading, number: int | None = None) -> Probed:
        """Take the height of a frame. number: the camera's, None without."""
        at = self.row, self.col
        measured = reading.trusted and bool(reading.good[at])
        steady, moved = (float(part[at]) if measured else math.nan for part in (reading.z, reading.moved))
        counter = math.nan if number is None else float(number)
        self._frames.append((reading.time, steady - moved, steady, counter))
        if not measured:
            return Probed(self.x, self.y, None, None, None)
        return Probed(self.x, self.y, steady - moved, steady, float(reading.noise[at]))

    def spectrum(
        self, exposure_s: float, seconds: float = math.inf, trace: str = "raw", first: "Probe | None" = None
    ) -> Spectrum | None:
        """Amplitude spectrum of the last `seconds` of a trace, one of TRACES; first: the probe that is
        subtracted in a difference. None of too few frames."""
        if not self._frames or (trace == "difference" and first in (None, self)):
            return None
        times, raw, steady, numbers = np.array(self._frames).T
        heights = steady if trace == "steady" else raw
        if trace == "difference" and first is not None:
            both = min(len(first._frames), times.size)
            times, numbers = times[-both:], numbers[-both:]
            heights = raw[-both:] - np.array(first._frames)[-both:, 1]
        last = times > times[-1] - seconds
        counted = bool(np.isfinite(numbers[last]).all())
        return spectrum_of(times[last], heights[last], exposure_s, numbers[last] if counted else None)


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

    def spectra(self, seconds: float = math.inf, trace: str = "raw") -> list[Spectrum | None]:
        """Amplitude spectra of a trace, one of TRACES, of all probes over the last `seconds`; of a difference
        the first probe has none. InputError of another trace."""
        if trace not in TRACES:
            raise InputError(f"trace: {trace!r}, must be one of {', '.join(TRACES)}")
        return [probe.spectrum(self.exposure_s, seconds, trace, self.each[0]) for probe in self.each]


def noise_floor(prepared: Prepared, rate: float) -> tuple[float, float]:
    """Noise of the height of a typical cell: mm a frame, and mm / sqrt(Hz) at so many frames a second."""
    sigma = float(np.median(prepared.noise.sigma[prepared.rig.lit]))
    return sigma, sigma * math.sqrt(2 / rate) if rate > 0 else math.nan
