"""The solve against the Cramer-Rao bound, by dense algebra on the same measurement model."""

import numpy as np
import pytest

from optolever.reconstruct import reconstruct
from optolever.reconstruct.edges import increments
from optolever.reconstruct.problem import prepare

SIZE = 24


def operators(rows: int, cols: int) -> tuple[np.ndarray, np.ndarray]:
    """Dense maps from pixels to edges (x, then y): differences of w,
    and averages of the slopes of either axis.
    """
    count = rows * cols
    full = np.ones((rows, cols), dtype=bool)
    keep_x, keep_y = full.copy(), full.copy()
    keep_x[:, -1], keep_y[-1] = False, False
    index = np.arange(count).reshape(rows, cols)
    unit = np.eye(count)
    difference = np.concatenate(
        [
            unit[index[:, 1:].ravel()] - unit[index[:, :-1].ravel()],
            unit[index[1:].ravel()] - unit[index[:-1].ravel()],
        ]
    )
    average = np.zeros((len(difference), 2 * count))
    split = keep_x.sum()
    for k in range(count):
        impulse = unit[k].reshape(rows, cols)
        gx, gy = increments(impulse, impulse, full)
        average[:split, k] = gx[keep_x]
        average[split:, count + k] = gy[keep_y]
    return difference, average


def bound(data, w: np.ndarray, at_edge: np.ndarray) -> np.ndarray:
    """Smallest variance of w that any unbiased estimate can have, (rows, cols).

    The edges' increments have the covariance of the slopes they average; w depends on itself through p_w,
    q_w. at_edge: pixels whose mean is known.
    """
    _, _, p_w, q_w = data.slopes(w)
    variance = np.concatenate([part.ravel() for part in data.variances(w)])
    difference, average = operators(*w.shape)
    count = w.size
    jacobian = difference - (average[:, :count] * p_w.ravel() + average[:, count:] * q_w.ravel())
    covariance = (average * variance) @ average.T
    # Scaled: near the pattern's edge variances are larger by many orders.
    root = 1 / np.sqrt(np.diag(covariance))
    covariance *= root[:, None] * root
    whitened = np.linalg.solve(np.linalg.cholesky(covariance), jacobian * root[:, None])
    pin = at_edge.ravel() / at_edge.sum()
    stacked = np.concatenate([whitened, 1e6 * pin[None] / np.sqrt(variance[:count].min())])
    scale = 1 / np.linalg.norm(stacked, axis=0)
    inverse = np.linalg.inv((stacked * scale).T @ (stacked * scale))
    return (scale**2 * np.diag(inverse)).reshape(w.shape)


@pytest.mark.parametrize("cut", [1.0, pytest.param(0.9, marks=pytest.mark.slow)])
def test_error_at_the_bound(exact, noisy, cut: float) -> None:
    """Whole prism and cut prism (x >= 0.1 L0): rms error over 150 seeds within 5 % of the bound,
    but for chance.
    """
    scene, truth, correspondence = exact("paper-simulation", "raised-cosine", SIZE, SIZE)
    mask = np.zeros((SIZE, SIZE), dtype=bool)
    mask[:, : round(cut * SIZE)] = True
    seeds = 150
    total = np.zeros((SIZE, SIZE))
    for seed in range(seeds):
        height = reconstruct(noisy(truth, sigma=1e-3, noise=1e-3, seed=seed), scene, mask=mask)
        total += (height.z - truth.z) ** 2 / seeds
    data = prepare(correspondence, scene, mask=mask).data
    o, d = data.rays.inner_origins, data.rays.inner_directions
    w = (truth.z[:, : round(cut * SIZE)] - o[2]) / d[2]
    edge = np.zeros(w.shape)
    edge[:, 0] = 1
    least = bound(data, w, edge) * (1e-3 / 0.02) ** 2 * d[2] ** 2
    inside = total[:, : round(cut * SIZE)]
    assert 0.95 < np.sqrt(inside.mean() / least.mean()) < 1.05
    # And in units of the bound, so that the pattern's edge does not rule the sum.
    assert 0.95 < np.sqrt(np.mean(inside / np.maximum(least, 0.05 * np.median(least)))) < 1.05
