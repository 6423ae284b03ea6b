"""The Cramer-Rao bound of a height's error, which a test compares the solver with.

By algebra on the measurement: noise of u and v moves every pixel's slopes, the increment between
two pixels integrates the cubic through four slopes, and the height's differences are these increments, which
depend on the height themselves. For noise of variance one the best linear estimate of the heights w from
J w = B noise has the covariance block of the inverse of [[B B^T, J, 0], [J^T, 0, a], [0, a^T, 0]], a the mean
that the anchor knows; taken at every third pixel. Slopes come from the law of reflection, their derivatives
from central differences: nothing of the solver is used.
"""

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from optolever.arrays import Floats
from optolever.scene import Scene, Trace

EVERY = 3  # pixels: where the bound is taken
_CUBIC = ((-1, 13, 13, -1), (9, 19, -5, 1), (1, -5, 19, 9))  # / 24: inside, at either end


def least_variance(scene: Scene, truth: Trace, cols: int) -> Floats:
    """Least variance of z for noise of 1 px, at every EVERY-th pixel of the first `cols` columns, mm^2."""
    rows = truth.u.shape[0]
    pick = (slice(None), slice(0, cols))
    origins, directions = (part[pick] for part in scene.camera.rays())
    t = np.einsum("ijk,ijk->ij", np.stack([truth.x, truth.y, truth.z], -1)[pick] - origins, directions)
    u, v = truth.u[pick], truth.v[pick]

    def slope(du: float = 0.0, dv: float = 0.0, dt: float = 0.0) -> tuple[Floats, Floats]:
        return _slopes(scene, u + du, v + dv, t + dt)

    (pu, qu), (pv, qv), (pt, qt) = (
        tuple((a - b) / (2 * h) for a, b in zip(slope(**{key: h}), slope(**{key: -h}), strict=True))
        for key, h in (("du", 1e-3), ("dv", 1e-3), ("dt", 1e-4))
    )
    across, down = scipy.sparse.eye_array(rows), scipy.sparse.eye_array(cols)
    ax, dx = (scipy.sparse.kron(across, part) for part in _along(cols))
    ay, dy = (scipy.sparse.kron(part, down) for part in _along(rows))
    scaled = scipy.sparse.diags_array
    jacobian = scipy.sparse.vstack([dx - ax @ scaled(pt.ravel()), dy - ay @ scaled(qt.ravel())])
    noise = scipy.sparse.block_array(
        [
            [ax @ scaled(pu.ravel()), ax @ scaled(pv.ravel())],
            [ay @ scaled(qu.ravel()), ay @ scaled(qv.ravel())],
        ]
    )
    at = np.arange(rows * cols).reshape(rows, cols)
    variance = _heights(jacobian, noise, at[:, 0], at[::EVERY, ::EVERY].ravel())
    found: Floats = variance.reshape(at[::EVERY, ::EVERY].shape) * directions[::EVERY, ::EVERY, 2] ** 2
    return found


def _heights(
    jacobian: scipy.sparse.sparray, noise: scipy.sparse.sparray, known: Floats, wanted: Floats
) -> Floats:
    """Variance of w at the wanted pixels when J w = B noise and the mean over the known pixels is known."""
    covariance = noise @ noise.T
    # Scaled to a unit diagonal: near the pattern's edge variances differ by many orders.
    even = scipy.sparse.diags_array(1 / np.sqrt(covariance.diagonal()))
    whitened = even @ jacobian
    size = scipy.sparse.linalg.norm(whitened, axis=0)
    whitened = whitened @ scipy.sparse.diags_array(1 / size)
    edges, count = whitened.shape
    pin = np.zeros(count)
    pin[known] = 1 / size[known]
    pin /= np.linalg.norm(pin)
    column = scipy.sparse.csr_array(pin[:, None])
    system = scipy.sparse.block_array(
        [[even @ covariance @ even, whitened, None], [whitened.T, None, column], [None, column.T, None]]
    )
    units = np.zeros((edges + count + 1, wanted.size))
    units[edges + wanted, np.arange(wanted.size)] = 1.0
    solved = scipy.sparse.linalg.splu(system.tocsc()).solve(units)
    variance: Floats = -solved[edges + wanted, np.arange(wanted.size)] / size[wanted] ** 2
    return variance


def _along(count: int) -> tuple[scipy.sparse.sparray, scipy.sparse.sparray]:
    """Increments from slopes, and differences, along one axis, (count - 1, count) each."""
    increments = np.zeros((count - 1, count))
    for edge in range(count - 1):
        kind = 1 if edge == 0 else 2 if edge == count - 2 else 0
        start = min(max(edge - 1, 0), count - 4)
        increments[edge, start : start + 4] = np.array(_CUBIC[kind]) / 24
    return scipy.sparse.csr_array(increments), scipy.sparse.csr_array(np.diff(np.eye(count), axis=0))


def _slopes(scene: Scene, u: Floats, v: Floats, t: Floats) -> tuple[Floats, Floats]:
    """dt per pixel along columns and rows: the mirror's tangents are square to the bisector."""
    row, col = np.meshgrid(*(np.arange(size, dtype=np.float64) for size in t.shape), indexing="ij")
    origins, directions = scene.camera.rays_at(row, col)
    point = origins + t[..., None] * directions
    seen = scene.pattern.point(u, v) - point
    normal = seen / np.linalg.norm(seen, axis=-1, keepdims=True) - directions
    slopes = []
    for dr, dc in ((0.0, 0.5), (0.5, 0.0)):
        ahead, behind = scene.camera.rays_at(row + dr, col + dc), scene.camera.rays_at(row - dr, col - dc)
        moved = ahead[0] - behind[0] + t[..., None] * (ahead[1] - behind[1])
        slopes.append(-np.sum(normal * moved, axis=-1) / np.sum(normal * directions, axis=-1))
    return slopes[0], slopes[1]
