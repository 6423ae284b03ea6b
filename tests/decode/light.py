"""The light that pixels see of a display's cells, integrated cell by cell with error functions."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from optolever.patterns import Frame, Sequence

F64 = NDArray[np.float64]

#: Pixels of so many cells along a surface, rows each of which sees the cells from a place of its own.
WIDTH, COLS = 0.6, 150
U = 8 + WIDTH * np.arange(int((COLS - 18) / WIDTH)) + 0.013 * np.arange(96)[:, None]


def camera(light: F64, noise: float = 0.0, seed: int = 0) -> NDArray[np.uint8]:
    """Frames of 8 bits of light (levels), with white noise (levels)."""
    noisy = light + noise * np.random.default_rng(seed).standard_normal(light.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def seen_by_pixels(shown: Sequence, u: F64, width: float, blur: float, lit: float = 1.0) -> F64:
    """Frames (N, 1, W) that pixels of `width` cells at u (W,) see, blurred by `blur` cells rms; a share `lit`
    of a cell's width gives light.

    A cell's light is the integral over the pixel of the blurred cell: differences of the antiderivative
    t Phi(t / blur) + blur phi(t / blur) of the normal distribution Phi.
    """

    def integral(t: F64) -> F64:
        z = t / blur
        return t * 0.5 * (1 + erf(z / np.sqrt(2))) + blur * np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi)

    tables, _ = shown.tables()
    centre = np.arange(shown.cols)[None, :] - u[:, None]
    inside = [integral(centre + one * lit / 2 + two * width / 2) for one in (1, -1) for two in (1, -1)]
    light = (inside[0] - inside[1] - inside[2] + inside[3]) / (width * lit)
    return 16 + 0.85 * (tables.astype(float) @ light.T)[:, None, :]


def photographed(
    shown: Sequence,
    u: F64,
    width: float = 1.0,
    blur: float = 0.3,
    noise: float = 1.0,
    seed: int = 7,
    brighter: float = 1.0,
    dark: float = 0.0,
    lit: float = 1.0,
) -> NDArray[np.uint8]:
    """Frames of 8 bits of pixels at u (H, W), with white noise (levels), `brighter` times as bright, and
    `dark` levels more; lit: see seen_by_pixels.
    """
    rows = [seen_by_pixels(shown, row, width, blur, lit) for row in u]
    light = dark + brighter * np.concatenate(rows, axis=1)
    return camera(light, noise, seed)


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
