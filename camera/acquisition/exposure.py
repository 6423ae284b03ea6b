"""Exposure of a camera by white and black: no pixel saturates, the contrast in the mirror is largest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError

__all__ = ["Contrast", "choose_exposure", "contrast"]

Pixels = NDArray[np.uint8] | NDArray[np.uint16]

_SATURATED = 1e-4  # share of the pixels that may be at the top level
_TOP = 0.9  # of full scale, of the brightest that are to stay below
_STEPS = 8
_SEEN = 0.01  # of full scale: white less black of the brightest pixels, at least
_LIT = 0.03  # of the swing of the brightest pixels: threshold of the mask


@dataclass(frozen=True, slots=True, eq=False)
class Contrast:
    """Levels of a white and a black display. saturated: share of the pixels at the top level; bright: level
    below which all others stay, of full scale; swing: white less black (median of the mask), of full scale;
    mask (H, W): pixels that see the pattern.
    """

    saturated: float
    bright: float
    swing: float
    mask: NDArray[np.bool_]


def contrast(white: Pixels, black: Pixels, bits: int) -> Contrast:
    """Of an image of a white and one of a black display. InputError where none of the pixels sees it."""
    top = 2**bits - 1
    swing = white.astype(np.float64) - black
    mask = swing_mask(swing, top)
    if not mask.any():
        raise InputError(
            f"expose: white is {np.percentile(swing, 99):.1f} levels of {top} above black; does the camera "
            "see the display? is it in focus on the mirror, is the lens open? (optolever start --from aim)"
        )
    return Contrast(
        saturated=float((white >= top).mean()),
        bright=float(np.quantile(white, 1 - _SATURATED)) / top,
        swing=float(np.median(swing[mask])) / top,
        mask=mask,
    )


def swing_mask(swing: NDArray[np.float64], top: int, lit: float = _LIT) -> NDArray[np.bool_]:
    """Pixels (H, W) that see the display, by white less black: above a share `lit` of the brightest ones;
    none where these are below 1 % of full scale."""
    most = float(np.percentile(swing, 99))
    return np.asarray(swing > max(lit * most, 0.0)) & (most >= _SEEN * top)


def choose_exposure(
    take: Callable[[float], tuple[float, Pixels, Pixels]],
    bits: int,
    start_s: float,
    unit_s: float | None = None,
    most: float = 1.0,
) -> tuple[float, Contrast]:
    """The longest exposure (s) at which at most 0.01 % of the pixels saturate, and its contrast.

    take(exposure) sets the camera and returns the exposure that it accepted, an image of white, one of black.
    unit_s: refresh of the display; the exposure is an integer multiple of it; None: any. most: of full scale,
    of white.
    InputError where even the shortest exposure saturates.
    """

    def whole(exposure: float) -> float:
        return exposure if unit_s is None else max(1, int(exposure / unit_s + 1e-6)) * unit_s

    wanted, good, top = whole(start_s), None, 2**bits - 1
    tried: set[float] = set()
    for _ in range(_STEPS):
        accepted, white, black = take(wanted)
        tried.add(wanted)
        found = contrast(white, black, bits)
        if found.saturated <= _SATURATED and found.bright <= most:
            if good is None or accepted > good[0]:
                good = accepted, found
            factor = _TOP / max(found.bright, 0.01)
        else:
            factor = 0.5 if found.bright >= 1 else _TOP
        wanted = whole(accepted * min(max(factor, 0.1), 10.0))
        if wanted in tried or abs(wanted / accepted - 1) < 0.05:
            break
    if good is None:
        what = (
            f"{100 * found.saturated:.2f} % of the pixels saturate at {1e3 * accepted:.2f} ms, at most 0.01 %"
        )
        if found.saturated <= _SATURATED:
            bright, limit = round(found.bright * top), round(most * top)
            what = f"white reaches {bright} of {top} levels at {1e3 * accepted:.2f} ms, at most {limit}"
        raise InputError(f"expose: {what} may; close the lens, or dim the display")
    return good
