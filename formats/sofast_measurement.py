"""Measurements of OpenCSP's SOFAST (HDF5) as captures: fringes on a screen, the response to invert, and what
was decoded on the pattern of the rig that SOFAST calibrated.

The file gives its fringes in periods per screen and places as fractions of the screen, not in pixels; here
a screen has nominal pixels, `SOFAST_SCREEN`: u = 2000 x, v = 1000 (1 - y) for fractions (x, y).
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.decode import Correspondence, Flag
from optolever.errors import InputError
from optolever.patterns import Frame, Sequence
from optolever.projector import Capture

from .sofast_files import sofast_fields
from .sofast_rig import SOFAST_SCREEN, SofastRig

__all__ = ["load_sofast", "load_sofast_response", "on_rig"]

ROWS, COLS = SOFAST_SCREEN
_STEPS = 4  # SOFAST shows every fringe at 0, 90, 180 and 270 degrees


def load_sofast(path: str | Path) -> Capture:
    """A measurement: black, white, then the fringes along v and along u, frames (2 + N, H, W) uint8.

    InputError names the file, the field and the limit where the fields do not belong together.
    """
    fields = sofast_fields(path, "fringe_images", "mask_images", "fringe_periods_x", "fringe_periods_y")
    x, y, shots = fields["fringe_periods_x"], fields["fringe_periods_y"], fields["mask_images"]
    for name, count in (("mask_images", 2), ("fringe_images", _STEPS * (len(x) + len(y)))):
        stack = fields[name]
        if stack.dtype != np.uint8 or stack.shape != (*shots.shape[:2], count):
            must = f"uint8 (H, W, {count}), mask_images is {shots.shape}"
            raise InputError(f"{path}: {name} is {stack.dtype} {stack.shape}, must be {must}")
    try:
        fringes = (*_fringes("v", ROWS, y), *_fringes("u", COLS, x))
    except (InputError, ZeroDivisionError) as error:
        raise InputError(f"{path}: fringe_periods_x or fringe_periods_y: {error}") from error
    frames = (Frame("black"), Frame("white"), *fringes)
    shown = np.concatenate([shots, fields["fringe_images"]], axis=2)
    return Capture(
        np.ascontiguousarray(np.moveaxis(shown, 2, 0)), Sequence(frames, ROWS, COLS, "sofast", nominal=True)
    )


def _fringes(axis: str, extent: int, periods: NDArray[Any]) -> list[Frame]:
    shifts = [2 * math.pi * step / _STEPS for step in range(_STEPS)]
    return [
        Frame("phase", axis, period_px=extent / count, shift=shift)
        for count in periods.astype(np.float64).tolist()
        for shift in shifts
    ]


def load_sofast_response(path: str | Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Display levels (n,) and the camera's levels for them (n,), both rising: the response to invert."""
    fields = sofast_fields(path, "display_values", "camera_values")
    display, camera = (fields[name].astype(np.float64) for name in ("display_values", "camera_values"))
    if display.shape != camera.shape or len(display) < 2:
        raise InputError(f"{path}: camera_values has shape {camera.shape}, display_values {display.shape}")
    if (np.diff(display) <= 0).any() or (np.diff(camera) <= 0).any():
        raise InputError(f"{path}: display_values and camera_values must rise from entry to entry")
    return display, camera


def on_rig(correspondence: Correspondence, rig: SofastRig) -> Correspondence:
    """The correspondence in cells of the rig's pattern (1 mm) instead of the screen's nominal pixels.

    What does not see the facet, or the screen where nobody measured it, is flagged INVALID. InputError if the
    shapes do not agree.
    """
    if correspondence.u.shape != rig.mask.shape:
        raise InputError(
            f"correspondence: shape {correspondence.u.shape}, the SOFAST rig's camera has {rig.mask.shape}"
        )
    width, height = np.ptp(rig.cells, axis=0).tolist()
    u, v = rig.pattern_coordinates(correspondence.u / COLS, 1.0 - correspondence.v / ROWS)
    seen = rig.mask & np.isfinite(u) & np.isfinite(v)
    unseen = np.where(seen, 0, int(Flag.INVALID))
    return replace(
        correspondence,
        u=np.where(seen, u, np.nan),
        v=np.where(seen, v, np.nan),
        sigma_u=correspondence.sigma_u * (width / COLS),
        sigma_v=correspondence.sigma_v * (height / ROWS),
        flags=(correspondence.flags | unseen).astype(np.uint16),
    )
