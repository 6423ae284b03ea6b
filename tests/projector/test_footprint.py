"""Shares of the cells under a footprint, against integrals done by brute force."""

import numpy as np
import pytest
from scipy.special import ndtr

from optolever.projector.footprint import look_up_one, look_up_two

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


@pytest.mark.parametrize("blur", [0.05, 0.5, 2.0])
@pytest.mark.parametrize(("a", "b"), BOXES)
def test_shares_with_blur(a: float, b: float, blur: float) -> None:
    for at in (0.1, 7.37, 14.2):
        np.testing.assert_allclose(shares(at, a, b, blur, 15), shares_by_rays(at, a, b, blur, 15), atol=3e-5)


@pytest.mark.parametrize(("a", "b"), BOXES)
def test_shares_of_a_sharp_pattern(a: float, b: float) -> None:
    for at in (0.1, 7.37, 14.2):
        np.testing.assert_allclose(shares(at, a, b, 0.0, 15), shares_by_rays(at, a, b, 0.0, 15), atol=3e-3)


def test_shares_of_a_trapezoid_in_closed_form() -> None:
    """Boxes of 1 and 1/2 at a cell's border: the trapezoid's area on one side is one half."""
    expected = np.zeros(9)
    expected[3] = expected[4] = 0.5
    np.testing.assert_allclose(shares(3.5, 1.0, 0.5, 0.0, 9), expected, atol=1e-7)
    # At a cell's centre the box of one cell, widened by one of 1/2, spills 1/16 on either side.
    expected = np.zeros(9)
    expected[[3, 4, 5]] = 1 / 16, 7 / 8, 1 / 16
    np.testing.assert_allclose(shares(4.0, 1.0, 0.5, 0.0, 9), expected, atol=1e-7)


def test_shares_sum_to_one_inside_and_fade_over_the_edge() -> None:
    for blur in (0.0, 0.5):
        assert shares(10.0, 2.0, 1.0, blur, 21).sum() == pytest.approx(1.0, abs=1e-6)
        assert shares(-0.5, 2.0, 1.0, blur, 21).sum() == pytest.approx(0.5, abs=1e-6)
        assert shares(-9.0, 2.0, 1.0, blur, 21).sum() == 0.0


@pytest.mark.parametrize("mean", [False, True])
def test_frames_along_both_axes_sum_all_cells(mean: bool) -> None:
    rng = np.random.default_rng(4)
    levels = rng.integers(0, 256, (12, 3), np.uint8), rng.integers(0, 256, (10, 3), np.uint8)
    response = rng.random(256).astype(np.float32)
    look = np.array([[5.3, 1.2, 0.0, 4.6, 0.0, 2.0], [0.2, 1.0, 0.0, 9.0, 0.0, 0.3]])
    light = np.array([0.8, 0.3])
    out = np.empty((2, 3), np.float32)
    look_up_two(look, light, 0.5, levels, mean, response, out)
    for i, (u, au, bu, v, av, bv) in enumerate(look):
        weights = np.outer(shares(v, av, bv, 0.5, 10), shares(u, au, bu, 0.5, 12))
        for n in range(3):
            along_u, along_v = levels[0][:, n].astype(int), levels[1][:, n].astype(int)[:, None]
            shown = (along_u + along_v + 1) // 2 if mean else (along_u * along_v + 127) // 255
            assert out[i, n] == pytest.approx(light[i] * (weights * response[shown]).sum(), abs=1e-6)
