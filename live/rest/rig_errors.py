"""The common error of heights by the errors of a rig's numbers, of typed ones as of calibrated ones.

A cell's slopes follow its displacement (du, dv) by a 2 x 2 matrix, and a height is their sum along the cells.
An error of the rig changes the matrix M of rest to M', and heights by the ratio <M', M> / <M, M>. Independent
errors add in quadrature. A cover glass and the light of a display's cells are left out."""

import math

import numpy as np

from optolever.arrays import Floats, Mask
from optolever.scene import Scene, adjusted, parameter_values, rig_covariance

from ..fringe.chord import slopes_at
from ..fringe.rays_at_rest import RestRays, rest_rays

__all__ = ["relative_error"]

_TURNS = 1e-3  # of a turn: of the differences
_STEP = 0.2  # of a standard deviation
_CELLS = 24  # rows and columns of the grid, at most


def relative_error(scene: Scene, lit: Mask, cell: int, period: float) -> float:
    """Standard deviation of a height by the scene's covariance, relative; 0 of an exact scene. lit (R, C):
    cells; cell: pixels along a side; period: pattern pixels a turn."""
    known = rig_covariance(scene)
    if known is None:
        return 0.0
    by = max(1, -(-max(lit.shape) // _CELLS))
    rows, cols = (size // by for size in lit.shape)
    use = lit[: rows * by, : cols * by].reshape(rows, by, cols, by).all(axis=(1, 3))
    if not use.any():
        return 0.0
    values, grid = parameter_values(scene), (rows, cols, by * cell, period)
    rest = _slopes(rest_rays(scene, *grid))[:, use]
    power, total = np.square(rest).sum(axis=0), 0.0
    for row in known.root:
        moved = {name: values[name] + _STEP * by for name, by in zip(known.names, row, strict=True) if by}
        other = _slopes(rest_rays(adjusted(scene, moved), *grid))[:, use]
        change = ((other * rest).sum(axis=0) / power - 1) / _STEP
        total += float(np.median(np.square(change)))
    return math.sqrt(total)


def _slopes(rays: RestRays) -> Floats:
    """Change of the height from a cell to the next, along columns and rows, by a turn of du, dv (4, R, C)."""
    steps, zero = np.stack([rays.step_u, rays.step_v]), np.zeros(rays.planes.shape[1:])

    def at(du: float, dv: float) -> Floats:
        return slopes_at(rays.planes, steps, np.stack([zero + du, zero + dv]), zero)

    parts = [(at(*(_TURNS * t)) - at(*(-_TURNS * t))) / (2 * _TURNS) for t in np.eye(2)]
    return np.asarray(np.concatenate(parts) * rays.directions[2])
