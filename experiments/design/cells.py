"""What the display's cells make of a fringe, and its error in a view: sidebands, and the stairs they are."""

import math

import numpy as np
from numpy.typing import NDArray

from .fringes import MUCH_FINER, Fringe
from .view import Floats, View

__all__ = [
    "combined_errors",
    "seen_sidebands",
    "seen_stairs",
    "seen_stairs_of_noise",
    "sidebands",
    "stairs",
    "stairs_of_noise",
]

#: What blur leaves of a sideband, under which it is left out.
NOTHING = 1e-5


def stairs(coord: Floats, widths: tuple[Floats, ...], blur: float, period: float) -> Floats:
    """Error (cells) of a fringe of a period (cells) read through the display's cells, at coord."""
    return np.asarray(np.angle(sidebands(coord, widths, blur, period)[0]) * period / (2 * math.pi))


def stairs_of_noise(
    coord: Floats, widths: tuple[Floats, ...], blur: float, period: float
) -> tuple[Floats, Floats]:
    """(share of the contrast there, slope of the stairs) at coord: noise counts over the one, and over one
    plus the other where the stairs are undone."""
    whole, change = sidebands(coord, widths, blur, period)
    return np.abs(whole), np.asarray((change / whole).imag * period / (2 * math.pi))


def sidebands(
    coord: Floats, widths: tuple[Floats, ...], blur: float, period: float
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """1 + sum_k r_k exp(2 pi i k u), and its derivative.

    A cosine of frequency f shown on cells holds f + k as well, each with sinc(f + k), of which pixel
    (boxes of the widths) and blur leave M(f + k): r_k = (-1)^k f / (f + k) M(f + k) / M(f). For long periods
    its angle is the sawtooth of the cells, low-passed.
    """
    f = 1 / period
    whole, change = np.ones(np.shape(coord), np.complex128), np.zeros(np.shape(coord), np.complex128)
    base = _transfer(f, widths, blur)
    base = np.where(np.abs(base) > 1e-3, base, 1e-3)
    for k in (1, -1, 2, -2, 3, -3, 4, -4):
        if math.exp(-2 * (math.pi * blur) ** 2 * k * (k + 2 * f)) < NOTHING:
            continue
        left = (-1) ** k * f / (f + k) * _transfer(f + k, widths, blur) / base
        part = left * np.exp(2j * math.pi * k * coord)
        whole += part
        change += 2j * math.pi * k * part
    return whole, change


def _transfer(frequency: float, widths: tuple[Floats, ...], blur: float) -> Floats:
    left: Floats = np.asarray(math.exp(-2 * (math.pi * blur * frequency) ** 2))
    for width in widths:
        left = left * np.sinc(frequency * width)
    return left


def seen_sidebands(view: View, axis: str, period: float) -> NDArray[np.complex128]:
    """What the cells make of a fringe's complex amplitude, (H, W)."""
    blur, coord, widths = view.scene.pattern.blur_px, view.coordinate(axis), view.widths[axis]
    return view.kept(("cells", axis, period), lambda: sidebands(coord, widths, blur, period)[0])


def seen_stairs(view: View, axis: str, period: float) -> Floats:
    """Error of a fringe from the cells' stairs, (H, W)."""
    whole = seen_sidebands(view, axis, period)
    return view.kept(("stairs", axis, period), lambda: np.angle(whole) * period / (2 * math.pi))


def seen_stairs_of_noise(view: View, axis: str, period: float) -> tuple[Floats, Floats]:
    """What the stairs make of its noise, see stairs_of_noise."""
    blur, coord, widths = view.scene.pattern.blur_px, view.coordinate(axis), view.widths[axis]
    return view.kept(("noise", axis, period), lambda: stairs_of_noise(coord, widths, blur, period))


def combined_errors(groups: list[Fringe], errors: list[Floats]) -> Floats:
    """One error of the coordinate from those of every fringe, coarse to fine, as the decoder weighs them."""
    total, information, previous = errors[0], 0.0, math.inf
    for group, error in zip(groups, errors, strict=True):
        own = len(group.shifts) / group.period**2
        alone = group.period * MUCH_FINER < previous
        total = error if alone else total + own / (information + own) * (error - total)
        information, previous = own if alone else information + own, group.period
    return total
