"""Wrong pixels are told from creases, rims and curved fields by their neighbours alone."""

import numpy as np
import pytest

from optolever.reconstruct.outliers import outliers

SIGMA = 0.05


class Field:
    """What `outliers` looks at."""

    def __init__(self, u: np.ndarray, sigma: float = SIGMA, mask: np.ndarray | None = None) -> None:
        self.u, self.v = u, np.zeros(u.shape)
        self.sigma_u = self.sigma_v = np.full(u.shape, sigma)
        self.mask = np.ones(u.shape, dtype=np.bool_) if mask is None else mask


def ground() -> np.ndarray:
    y, x = np.mgrid[:60, :70]
    return x + 3.0 * np.sin(x / 9.0) + 2.0 * np.cos(y / 7.0)


def noisy(seed: int = 0) -> np.ndarray:
    return ground() + SIGMA * np.random.default_rng(seed).standard_normal((60, 70))


def test_large_errors_are_found_in_pairs_too_and_nothing_else() -> None:
    u = noisy()
    places = [(5, 5), (0, 30), (20, 69), (21, 69), (40, 40), (40, 41)]
    for k, (row, col) in enumerate(places):
        u[row, col] += (-1) ** k * (4.0 + k)
    found = outliers(Field(u))
    assert set(map(tuple, np.argwhere(found).tolist())) == set(places)


@pytest.mark.parametrize("sigma", [SIGMA, 1e-5])
def test_a_crease_a_jump_and_a_tip_are_no_outliers(sigma: float) -> None:
    y, x = np.mgrid[:60, :70]
    rng = np.random.default_rng(3)
    for feature in (
        np.abs(x - 0.3 * y - 30.5),
        8.0 * (np.hypot(x - 35, y - 30) < 12),
        5 * np.exp(-np.hypot(x - 34.5, y - 29.5) / 6),
    ):
        field = Field(ground() + feature + sigma * rng.standard_normal((60, 70)), sigma)
        assert outliers(field).sum() <= 2


def test_too_few_neighbours_prove_nothing() -> None:
    mask = np.zeros((60, 70), dtype=np.bool_)
    mask[30] = True
    u = noisy()
    u[30, 35] += 50.0
    assert not outliers(Field(u, mask=mask))[29].any()
    assert not outliers(Field(u, mask=mask))[30, :34].any()


def test_a_wrong_pixel_among_gaps_is_told_by_the_plane_around_it() -> None:
    """No three pixels in a row are seen beside it; what was interpolated from it is no witness."""
    u, seen = noisy(), np.random.default_rng(5).random((60, 70)) > 0.2
    for row, col in ((20, 30), (41, 12)):
        seen[row, [col - 1, col + 1]] = seen[[row - 2, row + 2], col] = False
        seen[row, col] = True
        u[row, col] += 5.0
        u[row, [col - 1, col + 1]] += 2.5
    found = outliers(Field(u), seen)
    assert found[20, 30]
    assert found[41, 12]
    assert found.sum() == 2
