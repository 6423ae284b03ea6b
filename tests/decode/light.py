"""The light that pixels see of a display's cells, integrated cell by cell with error functions."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from optolever.patterns import Sequence

F64 = NDArray[np.float64]


def seen_by_pixels(shown: Sequence, u: F64, width: float, blur: float) -> F64:
    """Frames (N, 1, W) that pixels of `width` cells at u (W,) see, blurred by `blur` cells rms.

    A cell's light is the integral over the pixel of the blurred cell: differences of the antiderivative
    t Phi(t / blur) + blur phi(t / blur) of the normal distribution Phi.
    """

    def integral(t: F64) -> F64:
        z = t / blur
        return t * 0.5 * (1 + erf(z / np.sqrt(2))) + blur * np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi)

    tables, _ = shown.tables()
    distance = np.arange(shown.cols + 1)[None, :] - 0.5 - u[:, None]
    light = np.diff((integral(distance + width / 2) - integral(distance - width / 2)) / width, axis=1)
    return 16 + 0.85 * (tables.astype(float) @ light.T)[:, None, :]
