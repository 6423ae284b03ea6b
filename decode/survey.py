"""Some rows, decoded before the rest: how large a pixel's footprint is, whether neighbours are such."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.blocks import over_rows
from optolever.memory import roomy_empty
from optolever.patterns import Sequence

from .correspondence import Flag
from .job import Job
from .noise import Noise
from .plan import AxisPlan, Plan
from .rows import Maps, axes_step, near_of
from .sample import quantile

__all__ = ["SPOILT", "Survey", "is_continuous", "survey"]

Map = NDArray[Any]
#: Rows at most, distance of the rows between which the gradient is taken, rows of a block.
_ROWS, _APART, _BLOCK = 16, 2, 8
#: Flags of pixels whose contrast tells nothing; columns that tell the usual one, about.
SPOILT = int(Flag.SATURATED | Flag.DARK | Flag.LOW_CONTRAST | Flag.MOVED | Flag.INVALID)
_COLUMNS = 144
#: Differences that the footprint's median is taken of, about.
_FOOTPRINTS = 4096
#: Second differences that are looked at in a row.
_BENDS = 64
#: Median second difference of a map whose neighbours tell nothing of each other, pattern pixels, and over
#: the median gradient: of places by chance 3.7, of a steep map misread by its footprint 1.
_BENT, _ROUGH = 2.0, 2.0


@dataclass(frozen=True)
class Survey:
    """Frames (N, 2 R, W) and maps of R rows and, behind them, of those `apart` rows below; clip: level at
    which frames clip, noise: of the (linear) levels."""

    frames: Map
    maps: Maps
    apart: int
    clip: float
    noise: Noise

    def lines(self, name: str) -> Map:
        """Coordinates (R, W)."""
        return self.maps.coord[name][: len(self.maps.flags) // 2]

    @property
    def flags(self) -> Map:
        """Flags (R, W)."""
        return self.maps.flags[: len(self.maps.flags) // 2]

    def below(self, name: str) -> Map:
        """Coordinates of the rows `apart` further on (R, W)."""
        return self.maps.coord[name][len(self.maps.flags) // 2 :]

    def footprint(self, name: str) -> float:
        """Median extent of a camera pixel in pattern cells, along both sides; at most 8."""
        lines, below = self.lines(name), self.below(name)
        step = max(1, lines.size // _FOOTPRINTS)
        down = (below[:, ::step] - lines[:, ::step]) / max(self.apart, 1)
        total = 0.0
        for change in (lines[:, 1::step] - lines[:, :-1:step], down):
            size = np.abs(change)
            sure = size[size < np.inf]
            total += quantile(sure, 0.5) if len(sure) else 0.0
        return min(total, 8.0)

    @cached_property
    def usual_levels(self) -> tuple[float, float]:
        """Amplitude and offset, medians of some pixels that are seen well (if there are such)."""
        step = max(1, self.flags.shape[1] // _COLUMNS)
        use = self.flags[:, ::step] & SPOILT == 0
        if not use.any():
            step, use = 1, self.flags & SPOILT == 0
        amplitude, offset = (quantile(chart[: len(use), ::step][use], 0.5) for chart in self.maps.common[1:3])
        return amplitude, offset

    def is_continuous(self, name: str) -> bool:
        """Whether neighbours look at neighbouring places, so that they tell something of each other."""
        return is_continuous(self.lines(name), self.maps.sigma[name][: len(self.flags)])


def survey(job: Job, sequence: Sequence, wanted: Plan, axes: tuple[AxisPlan, ...], *, few: bool) -> Survey:
    """Decode some rows of bits and fringes; few: half of them."""
    height, width = job.frames.shape[1:]
    apart = min(_APART, height - 1)
    count = _ROWS // 2 if few else _ROWS
    rows = np.unique(np.linspace(0, height - 1 - apart, count).astype(np.int64))
    both = np.concatenate([rows, rows + apart])
    frames = roomy_empty((len(job.frames), len(both), width), job.frames.dtype)
    np.take(job.frames, both, axis=1, out=frames, mode="clip")
    maps = Maps((len(both), width), {axis.axis for axis in axes})
    few_rows, near = replace(job, frames=frames), near_of(job, wanted, {}, {}, maps)
    step, _ = axes_step(few_rows, sequence, wanted, axes, {}, maps, near=near)
    over_rows(step, len(both), _BLOCK)
    return Survey(frames, maps, apart, job.clip, job.noise)


def is_continuous(lines: Map, sigma: Map) -> bool:
    """Survey.is_continuous of coordinates (R, W) and their sigmas."""
    at = np.arange(0, lines.shape[1] - 2, max(1, lines.shape[1] // _BENDS))
    if not at.size:
        return False
    before, after = lines[:, at], lines[:, at + 2]
    bend = quantile(np.abs(before - 2 * lines[:, at + 1] + after).ravel(), 0.5)
    gradient = 0.5 * quantile(np.abs(after - before).ravel(), 0.5)
    return bend < max(_BENT, 5 * quantile(sigma[:, at].ravel(), 0.5), _ROUGH * gradient)
