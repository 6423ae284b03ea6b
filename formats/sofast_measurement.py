"""Measurements of OpenCSP's SOFAST (HDF5) as captures: fringes on a screen, and the response to invert.

The file gives its fringes in periods per screen and places as fractions of the screen, not in pixels; here
a screen has nominal pixels, `SOFAST_SCREEN`: u = 2000 x, v = 1000 (1 - y) for fractions (x, y).
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.patterns import Frame, Sequence
from optolever.projector import Capture

from .hdf5 import load_fields
from .sofast_rig import SOFAST_SCREEN

__all__ = ["load_sofast", "load_sofast_response"]

ROWS, COLS = SOFAST_SCREEN
_STEPS = 4  # SOFAST shows every fringe at 0, 90, 180 and 270 degrees

_IMAGES = "MeasurementSofastFringe/fringe_images"
_MASKS = "MeasurementSofastFringe/mask_images"
_PERIODS_X = "MeasurementSofastFringe/fringe_periods_x"
_PERIODS_Y = "MeasurementSofastFringe/fringe_periods_y"
_DISPLAY = "ImageCalibration/display_values"
_CAMERA = "ImageCalibration/camera_values"


def load_sofast(path: str | Path) -> Capture:
    """A measurement: black, white, then the fringes along v and along u, frames (2 + N, H, W) uint8.

    InputError names the file, the field and the limit where the fields do not belong together.
    """
    fields = load_fields(path, [_IMAGES, _MASKS, _PERIODS_X, _PERIODS_Y])
    images, masks, x, y = (fields[name] for name in (_IMAGES, _MASKS, _PERIODS_X, _PERIODS_Y))
    for name, periods in ((_PERIODS_X, x), (_PERIODS_Y, y)):
        if periods.ndim != 1:
            raise InputError(f"{path}: {name} has shape {periods.shape}, must be (n,)")
    _require_images(path, _MASKS, masks, 2)
    _require_images(path, _IMAGES, images, _STEPS * (len(x) + len(y)))
    if images.shape[:2] != masks.shape[:2]:
        raise InputError(f"{path}: {_MASKS} has shape {masks.shape}, {_IMAGES} has {images.shape}")
    frames = (
        Frame("black"),
        Frame("white"),
        *_fringes(path, "v", ROWS, y, _PERIODS_Y),
        *_fringes(path, "u", COLS, x, _PERIODS_X),
    )
    stack = np.concatenate([np.moveaxis(masks, 2, 0), np.moveaxis(images, 2, 0)])
    return Capture(np.ascontiguousarray(stack), Sequence(frames, ROWS, COLS, "sofast", nominal=True))


def load_sofast_response(path: str | Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Display levels (n,) and the camera's levels for them (n,), both rising: the response to invert."""
    fields = load_fields(path, [_DISPLAY, _CAMERA])
    display, camera = (fields[name].astype(np.float64) for name in (_DISPLAY, _CAMERA))
    if display.ndim != 1 or display.shape != camera.shape or len(display) < 2:
        raise InputError(f"{path}: {_CAMERA} has shape {camera.shape}, {_DISPLAY} {display.shape}")
    for name, values in ((_DISPLAY, display), (_CAMERA, camera)):
        if (np.diff(values) <= 0).any():
            raise InputError(
                f"{path}: {name} must rise, entry {np.argmax(np.diff(values) <= 0) + 1} does not"
            )
    return display, camera


def _fringes(path: str | Path, axis: str, extent: int, periods: NDArray[Any], name: str) -> list[Frame]:
    counts = periods.astype(np.float64)
    if not counts.size or (counts <= 0).any():
        raise InputError(f"{path}: {name} = {periods.tolist()}, must be periods per screen above 0")
    shifts = [2 * math.pi * step / _STEPS for step in range(_STEPS)]
    try:
        return [
            Frame("phase", axis, period_px=extent / count, shift=shift)
            for count in counts.tolist()
            for shift in shifts
        ]
    except InputError as error:
        raise InputError(f"{path}: {name} = {periods.tolist()}: {error}") from error


def _require_images(path: str | Path, name: str, images: NDArray[Any], count: int) -> None:
    if images.dtype != np.uint8 or images.ndim != 3 or images.shape[2] != count or not images.size:
        raise InputError(f"{path}: {name} is {images.dtype} {images.shape}, must be uint8 (H, W, {count})")
