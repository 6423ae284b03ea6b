"""Outermost lines of the image behind a camera's filter, which repeats or mirrors pixels beyond its edge."""

import cv2
import numpy as np
import pytest

from optolever.decode import decode
from optolever.decode.profile.edge_lines import edge_lines, widen_edge_lines
from optolever.experiments.metrics import rms
from optolever.patterns import sequence_from_text

from .conftest import Map, Shoot


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", ["phase", "gray+phase"])
def test_behind_an_unsharp_mask(name: str, seed: int, smooth: Map, shoot: Shoot) -> None:
    """What it shifts of fringes along all four sides of a mirror that fills the image is in sigma."""
    shown = sequence_from_text(name, 150, 170)
    frames = shoot(shown, *smooth, noise=1.0, seed=seed, amplitude=60.0).astype(np.float64)
    soft = np.array([cv2.GaussianBlur(frame, (0, 0), 1.5) for frame in frames])
    found = decode(np.clip(np.rint(frames + 0.8 * (frames - soft)), 0, 255).astype(np.uint8), shown)
    outer = found.good.copy()
    outer[2:-2, 2:-2] = False
    error, sigma = (np.array(both) for both in ((found.u, found.v), (found.sigma_u, found.sigma_v)))
    score = ((error - smooth) / sigma)[:, outer]
    # without: 6.6 to 7.5, and 0.35 to 0.37
    assert rms(score) < 2.5
    assert (np.abs(score) > 5).mean() < 0.03
    assert np.median(found.sigma_u[5:-5, 5:-5]) < 0.055


@pytest.mark.parametrize("name", ["phase", "gray+phase", "micro-phase"])
def test_without_a_filter(name: str, smooth: Map, shoot: Shoot, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = sequence_from_text(name, 150, 170)
    frames = shoot(shown, *smooth, noise=1.0)
    found = decode(frames, shown)
    monkeypatch.setattr("optolever.decode.apply.widen_edge_lines", lambda *_: None)
    plain = decode(frames, shown)
    for sigma, without in ((found.sigma_u, plain.sigma_u), (found.sigma_v, plain.sigma_v)):
        np.testing.assert_array_equal(sigma, without)


@pytest.mark.parametrize("turns", range(4))
def test_lines_that_are_off(turns: int) -> None:
    """By as much as they are, where half of one and some behind them are refused; no other line is wider."""
    rng = np.random.default_rng(turns)
    row, col = np.mgrid[:60, :80].astype(np.float64)
    off = np.zeros((60, 80))
    off[0], off[1] = 0.5, -0.2
    coord = (3 + 1.1 * col + 0.01 * row**2 + off + 0.01 * rng.standard_normal(off.shape)).astype(np.float32)
    flags = np.zeros(coord.shape, np.uint16)
    flags[5], flags[9], flags[1, ::2] = 1, 1, 1
    sigma = np.full(coord.shape, 0.01, np.float32)
    off = edge_lines([np.rot90(coord, turns)], np.rot90(flags, turns))
    widen_edge_lines([np.rot90(sigma, turns)], off)
    np.testing.assert_allclose(np.median(sigma[:2], axis=1), [0.5, 0.2], rtol=0.1)
    np.testing.assert_array_equal(sigma[2:, 3:-3], np.float32(0.01))


@pytest.mark.parametrize("size", [(60, 80), (480, 640), (12, 200), (9, 7), (1, 1)])
@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_noise_and_bends_are_not_off(size: tuple[int, int], share: float) -> None:
    """Nor is anything told of a few lines, or of lines that are refused."""
    rng = np.random.default_rng(0)
    row, col = np.mgrid[: size[0], : size[1]].astype(np.float64)
    dent = 4 * np.exp(-((row - 4) ** 2 + (col - 30) ** 2) / 2 / 8**2) + 0.002 * col**2
    flags = (rng.random(size) < share).astype(np.uint16)
    coord = np.where(flags == 0, 1.3 * row + dent + 0.03 * rng.standard_normal(size), np.nan)
    sigma = np.full(size, 0.03, np.float32)
    widen_edge_lines([sigma], edge_lines([coord.astype(np.float32)], flags))
    np.testing.assert_array_equal(sigma, np.float32(0.03))
