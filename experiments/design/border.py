"""What the pattern's border does to a fringe: light is missing beyond it.

Through a Gaussian of rms s (blur and pixel) at a distance d inside the border, the fringe keeps
rho = erfc(-(d + i s^2 w) / (sqrt 2 s)) / 2 of its complex amplitude, w = 2 pi / P: a share |rho| of its
contrast and a shift arg(rho) / w away from the border. The decoder takes off the shift for the usual
pixel; what its own width differs by stays.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import wofz

from .view import Floats, View

Complex = NDArray[np.complex128]

ROUNDS = 12
#: Spreads from the border at which it does nothing.
FAR = 8.0

__all__ = ["Border", "border_effect", "border_of", "usual_width"]


class Border:
    """Per pixel (H, W): lost, share of the contrast that the decoder believes lost; shift, what it takes off;
    left, what stays of the true shift (cells, signed)."""

    __slots__ = ("left", "lost", "shift")

    def __init__(self, lost: Floats, shift: Floats, left: Floats) -> None:
        self.lost, self.shift, self.left = lost, shift, left


def border_effect(distance: Floats, spread: Floats | float, period: float) -> tuple[Floats, Floats]:
    """(share of the contrast lost, shift inwards in cells) at a distance (cells) inside one border."""
    turn = 2 * math.pi / period
    far = np.minimum(distance / spread, FAR)
    z: Complex = -(far + 1j * spread * turn) / math.sqrt(2)
    # erfc(z) = exp(-z^2) w(i z), for the half plane where w does not grow
    rho = np.where(z.real < 0, 2 - _erfc(-z), _erfc(z)) / 2
    return 1 - np.abs(rho), np.angle(rho) / turn


def border_of(view: View, axis: str, period: float, blur_used: float) -> Border:
    """Both borders of an axis together; blur_used: what the decoder takes for the blur."""
    widths, coord = view.widths[axis], view.coordinate(axis)
    blur = view.scene.pattern.blur_px
    usual = usual_width(view, axis)
    assumed = math.sqrt(blur_used**2 + usual**2 / 12 + 1e-6)
    lost, shift, left = (np.zeros(coord.shape) for _ in range(3))
    for sign, distance in ((1.0, coord + 0.5), (-1.0, view.extent(axis) - 0.5 - coord)):
        inside = np.nan_to_num(distance, nan=-FAR)
        spread = np.sqrt(blur**2 + (widths[0] ** 2 + widths[1] ** 2) / 12 + 1e-6)
        near = inside < FAR * np.maximum(spread, assumed) + 1
        inside, spread = inside[near], spread[near]
        _, away = border_effect(inside, spread, period)
        # the decoder looks its correction up where it believes to be
        place = inside
        for _ in range(ROUNDS):
            share, believed = border_effect(place, assumed, period)
            place = inside + away - believed
        lost[near] += share
        shift[near] += sign * believed
        left[near] += sign * (away - believed)
    return Border(lost, shift, left)


def usual_width(view: View, axis: str) -> float:
    """The width of a pixel (cells) that the decoder assumes for all."""
    return sum(float(np.median(width[view.visible])) for width in view.widths[axis])


def _erfc(z: Complex) -> Complex:
    return np.asarray(np.exp(-(z**2)) * wofz(1j * z))
