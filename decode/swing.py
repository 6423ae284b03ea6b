"""Blur from how a fringe's contrast swings with the place in the cell, where nothing else tells it.

Cells turn a fringe of frequency f = 1/P into itself and sidebands of frequency f + m, see cells. The contrast
that a pixel of w cells sees at u is then

    C(u) = C |1 + r_- exp(-2 pi i u) + r_+ exp(2 pi i u)|,
    r_m = (-1)^m f / (f + m) sinc((f + m) w) / sinc(f w) exp(-2 (pi b)^2 ((f + m)^2 - f^2)),

whatever C is: no other fringe nor white and black are needed, and pixels may keep step with the cells, as
long as they do not all lie at the same place of one. An error of r P / 2 pi cells in a coordinate shows in a
hundred pixels' contrasts as soon as it does in one pixel's coordinate.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Blur", "Contrasts", "blur_by_swing", "seems_to_swing"]

F64 = NDArray[np.float64]
#: Pixels at least, and for a first look.
_FEWEST, _A_FEW = 256, 64
#: Standard errors of the swing that it has at least; swing out of phase with the cells (which only something
#: else makes), and excess over that of a display without blur, as shares of it, at most.
_SURE, _ASTRAY = 5.0, 0.25
#: Steps in which the blur is found; rounds in which places are freed of the stairs.
_STEPS, _ROUNDS = 3, 2
#: Mean square of a parabola that is none besides the others.
_ALIKE = 1e-9


@dataclass(frozen=True, slots=True)
class Blur:
    """Rms Gaussian blur, cells, and the error of its square, rms, cells^2."""

    rms: float
    square_error: float


@dataclass(frozen=True, slots=True)
class Contrasts:
    """Of some pixels (K,): contrast of a fringe (any unit), place (decoded, cells), footprint along either
    side (2, K), cells, and where in the image, -1 to 1 (2, K)."""

    contrast: F64
    place: F64
    sides: F64
    at: F64


def seems_to_swing(seen: Contrasts, period: float) -> bool:
    """Whether the contrast of some pixels may swing: what a few tell is enough to ask the others."""
    if len(seen.place) < _A_FEW or period <= 2:
        return False
    share, _, error = _prepared(seen, 1 / period)(0.0)
    return share > error


def blur_by_swing(seen: Contrasts, period: float) -> Blur | None:
    """Blur of a fringe of that period (cells), None where the contrast does not tell it."""
    if len(seen.place) < _FEWEST or period <= 2:
        return None
    f = 1 / period
    swing, lever, square = _prepared(seen, f), 2 * np.pi**2 * (1 - 2 * f), 0.0
    share, astray, error = swing(square)
    if not 0 < share < 1 + _ASTRAY or _SURE * error > 1:
        return None
    for _ in range(_STEPS):
        # the more blur is reckoned with, the larger what is seen is against it
        square = max(square - np.log(share) / lever, 0.0)
        share, astray, error = swing(square)
        if share <= 0 or _SURE * error > 1:
            return None
    if abs(astray) > _ASTRAY + error:
        return None
    return Blur(float(np.sqrt(square)), float(np.hypot(error, astray)) / lever)


def _prepared(seen: Contrasts, f: float) -> Callable[[float], tuple[float, float, float]]:
    """_swing of a squared blur."""
    left = np.prod(np.sinc(f * seen.sides), axis=0)
    level = seen.contrast / left
    level = level / np.median(level)
    up, down = (_of_cells(f, m, seen.sides) / left for m in (1, -1))
    # what changes slowly over the image is light, or the footprint, and none of the cells' doing
    slow = _slow(*seen.at)
    rest = _without(level, slow)
    return lambda square: _swing(square, f, up, down, seen.place, slow, rest)


def _of_cells(f: float, m: int, sides: F64) -> F64:
    """Amplitude of a sideband that nothing blurs but the footprint."""
    share: F64 = (-1) ** m * f / (f + m) * np.prod(np.sinc((f + m) * sides), axis=0)
    return share


def _swing(
    square: float, f: float, up: F64, down: F64, place: F64, slow: tuple[F64, F64], rest: F64
) -> tuple[float, float, float]:
    """Of a squared blur: seen swing over what it should be, the same of a swing a quarter of a cell aside,
    and their standard error."""
    above, below = (
        side * np.exp(-2 * np.pi**2 * square * ((f + m) ** 2 - f**2)) for m, side in ((1, up), (-1, down))
    )
    turn, light = 2 * np.pi * place, np.ones(len(place), np.complex128)
    for _ in range(_ROUNDS):
        wave = np.exp(1j * turn)
        light = 1 + above * wave + below / wave
        turn = 2 * np.pi * place - np.angle(light) / f
    model = _without(np.abs(light), slow)
    aside = _without(np.abs(1 + 1j * (above * wave - below / wave)), slow)
    power = _product(model, model) + 1e-30
    share, astray = _product(model, rest) / power, _product(aside, rest) / (_product(aside, aside) + 1e-30)
    noise = float(np.mean((rest - share * model) ** 2))
    return share, astray, float(np.sqrt(noise / power))


def _slow(row: F64, col: F64) -> tuple[F64, F64]:
    """Parabolas over the image (6, K), and the inverse of their products (6, 6)."""
    basis = np.stack([np.ones(len(row)), row, col, row * row, row * col, col * col])
    products = np.einsum("ik,jk->ij", basis, basis)
    # of few lines some are alike
    return basis, np.linalg.inv(products + _ALIKE * len(row) * np.eye(len(basis)))


def _without(values: F64, slow: tuple[F64, F64]) -> F64:
    """Less the nearest parabola. Sums by einsum: threads of a matrix product take longer to wake up."""
    basis, inverse = slow
    left: F64 = values - np.einsum("i,ik->k", inverse @ np.einsum("ik,k->i", basis, values), basis)
    return left


def _product(one: F64, other: F64) -> float:
    return float(np.einsum("k,k->", one, other))
