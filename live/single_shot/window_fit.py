"""Two fringes fitted at once within a Gaussian window: the phase estimate of crossed.py.

Around every pixel the image is 1 + cos u + sin u + cos v + sin v with five coefficients, by least squares
with the window's weights. So the mean level and the other fringe do not leak into the phase, even where the
frame's edge truncates the window. There the estimate belongs to the mean of the truncated window, `shift`
away from its middle; the phase's slope corrects this, which makes the fit a local line (Fan 1993,
doi:10.1214/aos/1176349022).
The window is wide, so that its sums use cells of some pixels and its results are interpolated; the
interpolation error appears as change in the next pass.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["Fit", "Window"]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]
#: Least share of the window's weight for an estimate.
_LEAST = 0.02
#: Power of a window's share that weights its phase against that of neighbours.
_TRUST = 8
#: Least variance of a truncated window relative to the full one, for shifts along its corners.
_NARROW = 0.25


@dataclass(frozen=True, slots=True)
class Fit:
    """Of both fringes, in order u, v, each (H, W): phase relative to their carriers, half their amplitude."""

    phase: tuple[F32, F32]
    height: tuple[F32, F32]
    #: Sigma of the phase relative to a full window.
    growth: tuple[F32, F32]
    #: Mean level without the fringes.
    level: F32


@dataclass(frozen=True, slots=True)
class Window:
    """A Gaussian of rms `width` pixels over the known pixels of a frame (H, W), on cells of `cell` pixels.

    All else (R, C), in cells: known share of the weight; along columns and rows, shift of the mean of the
    known pixels, and its response to a step of one cell; sigma of a local line relative to a full window.
    """

    known: Mask
    share: F32
    width: float
    cell: int
    shift: tuple[F32, F32]
    stretch: tuple[F32, F32]
    growth: F32

    @classmethod
    def over(cls, known: Mask, width: float) -> "Window":
        """The window of this width over these pixels."""
        cell = max(1, int(width / 2.5))
        sigma = _sigma(width, cell)
        binned = _binned(known, cell)
        share, mean, spread = _moments(binned, sigma)
        stretch = (np.maximum(spread[0] / sigma**2, _NARROW), np.maximum(spread[1] / sigma**2, _NARROW))
        # the squared weights are a Gaussian, too: variance of a local line's value at 0
        least, middle, around = _moments(binned, sigma / math.sqrt(2))
        tilt = [m / (s * sigma**2) for m, s in zip(mean, stretch, strict=True)]
        lean = sum(t * (m - n) for t, m, n in zip(tilt, middle, mean, strict=True))
        wide = sum(t * t * np.maximum(s, 0) for t, s in zip(tilt, around, strict=True))
        growth = np.sqrt(least / np.maximum(share, 1e-6) ** 2 * ((1 - lean) ** 2 + wide))
        return cls(known, share, width, cell, mean, stretch, growth.astype(np.float32))

    def fit(self, image: F32, carriers: list[F64], *, cut: bool = True) -> Fit:
        """The fringes of an image (H, W) over carriers (u, v). Without `cut` the phase is that of a truncated
        window's mean, which is required while the phase may jump by a cycle.
        """
        phases = [_wrapped(carrier) for carrier in carriers]
        waves = [self.known.astype(np.float32)]
        waves += [waves[0] * wave(phase) for phase in phases for wave in (np.cos, np.sin)]
        lit = self.known * image
        matrix, right = np.empty((5, 5, *self.share.shape)), np.zeros((5, 3, *self.share.shape))
        for i, wave in enumerate(waves):
            right[i, 0] = self._mean(wave * lit)
            for j in range(i + 1):
                matrix[i, j] = matrix[j, i] = self._mean(wave * waves[j])
            matrix[i, i] += 1e-6  # keeps it regular
        right[2, 1] = right[4, 2] = 1.0
        solved = np.where(self.share > _LEAST, _solved(matrix, right), 0.0).astype(np.float32)
        level, *out = solved[:, 0]
        # inverse's diagonal at the sines: 2 in a full window
        spread = [np.where(self.share > _LEAST, own, np.float32(1e9)) for own in (solved[2, 1], solved[4, 2])]
        u, v = (self._lobe(out[k], -out[k + 1], cut) for k in (0, 2))
        of_u, of_v = (self._whole(self.growth * np.sqrt(np.maximum(0.5 * own, 1.0))) for own in spread)
        return Fit((u[0], v[0]), (u[1], v[1]), (of_u, of_v), self._whole(level))

    def _mean(self, plane: F32) -> F32:
        """Mean of a plane (H, W), 0 where unknown, over the known part of the window around every cell (R,
        C)."""
        blurred = _around(_binned(plane, self.cell), _sigma(self.width, self.cell), 0, 0)
        return np.asarray(blurred / np.maximum(self.share, np.float32(_LEAST)))

    def _lobe(self, real: F32, imag: F32, cut: bool) -> tuple[F32, F32]:
        """Phase and half amplitude (H, W), interpolated as complex values."""
        if cut:
            phase, size = self._at_middle(np.arctan2(imag, real)), np.hypot(real, imag)
            real, imag = size * np.cos(phase), size * np.sin(phase)
        real, imag = self._whole(real), self._whole(imag)
        return np.arctan2(imag, real), np.float32(0.5) * np.hypot(real, imag)

    def extended(self, phase: F64) -> F64:
        """A phase (H, W) without jumps; planes through the inside where the window is truncated.

        A fit without `cut` is curved there: the mean over a steep window is not the phase at its mean. Later
        passes do not detect curvature within a window.
        """
        rows, cols = (-size % self.cell for size in phase.shape)
        whole = np.pad(phase, ((0, rows), (0, cols)), mode="edge")
        cells = whole.reshape(len(self.share), self.cell, -1, self.cell).mean(axis=(1, 3), dtype=np.float64)
        trust = self.share**_TRUST
        plane = self._whole(_planes(cells, trust, _sigma(self.width, self.cell)))
        weight = np.clip(self._whole(trust), 0.0, 1.0)
        return np.asarray(weight * phase + (1.0 - weight) * plane)

    def _at_middle(self, phase: F32) -> F32:
        """The phase at each cell from the phases at the windows' means."""
        slopes = np.gradient(phase, axis=1), np.gradient(phase, axis=0)
        for shift, stretch, slope in zip(self.shift, self.stretch, slopes, strict=True):
            phase = phase - shift / stretch * slope
        return phase

    def _whole(self, cells: F32) -> F32:
        """From cells (R, C) to pixels (H, W), with linear extrapolation beyond the outermost cells'
        middles."""
        rows, cols = self.known.shape
        framed = np.pad(cells, 1, mode="reflect", reflect_type="odd")
        size = framed.shape[1] * self.cell, framed.shape[0] * self.cell
        whole = np.asarray(cv2.resize(framed, size, interpolation=cv2.INTER_LINEAR))
        return np.asarray(whole[self.cell : self.cell + rows, self.cell : self.cell + cols], np.float32)


def _sigma(width: float, cell: int) -> float:
    """Rms width in cells that, with the cell's width, gives the window's."""
    return math.sqrt(width**2 - (cell**2 - 1) / 12) / cell


def _binned(plane: F32 | Mask, cell: int) -> F32:
    """Mean of a plane (H, W) over every cell (R, C), 0 beyond it."""
    rows, cols = (-size % cell for size in plane.shape)
    whole = cv2.copyMakeBorder(plane.astype(np.float32), 0, rows, 0, cols, cv2.BORDER_CONSTANT)
    size = whole.shape[1] // cell, whole.shape[0] // cell
    return np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_AREA))


def _solved(matrix: F64, right: F64) -> F64:
    """matrix^-1 right, (5, 5, R, C) and (5, K, R, C), both overwritten; a positive matrix needs no pivots."""
    for i in range(5):
        for j in range(i + 1, 5):
            factor = matrix[j, i] / matrix[i, i]
            matrix[j, i + 1 :] -= factor * matrix[i, i + 1 :]
            right[j] -= factor * right[i]
    for i in range(4, -1, -1):
        right[i] -= np.einsum("jrc,jkrc->krc", matrix[i, i + 1 :], right[i + 1 :])
        right[i] /= matrix[i, i]
    return right


def _moments(known: F32, sigma: float) -> tuple[F32, tuple[F32, F32], tuple[F32, F32]]:
    """Known share of a window's weight, its mean and its variance along columns and rows."""
    share = _around(known, sigma, 0, 0)
    over = np.reciprocal(np.maximum(share, np.float32(1e-6)), dtype=np.float32)
    mean = _around(known, sigma, 1, 0) * over, _around(known, sigma, 0, 1) * over
    square = _around(known, sigma, 2, 0) * over, _around(known, sigma, 0, 2) * over
    return share, mean, (square[0] - mean[0] ** 2, square[1] - mean[1] ** 2)


def _planes(values: F64, trust: F32, sigma: float) -> F32:
    """Value at every cell of the plane through all cells around, weighted by trust and distance."""
    powers = ((0, 0), (1, 0), (0, 1))
    matrix = np.empty((*values.shape, 3, 3))
    right = np.empty((*values.shape, 3, 1))
    for i, (along, down) in enumerate(powers):
        right[..., i, 0] = _around((trust * values).astype(np.float32), sigma, along, down)
        for j, (also, below) in enumerate(powers):
            matrix[..., i, j] = _around(trust, sigma, along + also, down + below)
        matrix[..., i, i] += 1e-9  # without trusted cells: 0
    return np.asarray(np.linalg.solve(matrix, right)[..., 0, 0], np.float32)


def _around(plane: F32, sigma: float, along: int, down: int) -> F32:
    """Sums of a Gaussian's weights times the plane times powers of the distance along columns and rows."""
    reach = math.ceil(4 * sigma)
    place = np.arange(-reach, reach + 1, dtype=np.float64)
    weight = np.exp(-0.5 * (place / sigma) ** 2)
    weight /= weight.sum()
    lines = weight * place**along, weight * place**down
    return np.asarray(cv2.sepFilter2D(plane, cv2.CV_32F, *lines, borderType=cv2.BORDER_CONSTANT))


def _wrapped(phase: F64) -> F32:
    """Within half a cycle of 0, where float32 is good to 1e-7."""
    cycles = phase / (2 * np.pi)
    return np.asarray(2 * np.pi * (cycles - np.rint(cycles)), np.float32)
