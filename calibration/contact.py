"""Where a pressed ball touches the mirror, from its capture and one of the mirror without it.

A ball bends the mirror about both axes to one side. Beside the contact nothing presses: there a membrane or
an elastic body bends to the other side along the radius, at once (Hertz: with a singular curvature). The
pattern's coordinates follow slopes, so that det d(u - u0, v - v0) / d(col, row) has the sign of the change's
Gaussian curvature times that of det d(u0, v0) / d(col, row), whatever the rig.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from optolever.decode import Correspondence
from optolever.errors import InputError

__all__ = ["contact"]

Floats = NDArray[np.float64]

_SURE = 5.0  # sigma of the determinant
_INNER = 0.8  # of the contact's radius: derivatives reach over a pixel, and contacts are no sharp circles
FEWEST = 100  # pixels: less is no mirror


def contact(ball: Correspondence, rest: Correspondence) -> NDArray[np.bool_]:
    """Pixels (H, W) in the inner 80 % of the contact, from the mirror with the ball and without it (the
    same camera, the same pose). InputError where fewer than 100 pixels are such."""
    both = ball.good & rest.good
    u0, v0 = (np.where(both, part, np.nan).astype(np.float64) for part in (rest.u, rest.v))
    du, dv = _gradient(ball.u - u0), _gradient(ball.v - v0)
    handed = np.sign(np.nansum(np.sign(_cross(_gradient(u0), _gradient(v0)))))
    bent = handed * _cross(du, dv)
    noise_u, noise_v = (
        np.hypot(one, other) / np.sqrt(6.0)  # of a slope over 3 x 3
        for one, other in ((ball.sigma_u, rest.sigma_u), (ball.sigma_v, rest.sigma_v))
    )
    sure = bent > _SURE * np.hypot(noise_u * np.hypot(*dv), noise_v * np.hypot(*du))
    labels, count = ndimage.label(sure)
    turns = ndimage.sum_labels(np.sqrt(np.where(sure, bent, 0.0)), labels, np.arange(1, count + 1))
    cap = labels == 1 + int(np.argmax(turns)) if count else sure
    depth = ndimage.distance_transform_edt(np.isnan(bent) | cap)
    inner = both & (depth >= (1 - _INNER) * depth.max(initial=0.0, where=cap))
    found: NDArray[np.bool_] = inner & ndimage.binary_dilation(cap, np.ones((3, 3)))
    if (size := np.count_nonzero(found)) < FEWEST:
        raise InputError(f"{size} pixels look like a ball's contact, must be {FEWEST} or more")
    return found


def _gradient(values: Floats) -> tuple[Floats, Floats]:
    """Slopes along columns and rows of the plane through 3 x 3 pixels; NaN where one of these is unknown."""
    slope, mean = [-0.5, 0.0, 0.5], [1 / 3] * 3
    along, across = (
        ndimage.correlate1d(ndimage.correlate1d(values, slope, axis), mean, 1 - axis) for axis in (1, 0)
    )
    return along, across


def _cross(a: tuple[Floats, Floats], b: tuple[Floats, Floats]) -> Floats:
    return a[0] * b[1] - a[1] * b[0]
