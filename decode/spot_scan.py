"""A spot at a raster of places: summed over rows of the raster a stripe swept along u, over columns one along
v.

The frames of a spot are products, so that a pixel's light is A f(v - row) g(u - column) + B: the sum over any
rows of the raster is a stripe's sweep. They are those around the pixel's brightest frame, as the others hold
nothing but noise; a sum of n samples has n times the variance of one, and n times the offset.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.patterns import Frame, Sequence

from .estimate import Estimate
from .frames import Light
from .noise import Noise
from .spot_kernels import sum_rows

__all__ = ["Raster", "Sums", "one_spot", "raster_of", "sums_of"]

#: Fewest places along an axis, as for stripes.
_FEWEST = 5
#: Share of the spot's light that another place has to show to be another answer, as for stripes.
_RIVAL = 0.6


@dataclass(frozen=True, slots=True, eq=False)
class Raster:
    """index (R, C): frames at places at_v (R,) and at_u (C,), ascending; width of the spot, pattern px."""

    index: NDArray[np.int64]
    at_u: NDArray[np.float64]
    at_v: NDArray[np.float64]
    width: float

    @property
    def steps(self) -> float:
        """Width of the spot in steps of the raster, the mean of both axes: what the profile adds up to."""
        return self.width * float(np.mean([1 / np.median(np.diff(at)) for at in (self.at_u, self.at_v)]))

    @property
    def half(self) -> int:
        """Places on either side of the brightest one that are summed: those that the spot still lights."""
        most = (min(len(self.at_v), len(self.at_u)) - 1) // 2
        return min(max(1, int(np.ceil(self.steps)) - 1), most)

    @property
    def summed(self) -> int:
        """Samples in a sum."""
        return 2 * self.half + 1

    def stripes(self, sequence: Sequence) -> Sequence:
        """The sweeps that the sums are: first along u, then along v."""
        along = [Frame("stripe", "u", width_px=self.width, at_u=float(at)) for at in self.at_u]
        down = [Frame("stripe", "v", width_px=self.width, at_v=float(at)) for at in self.at_v]
        return replace(sequence, frames=(*along, *down))


def raster_of(sequence: Sequence) -> Raster | None:
    """The raster that a sequence's spots make, in any order; None: it shows no spots. White and black may be
    there, too. InputError where places are missing or twice, or other codes are shown besides."""
    spots = [i for i, frame in enumerate(sequence.frames) if frame.kind == "stripe" and frame.axis == "uv"]
    if not spots:
        return None
    name = f"sequence {sequence.name}"
    for i, frame in enumerate(sequence.frames):
        if frame.axis in ("u", "v"):
            raise InputError(f"{name}: frames[{i}] is {frame.kind} on {frame.axis}, spots stand alone")
        if frame.exposure != 1.0:
            raise InputError(
                f"{name}: frames[{i}]: exposure is {frame.exposure:g}, must be 1 but for fringes"
            )
    widths = {sequence.frames[i].width_px or 1.0 for i in spots}
    if len(widths) > 1:
        raise InputError(f"{name}: spots are {sorted(widths)} px wide, must be alike")
    at_u, column = np.unique([sequence.frames[i].at_u or 0.0 for i in spots], return_inverse=True)
    at_v, row = np.unique([sequence.frames[i].at_v or 0.0 for i in spots], return_inverse=True)
    index = np.full((len(at_v), len(at_u)), -1, np.int64)
    index[row, column] = spots
    if min(index.shape) < _FEWEST or index.min() < 0 or index.size != len(spots):
        raise InputError(
            f"{name}: {len(spots)} spots are at {len(at_v)} x {len(at_u)} places along v and u, must be at "
            f"every place once and at {_FEWEST} or more along each"
        )
    return Raster(index, at_u, at_v, widths.pop())


@dataclass(frozen=True, slots=True, eq=False)
class Sums:
    """The two sweeps as frames (C + R, rows, W) float32, for lookup.prepare and lookup_rows;
    rival (rows, W): the brightest sample far from the brightest place, linear levels."""

    light: Light
    rival: NDArray[np.float32]

    def noise(self, noise: Noise, raster: Raster) -> Noise:
        """Of a sum of samples, from that of one: read noise of each, gain on the sum of their levels."""
        return replace(noise, read2=noise.read2 * raster.summed)

    def single(self, noise: Noise, raster: Raster) -> Noise:
        """Of one sample, from that of a sum."""
        return replace(noise, read2=noise.read2 / raster.summed)


def sums_of(light: Light, raster: Raster, rows: tuple[int, int]) -> Sums:
    """Sums over the raster's rows and columns around each pixel's brightest frame, of rows start..stop."""
    start, stop = rows
    count, width = sum(raster.index.shape), light.raw.shape[2]
    sums = np.empty((count, stop - start, width), np.float32)
    rival = np.empty((stop - start, width), np.float32)
    # out of reach of sums without a saturated sample
    full = raster.summed * max(light.white, float(light.table.max(initial=0.0))) + 1
    if not np.isfinite(full):
        full = float(np.finfo(np.float32).max)
    away = max(2, int(np.ceil(1.5 * raster.steps)))

    sum_rows(
        *(light.raw, light.table, np.float32(light.clip), np.float32(full), start, stop),
        *(raster.index, raster.half, away, sums, rival),
    )
    summed = Light(sums, full, np.zeros(0, np.float32), 0.0)
    return Sums(summed, rival)


def one_spot(estimate: Estimate, sums: Sums, raster: Raster, rows: tuple[int, int]) -> None:
    """Levels of a sweep's sums -> levels of the frames, in place; a second bright place raises the
    probability of another answer. rows: of the sums that the estimate has."""
    dark = (estimate.offset - estimate.amplitude) / np.float32(raster.summed)
    estimate.amplitude[:] /= np.float32(raster.steps)
    estimate.offset[:] = dark + estimate.amplitude
    rival: NDArray[Any] = sums.rival[rows[0] : rows[1]] - dark
    bright = 2 * estimate.amplitude
    doubt = np.where(rival > _RIVAL * bright, rival / np.maximum(rival + bright, 1e-6), 0.0)
    estimate.error[:] = np.maximum(estimate.error, doubt.astype(np.float32))
