"""The rig from the side: camera, mirror, pattern and rays of the mirror at rest, in x and z."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .fields import Float

__all__ = ["draw_side"]


def draw_side(length: float, pattern: Float, rays: Float, seen: NDArray[np.bool_], axes: Any = None) -> Any:
    """Draw with matplotlib, and give the axes back.

    length: of the mirror (mm). pattern: its corners, the first one again (5, 3). rays: (n, 4, 3), where each
    leaves the camera, leaves its face (or the camera again), meets z = 0, and ends on the pattern's plane.
    seen: (n,) bool, whether that is on the pattern; other rays are dotted.
    """
    import matplotlib.pyplot as plt

    if axes is None:
        _, axes = plt.subplots(figsize=(6.4, 4.0), layout="constrained")
    for ray, ends in zip(rays, seen, strict=True):
        axes.plot(ray[:, 0], ray[:, 2], color="#9aa6b2", lw=0.8, ls="-" if ends else ":")
    axes.plot([0.0, length], [0.0, 0.0], color="#2563a8", lw=3, label="mirror")
    axes.plot(pattern[:, 0], pattern[:, 2], color="#e0a030", lw=3, label="pattern")
    if np.abs(rays[:, 1] - rays[:, 0]).max() > 0:
        axes.plot(*rays[:, 1, ::2].T, color="#5a6675", lw=1.5, ls="--", label="face")
    axes.plot(*rays[:, 0, ::2].T, "o", color="#b3402e", ms=5, label="camera")
    axes.set(xlabel="x [mm]", ylabel="z [mm]", aspect="equal")
    axes.figure.legend(frameon=False, ncols=4, loc="outside upper center")
    return axes
