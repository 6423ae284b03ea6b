"""integrate(): plain gradient fields against the height they came from."""

import numpy as np
import pytest

from lab.figures.cliffs import cauchy_loop, cliff
from optolever import InputError
from optolever.reconstruct import integrate
from optolever.reconstruct.solver.edges import increments

from .dense import dense_solution

SIZE = 96


def gaussian(rows: int, cols: int, share: float = 0.15) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A bump off the centre and its slopes per pixel."""
    y, x = np.mgrid[:rows, :cols].astype(float)
    x, y, s = x - 0.45 * cols, y - 0.55 * rows, share * cols
    z = np.exp(-(x**2 + y**2) / (2 * s**2))
    return z, -x / s**2 * z, -y / s**2 * z


def rms(values: np.ndarray) -> float:
    values = values[np.isfinite(values)]
    return float(np.sqrt(np.mean((values - values.mean()) ** 2)))


@pytest.mark.parametrize("robust", [False, True])
def test_smooth_field(robust: bool) -> None:
    z, gx, gy = gaussian(SIZE, SIZE + 20)
    result = integrate(gx, gy, robust=robust)
    assert rms(result.z - z) < 3e-6 * rms(z)
    assert abs(result.z.mean()) < 1e-12


def test_figure_at_512() -> None:
    z, gx, gy = gaussian(512, 512)
    assert rms(integrate(gx, gy).z - z) < 3e-9 * np.sqrt(np.mean(z**2))


@pytest.mark.parametrize("robust", [False, True])
def test_masks_components_and_nan(robust: bool) -> None:
    z, gx, gy = gaussian(SIZE, SIZE)
    mask = np.ones((SIZE, SIZE), dtype=bool)
    mask[:, 50] = False
    mask[10:20, 10:20] = False
    gx[70, 70] = np.nan
    result = integrate(gx, gy, mask=mask, robust=robust)
    assert result.components.max() == 2
    assert np.isnan(result.z[~mask]).all()
    assert np.isnan(result.z[70, 70])
    for label in (1, 2):
        inside = result.components == label
        assert abs(result.z[inside].mean()) < 1e-10
        assert rms((result.z - z)[inside]) < 1e-5 * rms(z)


@pytest.mark.parametrize("kind", ["falling", "rising", "uneven"])
def test_weights_against_dense_least_squares(kind: str) -> None:
    """Noisy slopes; weights by columns over six orders, or each pixel's own in two parts with holes."""
    rows, cols = 7, 9
    rng = np.random.default_rng(3)
    gx, gy = rng.standard_normal((2, rows, cols))
    weight, mask = np.tile(np.geomspace(1.0, 1e-6, cols), (rows, 1)), np.ones((rows, cols), dtype=bool)
    if kind == "rising":
        weight = weight[:, ::-1].copy()
    elif kind == "uneven":
        weight, mask = np.exp(rng.standard_normal((rows, cols))), rng.random((rows, cols)) > 0.1
        mask[:, 4] = False
    result = integrate(gx, gy, mask=mask, weights=weight)
    wx, wy = np.zeros((2, rows, cols))
    wx[:, :-1] = 2 / (1 / weight[:, :-1] + 1 / weight[:, 1:]) * (mask[:, :-1] & mask[:, 1:])
    wy[:-1] = 2 / (1 / weight[:-1] + 1 / weight[1:]) * (mask[:-1] & mask[1:])
    off = result.z - dense_solution(*increments(gx, gy, mask), wx, wy)
    assert (result.components > 0).sum() == mask.sum()
    for label in range(1, result.components.max() + 1):
        assert np.ptp(off[result.components == label]) < 1e-6


def test_spacing() -> None:
    _, gx, gy = gaussian(SIZE, SIZE)
    stretched = integrate(gx / 0.5, gy / 2.0, spacing=(0.5, 2.0))
    np.testing.assert_allclose(stretched.z, integrate(gx, gy).z, atol=1e-12)


def test_robust_leaves_outliers_behind() -> None:
    """1 % of the slopes replaced: least squares follows them, reweighting does not."""
    rng = np.random.default_rng(3)
    z, gx, gy = gaussian(SIZE, SIZE)
    gx, gy = (g + 1e-4 * rng.standard_normal(g.shape) for g in (gx, gy))
    wrong = rng.random(gx.shape) < 0.01
    gx[wrong] += rng.standard_normal(wrong.sum())
    plain, robust = integrate(gx, gy), integrate(gx, gy, robust=True)
    assert rms(robust.z - z) < 0.2 * rms(plain.z - z)
    off = np.abs(robust.z - z - np.median(robust.z - z))[~wrong]
    assert np.quantile(off, 0.95) < 5e-4


def test_robust_without_outliers_is_least_squares() -> None:
    """One solve: noise alone needs no reweighting."""
    rng = np.random.default_rng(3)
    _, gx, gy = gaussian(SIZE, SIZE)
    noisy = [g + 1e-4 * rng.standard_normal(g.shape) for g in (gx, gy)]
    plain, robust = integrate(*noisy), integrate(*noisy, robust=True)
    assert robust.iterations == 1
    np.testing.assert_allclose(robust.z, plain.z, atol=1e-5)


@pytest.mark.parametrize("noise", [1e-2, 1e-4])
def test_robust_at_cliffs_is_a_plain_cauchy_loop(noise: float) -> None:
    """The same heights within a fraction of what noise does to them, without thousands of iterations."""
    z, gx, gy, mask = cliff(96, 112, noise)
    found, loop = integrate(gx, gy, mask=mask, robust=True), cauchy_loop(gx, gy, mask)
    assert rms((found.z - z)[mask]) == pytest.approx(rms((loop - z)[mask]), rel=0.02)
    assert found.iterations < 600


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"mask": np.zeros((8, 8), dtype=bool)}, "mask"),
        ({"mask": np.ones((3, 3), dtype=bool)}, "mask"),
        ({"weights": np.zeros((8, 8))}, "weights"),
        ({"weights": np.ones((3, 8))}, "weights"),
        ({"spacing": 0.0}, "spacing"),
        ({"spacing": "wide"}, "spacing"),
        ({"spacing": (1.0, 1.0, 1.0)}, "spacing"),
        ({"spacing": (np.arange(8.0), 1.0)}, "spacing"),
    ],
)
def test_bad_input(options: dict, word: str) -> None:
    with pytest.raises(InputError, match=word):
        integrate(np.zeros((8, 8)), np.zeros((8, 8)), **options)
