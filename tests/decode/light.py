"""The light that pixels see of a display's cells, integrated cell by cell with error functions."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from optolever.patterns import Frame, Sequence

F64 = NDArray[np.float64]


def camera(light: F64, noise: float = 0.0, seed: int = 0) -> NDArray[np.uint8]:
    """Frames of 8 bits of light (levels), with white noise (levels)."""
    noisy = light + noise * np.random.default_rng(seed).standard_normal(light.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def photographed(
    shown: Sequence, u: F64, width: float = 1.0, blur: float = 0.3, noise: float = 1.0, seed: int = 7
) -> NDArray[np.uint8]:
    """Frames (N, H, W) of 8 bits, with white noise (levels), that pixels of `width` cells at u (H, W) see,
    blurred by `blur` cells rms.

    A cell's light is the integral over the pixel of the blurred cell: differences of the antiderivative
    t Phi(t / blur) + blur phi(t / blur) of the normal distribution Phi.
    """

    def integral(t: F64) -> F64:
        z = t / blur
        return t * 0.5 * (1 + erf(z / np.sqrt(2))) + blur * np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi)

    table, ends, rows = (
        shown.tables()[0].astype(float),
        [(one, two) for one in (1, -1) for two in (1, -1)],
        [],
    )
    for row in u:
        centre = np.arange(shown.cols)[None, :] - row[:, None]
        inside = [one * two * integral(centre + one / 2 + two * width / 2) for one, two in ends]
        rows.append(16 + 0.85 * (table @ (sum(inside) / width).T))
    return camera(np.stack(rows, axis=1), noise, seed)


def free_levels(cols: int, frames: int) -> Sequence:
    """Random grey values of single cells along u."""
    values = np.random.default_rng(0).integers(0, 256, (frames, cols))
    return Sequence(tuple(Frame("levels", "u", levels=tuple(row.tolist())) for row in values), 4, cols)


def seen_cells(levels: F64, place: F64, blur: float) -> F64:
    """Light at `place` of cells of width 1, Gaussian blur, closed form: sum of level * (erf difference)."""
    near = np.rint(place).astype(int)
    light = np.zeros(place.shape)
    for step in range(-6, 7):
        cell = np.clip(near + step, 0, len(levels) - 1)
        right, left = (near + step + 0.5 - place) / blur, (near + step - 0.5 - place) / blur
        light += levels[cell] * 0.5 * (erf(right / np.sqrt(2)) - erf(left / np.sqrt(2)))
    return light


def cell_frames(shown: Sequence, u: F64, v: F64, blur: float, noise: float) -> NDArray[np.uint8]:
    """Frames (N, H, W) of points at u, v (H, W) of a surface: the product of both axes' light, 10 to 210."""
    tables = [table.astype(np.float64) / 255 for table in shown.tables()]
    light = [seen_cells(tables[0][i], u, blur) * seen_cells(tables[1][i], v, blur) for i in range(len(shown))]
    return camera(10 + 200 * np.array(light), noise, 8)
