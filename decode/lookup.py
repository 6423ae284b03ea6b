"""Look-up: a pixel's samples against known levels, whatever they are.

Free grey values, fringes of a single shift each, swept stripes, binary codes within their cells: the levels
that each place of the surface shows through a pixel (cell, footprint, blur) are known, a codeword for each
eighth of a pattern pixel. Samples are v = o + a t(u): normalised correlation finds the place, least squares
between adjacent codewords refines it, the Fisher information of the fit is its variance; where codewords
hardly differ over a part of the way (the treads of a sharp display's cells) mean and variance of the
posterior. Probability of another answer: from the angle to the most similar codeword elsewhere, or from the
highest correlations of all. Footprint and blur are the likeliest (see spread); where no rule of the frames
tells the camera's noise, it is that of the residuals.

Start of the search: the neighbour's place (any levels), the brightest frame (stripes), the decoded cell
(codes).
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from optolever.patterns import Sequence

from .estimate import Estimate
from .frames import Light
from .lookup_kernels import PER_PX, SEARCH, SWEEP, WITHIN, Camera, match_rows
from .lookup_tables import USUAL, Pixel, Table, table_of
from .noise import Noise, Sample
from .plan import AxisPlan, Plan
from .spread import FINE, Fit, fitted, likeliest

__all__ = ["Table", "lookup_rows", "prepare"]

F64 = NDArray[np.float64]
#: Squared residuals that noise reaches once in so many pixels.
_RARE = 1e-5
#: Pixels that tell the noise, and of these on which the spread is measured.
_SAMPLE = 4096
_PIXELS = 256
#: Levels of codewords around the sampled pixels at most: of cells of many pixels fewer are looked at.
_LEVELS = 1 << 22
#: Probability of another place below which a pixel may judge a spread.
_SAFE = 1e-3
#: Pixels that tell a spread, and the largest one of cells, pattern px: out of focus.
_FEWEST, _MOST = 16, 2.5
#: Variance that is assumed before noise is measured, over the squared contrast.
_FIRST = 1e-5


def lookup_rows(light: Light, noise: Noise, table: Table, rows: tuple[int, int], estimate: Estimate) -> None:
    """Decode rows start..stop, in place; of a code (WITHIN), refine the cells' centres that are there.

    A row's answers depend on nothing but that row. NaN, infinite variance and error 1: no pattern.
    """
    misfit2 = max(noise.misfit2, table.misfit2)
    camera = Camera(
        *(light.raw, light.table, float(light.clip)),
        *(float(noise.read2), float(noise.gain), float(misfit2)),
    )
    limit = float(chi2.isf(_RARE, max(table.freedom, 1)))
    match_rows(camera, table.book, table.way, table.coarse, table.apart, limit, *rows, estimate.arrays())
    if table.unsure > 0:
        # the way to the nearest edge is proportional to the spread of the edges
        phase = (estimate.coordinate + 0.5) / table.cell
        estimate.variance[:] += np.square(table.unsure * table.cell * (phase - np.rint(phase)))


def prepare(
    sequence: Sequence,
    plan: Plan,
    axis: AxisPlan,
    light: Light,
    noise: Noise,
    lit: Sample,
    cells: F64 | None = None,
    measure: bool = False,
) -> Table:
    """Table of an axis, its spread measured on pixels that see the pattern.

    cells (K,): of a code, coordinate of the cell of each pixel of `lit`, NaN: unknown; look within the cells.
    measure: the noise is not known.
    """
    row, col = lit.places[:: max(1, -(-len(lit.places) // _SAMPLE))].T
    way = SEARCH if cells is None else WITHIN
    way = SWEEP if axis.stripes is not None and cells is None else way
    first = table_of(sequence, plan, axis, way, USUAL)
    if len(row) == 0:
        return first
    few = replace(light, raw=np.ascontiguousarray(light.raw[:, row, col][:, None, :]))
    if measure:
        contrast = float(np.mean(np.square(np.ptp(few.linear(few.raw), axis=0))))
        noise = Noise(max(light.rounding, _FIRST * contrast, 1e-12))
    if cells is None:
        pilot = Estimate.empty(1, len(row), first.freedom)
        lookup_rows(few, replace(noise, misfit2=0.0), first, (0, 1), pilot)
        start = np.where(pilot.error < _SAFE, pilot.coordinate, np.nan)[0].astype(np.float64)
    else:
        start = cells[:: max(1, -(-len(lit.places) // _SAMPLE))]
    known = np.flatnonzero(np.isfinite(start))
    most = 0.5 * axis.stripes.width if way == SWEEP and axis.stripes is not None else _MOST

    def table(pixel: Pixel, per: int) -> Table:
        return table_of(sequence, plan, axis, WITHIN if way == SEARCH else way, pixel, most, per)

    def tried(pixel: Pixel, per: int, most: int = _PIXELS) -> Fit:
        levels = (2 * first.book.reach + 1) * FINE // PER_PX * first.book.samples
        most = max(_FEWEST, min(most, _LEVELS // levels))
        some = known[:: max(1, -(-len(known) // most))]
        return fitted(replace(few, raw=few.raw[:, :, some]), noise, table(pixel, per), start[some])

    if len(tried(USUAL, PER_PX).misfit) < _FEWEST:
        return first
    pixel, unsure = likeliest(tried, most, first.cell, way == SWEEP, measure)
    fit = tried(pixel, PER_PX, _SAMPLE)
    found = replace(table_of(sequence, plan, axis, way, pixel), unsure=unsure)
    return (
        replace(found, noise=fit.noise(light.rounding)) if measure else replace(found, misfit2=fit.misfit2())
    )
