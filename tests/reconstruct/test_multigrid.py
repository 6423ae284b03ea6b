"""The V-cycle as what conjugate gradients need: symmetric, positive, and near the inverse."""

import numpy as np
import pytest

from optolever.reconstruct.edges import apply_laplacian
from optolever.reconstruct.masked import MaskedEdges
from optolever.reconstruct.multigrid import Multigrid
from optolever.reconstruct.poisson import Accuracy


def edges(rows: int, cols: int, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    wx, wy = np.zeros((rows, cols)), np.zeros((rows, cols))
    wx[:, :-1] = np.minimum(weight[:, 1:], weight[:, :-1])
    wy[:-1] = np.minimum(weight[1:], weight[:-1])
    return wx, wy


@pytest.mark.parametrize(("rows", "cols"), [(17, 23), (32, 9), (40, 41), (1, 90)])
def test_symmetric_and_near_the_inverse(rows: int, cols: int) -> None:
    """Eigenvalues of cycle times operator: within (0, 1], near one, whatever the size and the jumps."""
    rng = np.random.default_rng(rows)
    weight = np.where(rng.random((rows, cols)) < 0.2, 1e-4, 1.0)
    wx, wy = edges(rows, cols, weight)
    multigrid = Multigrid(wx, wy)
    a, b = rng.standard_normal((2, rows, cols))
    a -= a.mean()
    b -= b.mean()
    assert np.vdot(a, multigrid.cycle(b)) == pytest.approx(np.vdot(multigrid.cycle(a), b), rel=1e-9)
    image = multigrid.cycle(apply_laplacian(a, wx, wy)[0])
    energy = np.vdot(a, apply_laplacian(a, wx, wy)[0])
    share = np.vdot(apply_laplacian(a, wx, wy)[0], image) / energy
    assert 0.2 < share <= 1.0 + 1e-9


@pytest.mark.parametrize("case", ["slit", "dropouts", "crease", "prism"])
def test_iterations_stay_few(case: str) -> None:
    """Solved to 1e-8 from an exact potential, by few iterations, where a DCT needs 40 to 200."""
    rng = np.random.default_rng(2)
    rows, cols = 160, 150
    y, x = np.mgrid[:rows, :cols]
    weight = np.ones((rows, cols))
    if case == "slit":
        weight[rows // 3, :-15] = 0.0
    elif case == "dropouts":
        weight[rng.random((rows, cols)) < 0.2] = 0.0
    elif case == "crease":
        weight[np.abs(np.hypot(y - 80, x - 70) - 40) < 1] = 1e-8
    else:
        weight *= ((x + 0.5) / cols) ** 4
    wx, wy = edges(rows, cols, weight)
    mask = weight > 0
    truth = rng.standard_normal((rows, cols)) * mask
    gx, gy = np.zeros((rows, cols)), np.zeros((rows, cols))
    gx[:, :-1], gy[:-1] = np.diff(truth, axis=1), np.diff(truth, axis=0)
    result = MaskedEdges(wx, wy, mask).solve(gx, gy, Accuracy(relative=1e-8))
    assert result.iterations <= 25
    left = result.x - truth
    rx, ry = wx[:, :-1] * np.diff(left, axis=1) ** 2, wy[:-1] * np.diff(left, axis=0) ** 2
    assert rx.sum() + ry.sum() < 1e-12 * (np.sum(wx * gx**2) + np.sum(wy * gy**2))
