"""A capture of the mirror at rest as a reference:
what it shows that the scene does not predict is calibration.
"""

import numpy as np

from optolever.decode import Correspondence, Flag
from optolever.errors import InputError
from optolever.scene import Scene, dent, trace

__all__ = ["rest_corrected"]


def rest_corrected(correspondence: Correspondence, rest: Correspondence, scene: Scene) -> Correspondence:
    """The correspondence less the rest capture's deviation from the traced flat mirror, pixel by pixel.

    Right to first order in the dent: every pixel's error of pattern pose, scale and lens is taken as it is at
    rest. The sigmas add in square. Pixels that the rest capture does not know are flagged INVALID.
    """
    if rest.u.shape != correspondence.u.shape:
        raise InputError(
            f"rest: {rest.u.shape[0]} x {rest.u.shape[1]} pixels, the correspondence has "
            f"{correspondence.u.shape[0]} x {correspondence.u.shape[1]}"
        )
    if correspondence.u.shape != (scene.camera.rows, scene.camera.cols):
        raise InputError(
            f"correspondence: {correspondence.u.shape[0]} x {correspondence.u.shape[1]} pixels, the scene's "
            f"camera has {scene.camera.rows} x {scene.camera.cols}"
        )
    flat = trace(scene, dent("flat", scene))
    known = rest.good & flat.visible
    unknown = np.where(~known & correspondence.good, int(Flag.INVALID), 0)
    return Correspondence(
        correspondence.u - np.where(known, rest.u - flat.u, 0.0),
        correspondence.v - np.where(known, rest.v - flat.v, 0.0),
        np.hypot(correspondence.sigma_u, np.where(known, rest.sigma_u, 0.0)),
        np.hypot(correspondence.sigma_v, np.where(known, rest.sigma_v, 0.0)),
        (correspondence.flags | unknown).astype(np.uint16),
        correspondence.amplitude,
        correspondence.offset,
    )
