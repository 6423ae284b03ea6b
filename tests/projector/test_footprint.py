"""Shares of the cells under a footprint, against integrals done by brute force."""

import numpy as np
import pytest
from scipy.special import ndtr

from optolever.projector.footprint import look_up_one

BOXES = [(1.0, 0.0), (0.0, 0.0), (0.7, 0.7), (0.02, 1.3), (4.1, 0.3), (9.3, 6.0), (1e-6, 2e-6)]


def shares(at: float, a: float, b: float, blur: float, cells: int) -> np.ndarray:
    """All W_k from the kernel: the light of frames that are 1 in one cell each."""
    look = np.array([[at, a, b, 500.0, 1.0, 0.0]])
    out = np.empty((1, cells), np.float32)
    look_up_one(look, np.ones(1), blur, np.eye(cells, dtype=np.float32), 1001, out)
    return out[0].astype(np.float64)


def shares_by_rays(at: float, a: float, b: float, blur: float, cells: int) -> np.ndarray:
    """W_k by 400 x 400 rays over both boxes."""
    steps = (np.arange(400) + 0.5) / 400 - 0.5
    ray = (at + a * steps[:, None] + b * steps).ravel()
    if blur == 0:
        return (
            np.bincount(np.clip(np.rint(ray), -1, cells).astype(int) + 1, minlength=cells + 2)[1:-1]
            / ray.size
        )
    edges = np.arange(cells + 1) - 0.5
    below = np.array([ndtr((edge - ray) / blur).mean() for edge in edges])
    return np.diff(below)


@pytest.mark.parametrize(("blur", "off"), [(0.0, 3e-3), (0.05, 3e-5), (0.5, 3e-5), (2.0, 3e-5)])
@pytest.mark.parametrize(("a", "b"), BOXES)
def test_shares_are_those_of_many_rays(a: float, b: float, blur: float, off: float) -> None:
    """Of sharp patterns rays converge slowly."""
    for at in (0.1, 7.37, 14.2):
        np.testing.assert_allclose(shares(at, a, b, blur, 15), shares_by_rays(at, a, b, blur, 15), atol=off)
