"""Noise: the solver's error against the Cramer-Rao bound, and how often error bars hold.

The bound, by algebra on the measurement: noise of u and v moves every pixel's slopes, the increment between
two pixels integrates the cubic through four slopes, and the height's differences are these increments, which
depend on the height themselves. For noise of variance one the best linear estimate of the heights w from
J w = B noise has the covariance block of the inverse of [[B B^T, J, 0], [J^T, 0, a], [0, a^T, 0]], a the mean
that the anchor knows; taken at every third pixel. Slopes come from the law of reflection, their derivatives
from central differences: nothing of the solver is used.
"""

from collections.abc import Iterator

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from optolever.experiments.arrays import Floats
from optolever.reconstruct import reconstruct
from optolever.scene import Scene, Trace

from .figures import Figure
from .place import Place, exact

PRISM, DENT = "paper-simulation", "raised-cosine"
SIDE = 64
NOISES = (0.01, 0.1, 1.0)  # px
CUTS = {"full prism": 1.0, "cut prism": 0.9}  # share of the columns, from the camera's side: x >= 0.1 L0
EVERY = 3  # pixels: where the bound is taken
COVERED = 192
_CUBIC = ((-1, 13, 13, -1), (9, 19, -5, 1), (1, -5, 19, 9))  # / 24: inside, at either end


def bound_figures(seeds: int) -> Iterator[Figure]:
    """Errors over the bound, and coverage."""
    place = Place.of(PRISM, DENT, (SIDE, SIDE))
    for name, share in CUTS.items():
        cols = round(share * SIDE)
        least = least_variance(place.scene, place.truth, cols)
        for noise in NOISES:
            errors = np.array([_error(place, noise, seed, cols)[0] for seed in range(2 * seeds)])
            squares = errors[:, ::EVERY, :cols:EVERY] ** 2 / least
            note = f"{100 * float(np.mean(np.isnan(errors[:, :, :cols]))):.2g} % flagged"
            ratio = float(np.sqrt(np.nanmean(squares))) / noise
            yield Figure(f"error over the bound, {name}, {noise:g} px", ratio, high=1.05, note=note)
    place = Place.of(PRISM, DENT, (COVERED, COVERED))
    shares = []
    for seed in range(seeds):
        error, sigma = _error(place, 0.1, seed, COVERED)
        stands = np.isfinite(error)
        shares.append(float(np.mean(np.abs(error[stands]) < sigma[stands])))
    name = f"within one sigma, {COVERED} x {COVERED}, mean over {seeds} seeds"
    yield Figure(name, 100 * float(np.mean(shares)), "%", low=65, high=71)


def _error(place: Place, noise: float, seed: int, cols: int) -> tuple[Floats, Floats]:
    """Height minus truth (NaN where flagged) and sigma, from noisy correspondences of the first columns."""
    truth = place.truth
    seen = exact(truth, noise=noise, rng=np.random.default_rng(seed))
    mask = np.zeros(truth.u.shape, dtype=np.bool_)
    mask[:, :cols] = True
    height = reconstruct(seen, place.scene, mask=mask)
    return np.where(height.good, height.z - truth.z, np.nan), height.sigma


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
