"""Floating-point frames: scaled to levels of 8 bits, so that results do not depend on the unit; pixels that
are not finite are left out."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optolever.errors import InputError

from .records import Correspondence

__all__ = ["Levels", "in_levels"]

#: The brightest sample is scaled to this level up to twice as much: a power of two keeps every digit.
_BRIGHT = 128.0


@dataclass(frozen=True, slots=True, eq=False)
class Levels:
    """frames (N, H, W); lost (H, W): pixels that are not finite in some frame, or None; unit: levels per unit
    of the frames that were given."""

    frames: NDArray[Any]
    lost: NDArray[np.bool_] | None = None
    unit: float = 1.0

    def inside(self, mask: ArrayLike | None) -> ArrayLike | None:
        """A mask (H, W) without the lost pixels; unchanged if there are none."""
        if self.lost is None or mask is None:
            return mask if self.lost is None else ~self.lost
        pixels = np.asarray(mask)
        fits = pixels.dtype == np.bool_ and pixels.shape == self.lost.shape
        return pixels & ~self.lost if fits else mask

    def restored(self, found: Correspondence) -> Correspondence:
        """Amplitude and offset in the unit of the frames."""
        if self.unit == 1:
            return found
        light = {name: getattr(found, name) / np.float32(self.unit) for name in ("amplitude", "offset")}
        return replace(found, **light)


def in_levels(frames: ArrayLike) -> Levels:
    """Frames scaled for decoding. InputError if no pixel is finite in all of them."""
    stack = np.asarray(frames)
    if stack.dtype.kind != "f" or stack.ndim != 3 or 0 in stack.shape:
        return Levels(stack)
    finite = np.isfinite(stack).all(axis=0)
    if not finite.any():
        raise InputError("decode: no pixel is finite in every frame, must be light")
    stack = stack.astype(np.float64)
    if not finite.all():
        stack[:, ~finite] = 0.0
    most = float(np.abs(stack).max())
    exponent = np.frexp(most / _BRIGHT)[1] - 1 if most > 0 else 0
    unit = float(np.ldexp(1.0, -int(exponent)))
    return Levels((stack * unit).astype(np.float32), None if finite.all() else ~finite, unit)
