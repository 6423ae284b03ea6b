"""Model of the image of a crossed fringe, and Gauss-Newton steps of its fit.

    frame = level + amplitude_u cos 2 pi (u / period + du) + amplitude_v cos 2 pi (v / period + dv)

u, v are the rest map, in pattern pixels; the unknowns of a cell of 2 x 2 or 4 x 4 pixels are the
displacements du, dv in turns (periods), level and amplitudes. A step takes the residual of the frame,
multiplies it by cosine and sine of both carriers, sums it into cells and blurs it by a window of half a
period rms; the carriers' leakage into one another vanishes with the residual (demodulation of the residual,
Takeda, Ina and Kobayashi, JOSA 72:156, 1982, iterated), and each step also undoes some of the window's
smoothing (van Cittert)."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import cv2
import numpy as np

from optolever.arrays import Cells, Frame, Pixels
from optolever.blocks import over_rows
from optolever.kernels import inlined, kernel

__all__ = ["CELLS", "Carriers", "Fit", "State", "fit_step", "model", "to_cells", "window_mean"]

_f4 = np.float32
CELLS = (1, 2, 4, 8)  # pixels along the side of a cell
_BLOCK = 24  # rows of cells a thread takes at a time
_LEAST_SHARE = 0.02  # of a window: below it the sums are divided by this


@dataclass(frozen=True, eq=False)
class Carriers:
    """Constants of the image model for a rig at rest.

    period: pattern pixels; cell: pixels along its side; window: taps (K,) of the blur, in cells; turn_u,
    turn_v: the rest map in turns, (H, W); lit (H, W): 1 where the rest map is known, else 0; ends (4,): least
    and largest turn on the pattern along u, along v; full: level from which on a pixel is saturated; share
    (R, C): part of a cell's window that is lit."""

    period: float
    cell: int
    window: Annotated[Cells, "taps"]
    turn_u: Annotated[Pixels, "H W"]
    turn_v: Annotated[Pixels, "H W"]
    lit: Annotated[Pixels, "H W"]
    ends: Annotated[Cells, "4"]
    full: float
    share: Annotated[Cells, "R C"]

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of cells."""
        rows, cols = self.share.shape
        return int(rows), int(cols)

    @cached_property
    def rest(self) -> Pixels:
        """turn_u, turn_v and lit in columns of cells, (3, H, cell, C)."""
        return np.stack([self.by_columns(part) for part in (self.turn_u, self.turn_v, self.lit)])

    @cached_property
    def spread(self) -> float:
        """Standard deviation of the window, cells: half of the longer period in the picture."""
        away = np.arange(self.window.size) - self.window.size // 2
        return math.sqrt(float(np.square(away) @ self.window / self.window.sum()))

    def by_columns(self, pixels: Frame) -> Frame:
        """Pixels (H, W) as (H, cell, C): the first of every cell, then the second ones."""
        rows, cols = pixels.shape
        return np.ascontiguousarray(pixels.reshape(rows, cols // self.cell, self.cell).swapaxes(1, 2))


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """The model's unknowns, planes (5, R, C): du, dv (turns), level, amplitude_u, amplitude_v (levels)."""

    planes: Annotated[Cells, "5 R C"]

    @property
    def displacement(self) -> Cells:
        """du, dv (2, R, C), turns."""
        return self.planes[:2]

    @property
    def level(self) -> Cells:
        """(R, C)."""
        level: Cells = self.planes[2]
        return level


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Of a step, before it: squares (R, C): mean square residual of each cell, levels^2, over the cells;
    share (R, C): of the window that is lit, on the pattern and not saturated."""

    squares: Cells
    share: Cells

    def residual(self, carriers: Carriers) -> Cells:
        """Mean square residual in the window (R, C), levels^2."""
        whole = np.maximum(self.share, _f4(_LEAST_SHARE))
        return np.asarray(window_mean(self.squares, carriers.window) / whole, _f4)


def fit_step(carriers: Carriers, frame: Frame, state: State) -> tuple[State, Fit]:
    """One Gauss-Newton step of every cell. frame: of whole cells, by columns of cells, (H, cell, C)."""
    rows, cols = carriers.shape
    sums = np.empty((7, rows, cols), _f4)
    args = frame, carriers.rest, state.planes, carriers.ends, _f4(carriers.full), sums
    over_rows(lambda start, stop: _residuals(*args, start, stop), rows, _BLOCK)
    for plane in sums[:6]:
        cv2.sepFilter2D(
            plane, cv2.CV_32F, carriers.window, carriers.window, plane, borderType=cv2.BORDER_CONSTANT
        )
    planes = np.empty_like(state.planes)
    over_rows(lambda start, stop: _updated(sums, state.planes, planes, start, stop), rows, 64)
    return State(planes), Fit(sums[6], sums[5])


def model(carriers: Carriers, state: State) -> Pixels:
    """The picture (H, W) of a state, levels."""
    rows, cols = carriers.lit.shape
    picture = np.empty_like(carriers.rest[2])
    over_rows(lambda start, stop: _pictured(carriers.rest, state.planes, picture, start, stop), rows, _BLOCK)
    return np.ascontiguousarray(picture.swapaxes(1, 2).reshape(rows, cols))


def to_cells(pixels: Pixels, cell: int) -> Cells:
    """Means over cells."""
    rows, cols = pixels.shape
    means: Cells = pixels.reshape(rows // cell, cell, cols // cell, cell).mean((1, 3), dtype=np.float64)
    return means.astype(_f4)


def window_mean(plane: Cells, window: Cells) -> Cells:
    """A plane (R, C) filtered by the window; zero beyond its border."""
    return np.asarray(cv2.sepFilter2D(plane, cv2.CV_32F, window, window, borderType=cv2.BORDER_CONSTANT), _f4)


@inlined
def _cos_sin(turn):  # type: ignore[no-untyped-def]
    """Cosine and sine of 2 pi turn, to 4e-6: polynomials of the half angle."""
    y = turn - np.rint(turn)
    z = y * y
    s = y * (
        _f4(3.14159265)
        + z * (_f4(-5.16771278) + z * (_f4(2.55016404) + z * (_f4(-0.59926453) + z * _f4(0.0821458))))
    )
    c = _f4(1) + z * (_f4(-4.93480220) + z * (_f4(4.05871213) + z * (_f4(-1.33526277) + z * _f4(0.23533063))))
    return _f4(1) - _f4(2) * s * s, _f4(2) * s * c


@inlined
def _turn_of(s, c):  # type: ignore[no-untyped-def]
    """atan2(s, c) / 2 pi, to 1e-6 turns."""
    far, near = max(abs(s), abs(c)), min(abs(s), abs(c))
    t = near / max(far, _f4(1e-20))
    z = t * t
    tail = _f4(-0.11643287) + z * (_f4(0.05265332) - z * _f4(0.0117212))
    series = _f4(0.99997726) + z * (_f4(-0.33262347) + z * (_f4(0.19354346) + z * tail))
    p = _f4(0.15915494) * t * series
    p = _f4(0.25) - p if abs(s) > abs(c) else p
    p = _f4(0.5) - p if c < _f4(0) else p
    return -p if s < _f4(0) else p


@kernel
def _row(planes, y, cell, line):  # type: ignore[no-untyped-def]
    """line (5, C + 2): the state (5, R, C) on a row of pixels, linear between rows of cells."""
    rows, cols = planes.shape[1:]
    i, down = y // cell, (_f4(y % cell) + _f4(0.5)) / _f4(cell) - _f4(0.5)
    other = min(max(i + 1 if down > _f4(0) else i - 1, 0), rows - 1)
    down = abs(down)
    for k in range(5):
        for j in range(cols):
            line[k, j + 1] = (_f4(1) - down) * planes[k, i, j] + down * planes[k, other, j]
        line[k, 0], line[k, cols + 1] = line[k, 1], line[k, cols]


@kernel
def _here(line, rest, y, m, here):  # type: ignore[no-untyped-def]
    """here (5, C): a row's state at the m-th pixels of its cells, linear between them; u, v whole."""
    cell, cols = rest.shape[2], rest.shape[3]
    along = (_f4(m) + _f4(0.5)) / _f4(cell) - _f4(0.5)
    side = 2 if along > _f4(0) else 0
    along = abs(along)
    for k in range(5):
        for j in range(cols):
            here[k, j] = (_f4(1) - along) * line[k, j + 1] + along * line[k, j + side]
    for k in range(2):
        for j in range(cols):
            here[k, j] += rest[k, y, m, j]


@kernel
def _pictured(rest, planes, out, start, stop):  # type: ignore[no-untyped-def]
    """out (H, cell, C): the picture of a state, by columns of cells."""
    cell, cols = rest.shape[2], rest.shape[3]
    line, here = np.empty((5, cols + 2), np.float32), np.empty((5, cols), np.float32)
    for y in range(start, stop):
        _row(planes, y, cell, line)
        for m in range(cell):
            _here(line, rest, y, m, here)
            for j in range(cols):
                out[y, m, j] = here[2, j] + here[3, j] * _cos_sin(here[0, j])[0]
            for j in range(cols):
                out[y, m, j] += here[4, j] * _cos_sin(here[1, j])[0]


@kernel
def _residuals(frame, rest, planes, ends, full, out, start, stop):  # type: ignore[no-untyped-def]
    """out (7, R, C): means over cells of r, r cos u, r sin u, r cos v, r sin v, of the pixels that count and
    of r^2; r = 0 in the others. One short loop each: with few arrays it becomes vector instructions."""
    cols = out.shape[2]
    cell = frame.shape[1]
    area = _f4(1) / _f4(cell * cell)
    line, here = np.empty((5, cols + 2), np.float32), np.empty((5, cols), np.float32)
    cos_u, sin_u = np.empty(cols, np.float32), np.empty(cols, np.float32)
    cos_v, sin_v = np.empty(cols, np.float32), np.empty(cols, np.float32)
    counted, whole, r = np.empty(cols, np.float32), np.empty(cols, np.float32), np.empty(cols, np.float32)
    for i in range(start, stop):
        for k in range(7):
            for j in range(cols):
                out[k, i, j] = _f4(0)
        for n in range(cell):
            y = i * cell + n
            _row(planes, y, cell, line)
            for m in range(cell):
                _here(line, rest, y, m, here)
                for j in range(cols):
                    cos_u[j], sin_u[j] = _cos_sin(here[0, j])
                for j in range(cols):
                    cos_v[j], sin_v[j] = _cos_sin(here[1, j])
                for j in range(cols):
                    whole[j] = _f4(frame[y, m, j])
                for j in range(cols):
                    u, v = here[0, j], here[1, j]
                    on = (u > ends[0]) & (u < ends[1]) & (v > ends[2]) & (v < ends[3]) & (whole[j] < full)
                    counted[j] = rest[2, y, m, j] * area if on else _f4(0)
                for j in range(cols):
                    whole[j] -= here[2, j] + here[3, j] * cos_u[j]
                for j in range(cols):
                    whole[j] -= here[4, j] * cos_v[j]
                for j in range(cols):
                    r[j] = whole[j] * counted[j]
                for j in range(cols):
                    out[0, i, j] += r[j]
                for j in range(cols):
                    out[1, i, j] += r[j] * cos_u[j]
                for j in range(cols):
                    out[2, i, j] += r[j] * sin_u[j]
                for j in range(cols):
                    out[3, i, j] += r[j] * cos_v[j]
                for j in range(cols):
                    out[4, i, j] += r[j] * sin_v[j]
                for j in range(cols):
                    out[5, i, j] += counted[j]
                for j in range(cols):
                    out[6, i, j] += r[j] * whole[j]


@kernel
def _updated(sums, before, after, start, stop):  # type: ignore[no-untyped-def]
    """after, before (5, R, C): State.planes."""
    cols = sums.shape[2]
    over = np.empty(cols, np.float32)
    for i in range(start, stop):
        for j in range(cols):
            over[j] = _f4(1) / max(sums[5, i, j], _f4(_LEAST_SHARE))
        for j in range(cols):
            after[2, i, j] = before[2, i, j] + sums[0, i, j] * over[j]
        for axis in range(2):  # a loop of its own each: with fewer arrays it becomes vector instructions
            for j in range(cols):
                c = before[3 + axis, i, j] + _f4(2) * sums[1 + 2 * axis, i, j] * over[j]
                s = _f4(-2) * sums[2 + 2 * axis, i, j] * over[j]
                after[3 + axis, i, j] = np.sqrt(c * c + s * s)
                after[axis, i, j] = before[axis, i, j] + _turn_of(s, c)
