"""Some rows, decoded before the rest: how large a pixel's footprint is, whether neighbours are such."""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.blocks import on_threads
from optolever.memory import roomy_empty
from optolever.patterns import Sequence

from .correspondence import Flag
from .job import Job
from .noise import Noise
from .plan import AxisPlan, Plan
from .rows import Maps, axes_blocks, near_of
from .sample import quantile
from .survey_kernels import usual_steps

__all__ = ["SPOILT", "Steps", "Survey", "steps", "survey"]

Map = NDArray[Any]
#: Rows at most, distance of the rows between which the gradient is taken; pixels of a block, about: fewer are
#: decoded before a second thread is awake.
_ROWS, _APART, _BLOCK = 16, 2, 1 << 15
#: Pixels that tell whether maps are continuous, if nothing else is asked.
_FEW_PIXELS = 8192
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

    @cached_property
    def usual_levels(self) -> tuple[float, float]:
        """Amplitude and offset, medians of some pixels that are seen well (if there are such)."""
        step = max(1, self.flags.shape[1] // _COLUMNS)
        use = self.flags[:, ::step] & SPOILT == 0
        if not use.any():
            step, use = 1, self.flags & SPOILT == 0
        amplitude, offset = (quantile(chart[: len(use), ::step][use], 0.5) for chart in self.maps.common[1:3])
        return amplitude, offset

    def steps(self, name: str) -> "Steps":
        """From pixel to pixel of an axis."""
        sigma = self.maps.sigma[name][: len(self.flags)]
        return steps(self.lines(name), self.below(name), sigma, self.apart)


class Steps(NamedTuple):
    """footprint: median extent of a camera pixel in pattern cells, along both sides, at most 8; continuous:
    neighbours look at neighbouring places, so that they tell something of each other."""

    footprint: float
    continuous: bool


def survey(job: Job, sequence: Sequence, wanted: Plan, axes: tuple[AxisPlan, ...], *, few: bool) -> Survey:
    """Decode some rows of bits and fringes; few: half of them, of wide images a quarter."""
    height, width = job.frames.shape[1:]
    apart = min(_APART, height - 1)
    count = int(np.clip(_FEW_PIXELS // width, _ROWS // 4, _ROWS // 2)) if few else _ROWS
    both = _rows_of(height, apart, count)
    frames = roomy_empty((len(job.frames), len(both), width), job.frames.dtype)
    np.take(job.frames, both, axis=1, out=frames, mode="clip")
    maps = Maps((len(both), width), {axis.axis for axis in axes}, briefly=True)
    few_rows, near = replace(job, frames=frames), near_of(job, wanted, {}, {}, maps)
    cuts = [*range(0, len(both), max(1, _BLOCK // width)), len(both)]
    share = axes_blocks(few_rows, sequence, wanted, axes, {}, maps, near=near)(cuts)
    on_threads(share, len(cuts) - 1)
    return Survey(frames, maps, apart, job.clip, job.noise)


@lru_cache(maxsize=4)
def _rows_of(height: int, apart: int, count: int) -> NDArray[np.int64]:
    """So many rows from all over the image, and behind them those `apart` rows below."""
    rows = np.unique(np.linspace(0, height - 1 - apart, count).astype(np.int64))
    return np.concatenate([rows, rows + apart])


def steps(lines: Map, below: Map, sigma: Map, apart: int) -> Steps:
    """Of coordinates (R, W), of rows `apart` below them, and of their sigmas (R, W)."""
    (rows, cols), every = lines.shape, max(1, lines.size // _FOOTPRINTS)
    few = max(1, cols // _BENDS)
    usual, room = np.empty(5), np.empty((3, rows * (cols // min(every, few) + 1)), np.float32)
    usual_steps(lines, below, sigma, float(max(apart, 1)), every, few, room, usual)
    along, down, bend, gradient, spread = usual.tolist()
    continuous = cols > 2 and bend < max(_BENT, 5 * spread, _ROUGH * gradient)
    return Steps(min(along + down, 8.0), continuous)
