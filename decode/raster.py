"""A spot at a raster of places: summed over its rows a stripe swept along u, over its columns one along v.

The frames of a spot are products, so that a pixel's light is A f(v - row) g(u - column) + B: the sum over any
rows of the raster is a stripe's sweep, whichever rows these are. They are those around the pixel's brightest
frame, as the others hold nothing but noise. Lost and doubled frames: see raster_faults.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.blocks import over_rows
from optolever.errors import InputError
from optolever.patterns import Frame, Sequence

from .correspondence import Correspondence, Flag
from .raster_faults import raster_faults
from .raster_kernels import raster_rows

__all__ = ["Raster", "by_raster", "raster_of"]

Map = NDArray[Any]
#: Decode stripes: frames, sequence, white level, variance of a sum over that of a sample.
Decode = Callable[[Map, Sequence, float, int], Correspondence]
#: Fewest places along an axis, as for stripes.
_FEWEST = 5
#: Share of the spot's light that another place has to show to be another answer, as for stripes.
_RIVAL = 0.6


@dataclass(frozen=True, slots=True)
class Raster:
    """index (R, C): frames at places at_v (R,) and at_u (C,), ascending; width of the spot, px."""

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

    def touched(self, v: NDArray[Any], rows: tuple[int, int] | None) -> NDArray[np.bool_]:
        """Pixels that look, by their coordinate, at these rows of the raster, first to last; None: all."""
        if rows is None:
            return np.ones(v.shape, np.bool_)
        low, high = self.at_v[rows[0]], self.at_v[min(rows[1], len(self.at_v) - 1)]
        return np.asarray(~((v < low) | (v > high)))

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


def by_raster(
    stack: Map, sequence: Sequence, raster: Raster, clip: float, lut: NDArray[np.float32], decode: Decode
) -> Correspondence:
    """Correspondence of a raster of spots; lut: linear level of each raw one, empty: levels are linear."""
    _, height, width = stack.shape
    rows, cols = raster.index.shape
    sums = np.empty((cols + rows, height, width), np.float32)
    other = np.empty((height, width), np.float32)
    # out of reach of sums without a clipped sample
    full = raster.summed * max(clip, float(lut.max(initial=0.0))) + 1
    away = max(2, int(np.ceil(1.5 * raster.steps)))

    def block(start: int, stop: int) -> None:
        raster_rows(
            *(stack, lut, clip, full, start, stop, raster.index, raster.half, away),
            *(sums[:cols], sums[cols:], other),
        )

    over_rows(block, height, 8)
    found = decode(sums, raster.stripes(sequence), full, raster.summed)
    assert found.amplitude is not None
    assert found.offset is not None
    amplitude = found.amplitude / np.float32(raster.steps)
    offset = amplitude + (found.offset - found.amplitude) / np.float32(raster.summed)
    rival = other - (offset - amplitude) > 2 * _RIVAL * amplitude
    flags = found.flags | np.where(rival, np.uint16(Flag.ORDER_DOUBTFUL), np.uint16(0))
    fault = raster_faults(stack, raster.index, raster.half)
    if fault is not None:
        flags |= np.where(raster.touched(found.v, fault.rows), np.uint16(Flag.WRONG_FRAME), np.uint16(0))
    return replace(found, flags=flags, amplitude=amplitude, offset=offset)
