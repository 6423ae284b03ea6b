"""What was decoded of a SOFAST measurement, on the pattern of the rig that SOFAST calibrated."""

from dataclasses import replace

import numpy as np

from optolever.decode import Correspondence, Flag
from optolever.errors import InputError

from .sofast_rig import SOFAST_SCREEN, SofastRig

__all__ = ["on_rig"]


def on_rig(correspondence: Correspondence, rig: SofastRig) -> Correspondence:
    """The correspondence in cells of the rig's pattern (1 mm) instead of the screen's nominal pixels.

    What does not see the facet, or the screen where nobody measured it, is flagged INVALID. InputError if the
    shapes do not agree.
    """
    if correspondence.u.shape != rig.mask.shape:
        raise InputError(
            f"correspondence: shape {correspondence.u.shape}, the SOFAST rig's camera has {rig.mask.shape}"
        )
    rows, cols = SOFAST_SCREEN
    width, height = rig.extent
    u, v = rig.pattern_coordinates(correspondence.u / cols, 1.0 - correspondence.v / rows)
    seen = rig.mask & np.isfinite(u) & np.isfinite(v)
    unseen = np.where(seen, 0, int(Flag.INVALID))
    return replace(
        correspondence,
        u=np.where(seen, u, np.nan),
        v=np.where(seen, v, np.nan),
        sigma_u=correspondence.sigma_u * (width / cols),
        sigma_v=correspondence.sigma_v * (height / rows),
        flags=(correspondence.flags | unseen).astype(np.uint16),
    )
