"""integrate(): plain gradient fields against the height they came from."""

import numpy as np
import pytest

from optolever import InputError
from optolever.reconstruct import integrate

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


def test_smooth_field() -> None:
    z, gx, gy = gaussian(SIZE, SIZE + 20)
    result = integrate(gx, gy)
    assert rms(result.z - z) < 3e-6 * rms(z)
    assert abs(result.z.mean()) < 1e-12


def test_masks_components_and_nan() -> None:
    z, gx, gy = gaussian(SIZE, SIZE)
    mask = np.ones((SIZE, SIZE), dtype=bool)
    mask[:, 50] = False
    mask[10:20, 10:20] = False
    gx[70, 70] = np.nan
    result = integrate(gx, gy, mask=mask)
    assert result.components.max() == 2
    assert np.isnan(result.z[~mask]).all()
    assert np.isnan(result.z[70, 70])
    for label in (1, 2):
        inside = result.components == label
        assert abs(result.z[inside].mean()) < 1e-10
        assert rms((result.z - z)[inside]) < 1e-5 * rms(z)


def test_spacing() -> None:
    _, gx, gy = gaussian(SIZE, SIZE)
    stretched = integrate(gx / 0.5, gy / 2.0, spacing=(0.5, 2.0))
    np.testing.assert_allclose(stretched.z, integrate(gx, gy).z, atol=1e-12)


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
