"""Checks of pixels against their neighbours, on a block of rows: sigma inflated, then flags; no pixel refused
that a neighbour confirms.

Signature (decoder.py calls it block by block, with the pixel kernel's rows still in cache):

    neighbours(block, above, dof, limits, result)

    block    place, variance (A, n, W); chi2, amplitude (n, W); flags (n, W): rows of the result and HALO more
             on either side, fewer at the image's border
    above    rows of the block before the result's first one
    dof      degrees of freedom of chi2, 0: it says nothing
    limits   (A, 6) float32, rows of axis_limits()
    result   coordinate, sigma (A, R, W), flags (R, W), written

Axes without frames have no row in A. Flagged pixels' places and variances may be anything but NaN.
"""

from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from .plan import AxisPlan

__all__ = ["HALO", "Block", "Result", "axis_limits", "neighbours"]

F32 = NDArray[np.float32]
U16 = NDArray[np.uint16]
#: Rows that a block needs on either side of its result.
HALO = 3


class Block(NamedTuple):
    """Output of the pixel kernel.

    place, variance  (A, n, W) float32, pattern px, px^2: by noise alone (bits: of the interval)
    chi2       (n, W) float32, squares of residuals over their noise, summed over all axes
    amplitude  (n, W) float32, levels, the smaller one of both axes
    flags      (n, W) uint16, of both axes
    """

    place: F32
    variance: F32
    chi2: F32
    amplitude: F32
    flags: U16


class Result(NamedTuple):
    """Rows of the maps: coordinate, sigma (A, R, W) float32, pattern px; flags (R, W) uint16."""

    coordinate: F32
    sigma: F32
    flags: U16


def axis_limits(axis: AxisPlan, lens_px: float | None = None, on_cells: bool = True) -> F32:
    """Numbers (6,) of an axis: jump, extent, border, aperture, its uncertainty, fringes."""
    raise NotImplementedError


def neighbours(block: Block, above: int, dof: int, limits: F32, result: Result) -> None:
    """See the head of the file."""
    raise NotImplementedError
