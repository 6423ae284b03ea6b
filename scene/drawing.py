"""The rig from the side: mirror, pattern and rays of the mirror at rest, in x and z."""

from typing import Any

import numpy as np

from .record import Float

__all__ = ["draw_side"]


def draw_side(length: float, pattern: Float, rays: Float, axes: Any = None) -> Any:
    """Draw with matplotlib, and give the axes back.

    length: of the mirror (mm). pattern: its corners, the first one again (5, 3). rays: (n, 3, 3), where each
    starts, meets z = 0, and ends on the pattern's plane.
    """
    import matplotlib.pyplot as plt

    if axes is None:
        _, axes = plt.subplots(figsize=(6.4, 4.0), layout="constrained")
    for ray in rays:
        axes.plot(ray[:, 0], ray[:, 2], color="#9aa6b2", lw=0.8)
    axes.plot([0.0, length], [0.0, 0.0], color="#2563a8", lw=3, label="mirror")
    axes.plot(pattern[:, 0], pattern[:, 2], color="#e0a030", lw=3, label="pattern")
    axes.plot(*np.delete(rays[:, 0], 1, axis=1).T, ".", color="#b3402e", ms=3, label="where rays start")
    axes.set(xlabel="x [mm]", ylabel="z [mm]", aspect="equal")
    axes.legend(frameon=False)
    return axes
