"""Shape of the mirror: height and gradient, and how GLSL may evaluate the same."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .grid import Grid
from .record import Float, positive
from .scene import Scene

__all__ = ["Formula", "Surface", "from_grid", "surface_from_array"]

Height = Callable[[Float, Float], Float]
Gradient = Callable[[Float, Float], tuple[Float, Float]]
Both = Callable[[Float, Float], tuple[Float, Float, Float]]


@dataclass(frozen=True)
class Formula:
    """A closed form of `forms` by name, with all the numbers it takes (mm), so that GLSL can evaluate it."""

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
    """Surface through heights z (rows, cols) at x = x0 + col pitch, y = y0 + row pitch; mm; see `grid`."""
    return from_grid(Grid(z, x0, y0, pitch, pitch))


def from_grid(grid: Grid) -> Surface:
    """The surface that a height array makes."""
    return Surface(grid.height, grid.gradient, grid=grid, both=grid.evaluate)
