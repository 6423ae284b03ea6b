"""Shape of the mirror: height and gradient, in closed form or of a height array; GLSL evaluates the same.

A height array is an interpolating cubic B-spline:

    z(x, y) = sum_ij w_i(ty) w_j(tx) c[iy + i, ix + j], i, j = 0..3
    gx = (x - x0)/dx, ix = min(floor(gx), cols - 2), tx = gx - ix; likewise y with rows
    w(t) = ((1-t)^3, 3 t^3 - 6 t^2 + 4, -3 t^3 + 3 t^2 + 3 t + 1, t^3) / 6

where c is (rows + 2, cols + 2) (one more node on every side, not-a-knot: cubics are reproduced exactly).
x and y are clamped to the grid first, so the surface continues level, and without a step, beyond its edges.
Source: Unser, Splines, IEEE Signal Processing Magazine 16(6), 1999, doi:10.1109/79.799930.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy

from optolever import InputError
from optolever.kernels import exact

from .fields import Float, Record, freeze, number, positive
from .scene import Scene

__all__ = ["Formula", "Grid", "Surface", "from_grid", "surface_from_array"]

_LEAST = 4

Height = Callable[[Float, Float], Float]
Gradient = Callable[[Float, Float], tuple[Float, Float]]
Both = Callable[[Float, Float], tuple[Float, Float, Float]]


@dataclass(frozen=True, eq=False)
class Grid(Record):
    """Heights z (rows, cols) in mm at x = x0 + col dx, y = y0 + row dy (mm).

    coefficients (rows + 2, cols + 2): the B-spline's, as described in this file's docstring.
    """

    z: Float
    x0: float
    y0: float
    dx: float
    dy: float
    coefficients: Float = field(init=False)

    def __post_init__(self) -> None:
        z = np.array(self.z, dtype=np.float64, order="C")
        if z.ndim != 2 or min(z.shape) < _LEAST:
            raise InputError(f"grid.z has shape {z.shape}: must be at least {_LEAST} x {_LEAST} heights")
        if not np.all(np.isfinite(z)):
            raise InputError(
                f"grid.z has {np.count_nonzero(~np.isfinite(z))} heights that are not finite: must have 0"
            )
        freeze(self, x0=number("grid.x0", self.x0), y0=number("grid.y0", self.y0))
        freeze(self, dx=positive("grid.dx", self.dx), dy=positive("grid.dy", self.dy))
        coefficients = np.ascontiguousarray(_prefilter(_prefilter(z).T).T)
        z.flags.writeable = coefficients.flags.writeable = False
        freeze(self, z=z, coefficients=coefficients)

    def height(self, x: Float, y: Float) -> Float:
        """Heights (mm) at x, y (mm, any shapes that broadcast)."""
        return self.evaluate(x, y)[0]

    def gradient(self, x: Float, y: Float) -> tuple[Float, Float]:
        """Slopes (dz/dx, dz/dy) at x, y (mm); 0 beyond the edges, across them."""
        return self.evaluate(x, y)[1:]

    def evaluate(self, x: Float, y: Float) -> tuple[Float, Float, Float]:
        """Height and slopes (z, dz/dx, dz/dy) at x, y (mm)."""
        x, y = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        flat_x, flat_y = np.ascontiguousarray(x).ravel(), np.ascontiguousarray(y).ravel()
        z, zx, zy = (np.empty(x.size) for _ in range(3))
        _spline(self.coefficients, self.x0, self.y0, self.dx, self.dy, flat_x, flat_y, z, zx, zy)
        return z.reshape(x.shape), zx.reshape(x.shape), zy.reshape(x.shape)


def _prefilter(z: Float) -> Float:
    """Coefficients (n, m) -> (n + 2, m): (c[-1] + 4 c[0] + c[1])/6 = z, 4th difference 0 at ends."""
    n = len(z) + 2
    bands = np.zeros((9, n))  # row 4 + i - j holds the matrix element (i, j)
    bands[5, :-2], bands[4, 1:-1], bands[3, 2:] = 1 / 6, 4 / 6, 1 / 6
    for j, weight in enumerate((1.0, -4.0, 6.0, -4.0, 1.0)):
        bands[4 - j, j] = weight
        bands[4 + j, n - 1 - j] = weight
    right = np.zeros((n, z.shape[1]))
    right[1:-1] = z
    solved: Float = scipy.linalg.solve_banded((4, 4), bands, right)
    return solved


@dataclass(frozen=True)
class Formula:
    """A closed form of `dent_forms` by name, with all its numbers (mm), so that GLSL can evaluate it."""

    name: str
    params: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Surface:
    """Height z (mm, > 0 into the medium) and gradient (dz/dx, dz/dy) as callables of arrays x, y (mm).

    formula: the closed form they evaluate, if it has a name; grid: the height array, if they interpolate one;
    both: a callable that gives (z, dz/dx, dz/dy) at once, if that is cheaper.
    """

    height: Height
    gradient: Gradient
    formula: Formula | None = None
    grid: Grid | None = None
    both: Both | None = None

    def evaluate(self, x: Float, y: Float) -> tuple[Float, Float, Float]:
        """Height and slopes (z, dz/dx, dz/dy) at x, y (mm)."""
        if self.both is not None:
            return self.both(x, y)
        return self.height(x, y), *self.gradient(x, y)

    def sampled(self, scene: Scene, pitch: float) -> Surface:
        """This surface as a grid over the scene's mirror, nodes on its edges, at most `pitch` mm apart."""
        pitch = positive("pitch", pitch)
        cols, rows = (
            max(4, int(np.ceil(side / pitch - 1e-9)) + 1)
            for side in (scene.mirror.length, scene.mirror.width)
        )
        dx, dy = scene.mirror.length / (cols - 1), scene.mirror.width / (rows - 1)
        x, y = np.meshgrid(dx * np.arange(cols), dy * np.arange(rows))
        return from_grid(Grid(self.height(x, y), 0.0, 0.0, dx, dy))


def surface_from_array(z: Any, x0: float, y0: float, pitch: float) -> Surface:
    """Surface through heights z (rows, cols) at x = x0 + col pitch, y = y0 + row pitch; mm; see `Grid`."""
    return from_grid(Grid(z, x0, y0, pitch, pitch))


def from_grid(grid: Grid) -> Surface:
    """The surface that a height array makes."""
    return Surface(grid.height, grid.gradient, grid=grid, both=grid.evaluate)


@exact
def _weights(t, w, s):  # type: ignore[no-untyped-def]
    u = 1.0 - t
    w[0], w[3] = u * u * u / 6.0, t * t * t / 6.0
    w[1], w[2] = (4.0 + t * t * (3.0 * t - 6.0)) / 6.0, (4.0 + u * u * (3.0 * u - 6.0)) / 6.0
    s[0], s[3] = -0.5 * u * u, 0.5 * t * t
    s[1], s[2] = t * (1.5 * t - 2.0), -u * (1.5 * u - 2.0)


@exact
def _spline(c, x0, y0, dx, dy, x, y, z, zx, zy):  # type: ignore[no-untyped-def]
    rows, cols = c.shape[0] - 2, c.shape[1] - 2
    wx, wy, sx, sy = np.empty(4), np.empty(4), np.empty(4), np.empty(4)
    for k in range(x.size):
        gx, gy = (x[k] - x0) / dx, (y[k] - y0) / dy
        if np.isnan(gx) or np.isnan(gy):
            z[k] = zx[k] = zy[k] = np.nan
            continue
        cx, cy = min(max(gx, 0.0), cols - 1.0), min(max(gy, 0.0), rows - 1.0)
        ix, iy = min(int(cx), cols - 2), min(int(cy), rows - 2)
        _weights(cx - ix, wx, sx)
        _weights(cy - iy, wy, sy)
        height = slope_x = slope_y = 0.0
        for i in range(4):
            a = b = 0.0
            for j in range(4):
                a += wx[j] * c[iy + i, ix + j]
                b += sx[j] * c[iy + i, ix + j]
            height += wy[i] * a
            slope_x += wy[i] * b
            slope_y += sy[i] * a
        z[k] = height
        zx[k] = slope_x / dx if cx == gx else 0.0
        zy[k] = slope_y / dy if cy == gy else 0.0
