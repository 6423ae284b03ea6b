"""A spot at a raster of places: a stripe swept along u, and one along v.

The frames of a spot are products, so that a pixel's light is A f(v - row) g(u - column) + B: the mean over
any rows of the raster is a stripe's sweep. They are those around the pixel's brightest frame, as the others
hold nothing but noise.
"""

from functools import lru_cache

import numpy as np

from optolever.errors import InputError
from optolever.patterns import Sequence

from .plan import AxisPlan, Stripes

__all__ = ["raster_axes"]

#: Fewest places along an axis, as for stripes.
_FEWEST = 5


@lru_cache(maxsize=16)
def raster_axes(sequence: Sequence) -> tuple[AxisPlan, ...]:
    """Both sweeps of the raster that a sequence's spots make, in any order; none: it shows no spots.

    White and black may be there, too. InputError where places are missing or twice, or other codes are shown
    besides.
    """
    spots = [i for i, frame in enumerate(sequence.frames) if frame.kind == "stripe" and frame.axis == "uv"]
    if not spots:
        return ()
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
    width, nothing = widths.pop(), (None, (), ())
    along, down = Stripes(index.T, at_u, width, at_v), Stripes(index, at_v, width, at_u)
    return (
        AxisPlan("u", sequence.cols, *nothing, along, ()),
        AxisPlan("v", sequence.rows, *nothing, down, ()),
    )
