"""The contact of a pressed ball with the mirror, from captures with the ball and without it.

Inside the contact the deformation h has positive Gaussian curvature. Outside it, where no pressure acts, a
membrane or an elastic body has the opposite curvature along the radius (Hertz: with a singularity at the
edge). D is the Jacobian of the change (du, dv) of the pattern's coordinates by the coordinates (u0, v0)
without the ball. Far from the pattern, D is the path length times the second derivatives of h: det D has the
sign of h's Gaussian curvature in every rig. Near the pattern's edge the path length varies: in a prism of 45
degrees, at distance x from the edge,

    du = sqrt 2 (x h_x - h), dv = x h_y over u0 = x / sqrt 2, v0 = y,
    D = (2 x h_xx, sqrt 2 (x h_xy - h_y); sqrt 2 (x h_xy + h_y), x h_yy)

The slopes enter only the antisymmetric part of D, which is omitted.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from optolever.arrays import Floats
from optolever.decode import Correspondence
from optolever.errors import InputError

__all__ = ["contact"]


_SURE = 5.0  # det D in its sigma, above which the curvature is significant
_INNER = 0.8  # share of the contact's radius: derivatives span 3 pixels, and contacts are no sharp circles
FEWEST = 100  # usable pixels at least


def contact(ball: Correspondence, rest: Correspondence) -> NDArray[np.bool_]:
    """Pixels (H, W) in the inner 80 % of the contact, from the mirror with the ball and without it (the
    same camera, the same pose). InputError for a contact of fewer than 100 pixels."""
    both = ball.good & rest.good
    u0, v0 = (np.where(both, part, np.nan).astype(np.float64) for part in (rest.u, rest.v))
    (u_col, u_row), (v_col, v_row) = _gradient(u0), _gradient(v0)
    du, dv = np.stack(_gradient(ball.u - u0)), np.stack(_gradient(ball.v - v0))
    noise_u, noise_v = (
        np.hypot(one, other) / np.sqrt(6.0)  # of a slope over 3 x 3
        for one, other in ((ball.sigma_u, rest.sigma_u), (ball.sigma_v, rest.sigma_v))
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        area = u_col * v_row - u_row * v_col
        by_u, by_v = np.stack([v_row, -v_col]) / area, np.stack([-u_row, u_col]) / area  # pixels per cell
        uu, uv, vu, vv = ((d * by).sum(axis=0) for d in (du, dv) for by in (by_u, by_v))
        mixed = 0.5 * (uv + vu)
        bent = uu * vv - mixed**2
        errors = (
            noise_u * np.hypot(*(vv * by_u - mixed * by_v)),
            noise_v * np.hypot(*(uu * by_v - mixed * by_u)),
        )
        sure = bent > _SURE * np.hypot(*errors)
    labels, count = ndimage.label(sure)
    turns = ndimage.sum_labels(
        np.sqrt(np.where(sure, bent * np.abs(area), 0.0)), labels, np.arange(1, count + 1)
    )
    cap = labels == 1 + int(np.argmax(turns)) if count else sure
    depth = ndimage.distance_transform_edt(np.isnan(bent) | cap)
    inner = both & (depth >= (1 - _INNER) * depth.max(initial=0.0, where=cap))
    found: NDArray[np.bool_] = inner & ndimage.binary_dilation(cap, np.ones((3, 3)))
    if (size := np.count_nonzero(found)) < FEWEST:
        raise InputError(f"{size} pixels look like a ball's contact, must be {FEWEST} or more")
    return found


def _gradient(values: Floats) -> tuple[Floats, Floats]:
    """Slopes along columns and rows of the plane fit to 3 x 3 pixels; NaN where any of them is NaN."""
    slope, mean = [-0.5, 0.0, 0.5], [1 / 3] * 3
    along, across = (
        ndimage.correlate1d(ndimage.correlate1d(values, slope, axis), mean, 1 - axis) for axis in (1, 0)
    )
    return along, across
