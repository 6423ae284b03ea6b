"""Lattice crossings against closed-form warps."""

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import erf

from optolever import InputError
from optolever.live import Crossings, lattice
from optolever.patterns import lattice_lines, sequence

F64 = NDArray[np.float64]
ROWS, COLS = 240, 210
SHOWN = sequence("lattice", ROWS, COLS)
ROW, COL = np.mgrid[:220, :280].astype(np.float64)


def profile(coord: F64, extent: int, width: float = 5.0, blur: float = 0.7) -> F64:
    lines = lattice_lines(SHOWN.frames[0], extent)
    dark = np.zeros(coord.shape)
    for line in lines:
        edge = [(coord - line + side * width / 2) / (blur * np.sqrt(2)) for side in (1, -1)]
        dark += 0.5 * (erf(edge[0]) - erf(edge[1]))
    return 1 - dark


def image(u: F64, v: F64, seed: int, noise: float = 1.0) -> NDArray[np.uint8]:
    light = 20 + 200 * profile(u, COLS) * profile(v, ROWS)
    noisy = light + noise * np.random.default_rng(seed).standard_normal(u.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def rest_map(row: F64, col: F64) -> tuple[F64, F64]:
    """As the prism's: u falls with the column."""
    return 204 - 0.7071 * col + 0.01 * row, 5 + 1.02 * row + 0.01 * col


def bump(row: F64, col: F64, size: float) -> tuple[F64, F64]:
    u, v = rest_map(row, col)
    bell = size * np.exp(-((col - 140) ** 2 + (row - 110) ** 2) / (2 * 40**2))
    return u + bell * (col - 140) / 40, v + bell * (row - 110) / 40


@pytest.mark.parametrize("size", [0.0, 2.0, 8.0])
def test_crossings_are_where_the_warp_puts_them(size: float) -> None:
    u, v = rest_map(ROW, COL)
    prior = SimpleNamespace(u=u, v=v)
    found = lattice(image(*bump(ROW, COL, size), seed=2), image(u, v, seed=1), SHOWN, prior=prior)
    assert found.found.mean() > 0.97
    assert len(found.index) >= 50
    good = found.found
    for points, warp, sigma in (
        (found.rest, rest_map(*found.rest.T), found.sigma_rest),
        (found.now[good], bump(*found.now[good].T, size), found.sigma[good]),
    ):
        assert len(points) == len(sigma)
        pattern = found.pattern if len(points) == len(good) else found.pattern[good]
        error = np.stack(warp, axis=1) - pattern
        assert np.sqrt(np.mean(error**2)) < 0.05
        assert np.abs(error).max() < 0.2
    error = np.stack(rest_map(*found.rest.T), axis=1) - found.pattern
    # u changes by 0.7071 a column, v by 1.02 a row
    score = error / (found.sigma_rest[:, ::-1] * [0.7071, 1.02])
    assert 0.6 < np.sqrt(np.mean(score**2)) < 1.4


def test_sign_of_a_shift() -> None:
    """The image moved by +3 rows and +20 columns, more than half a lattice period."""
    u, v = rest_map(ROW, COL)
    far = np.clip((COL - 40) / 120, 0, 1) ** 2
    moved_u, moved_v = rest_map(ROW - 3 * far, COL - 20 * far)
    found = lattice(image(moved_u, moved_v, 4), image(u, v, 3), SHOWN, prior=SimpleNamespace(u=u, v=v))
    right = found.found & (found.now[:, 1] > 190)
    assert right.sum() > 10
    np.testing.assert_allclose((found.now - found.rest)[right], [[3.0, 20.0]] * right.sum(), atol=0.1)


def test_default_guide_is_the_whole_surface() -> None:
    v, u = np.mgrid[:ROWS, :COLS].astype(np.float64)
    found = lattice(image(u, v, 1), image(u, v, 2), SHOWN)
    assert found.found.all()
    np.testing.assert_allclose(found.rest[:, ::-1], found.pattern, atol=0.05)


def test_record_comes_back(tmp_path_factory: pytest.TempPathFactory) -> None:
    v, u = np.mgrid[:ROWS, :COLS].astype(np.float64)
    found = lattice(image(u, v, 1), image(u, v, 2), SHOWN)
    path = tmp_path_factory.mktemp("crossings") / "x.npz"
    found.save(path)
    assert Crossings.load(path) == found


@pytest.mark.parametrize(
    ("now", "rest", "message"),
    [
        (np.zeros((40, 40)), np.zeros((40, 41)), "must be equal"),
        (np.zeros((2, 40, 40)), np.zeros((40, 40)), "2 images"),
        (np.full((40, 40), np.nan), np.zeros((40, 40)), "not finite"),
        (np.zeros((40, 40)), np.zeros((40, 40)), "no crossing"),
    ],
)
def test_bad_input(now: F64, rest: F64, message: str) -> None:
    with pytest.raises(InputError, match=message):
        lattice(now, rest, SHOWN)
