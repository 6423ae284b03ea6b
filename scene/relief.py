"""A dent whose shape is an image: grey level to height."""

from pathlib import Path

import cv2
import numpy as np

from optolever.pictures import grey_of, read_picture

from .forms import taper_of
from .grid import Grid
from .record import Float, positive
from .scene import Scene
from .surface import Surface, from_grid

__all__ = ["relief"]

_MOST = 2048  # nodes along a side; larger images are averaged down
_ZEROS = 12  # nodes at x = L0 that are exactly zero, so that the spline is too (it forgets by 0.27 per node)


def relief(scene: Scene, *, path: str, peak: float, smooth: float, taper: float) -> Surface:
    """Surface whose height is the image at `path`, stretched over the mirror: black 0, white `peak` mm.

    Columns run along x, rows along y; of colours their luminance. smooth: rms radius (mm) of a Gaussian
    blur that turns the image's steps into slopes; taper: mm over which the height fades out towards x = L0.
    """
    positive("dent 'relief': smooth", smooth, zero=True)
    heights = peak * _grey(Path(path))
    heights = _fitted(heights)
    rows, cols = heights.shape
    dx, dy = scene.mirror.length / (cols - 1), scene.mirror.width / (rows - 1)
    if smooth > 0:
        heights = np.asarray(
            cv2.GaussianBlur(
                heights, (0, 0), smooth / dx, sigmaY=smooth / dy, borderType=cv2.BORDER_REPLICATE
            ),
            np.float64,
        )
    fade, _ = taper_of(dx * (np.arange(cols) + _ZEROS), scene.mirror.length, taper)
    grid = Grid(heights * fade, 0.0, 0.0, dx, dy)
    return from_grid(grid)


def _grey(path: Path) -> Float:
    """The image as 0..1 (rows, cols); InputError if it is none."""
    grey = grey_of(read_picture(path))
    return grey.astype(np.float64) / {"uint8": 255.0, "uint16": 65535.0}.get(grey.dtype.name, 1.0)


def _fitted(heights: Float) -> Float:
    """At most _MOST nodes along a side, by area; at least enough for the taper's zeros."""
    least = 10 * _ZEROS
    rows, cols = (min(max(side, least), _MOST) for side in heights.shape)
    if (rows, cols) == heights.shape:
        return heights
    shrinks = rows <= heights.shape[0] and cols <= heights.shape[1]
    how = cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(heights, (cols, rows), interpolation=how), np.float64)
