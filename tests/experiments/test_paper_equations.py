"""The paper's equations and recursion against an exact,
independent simulation of a prism cut by ray tracing.
"""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from optolever.experiments.paper.recursion import PaperGeometry, recursion, series

Array = NDArray[np.float64]
LENGTH, PEAK, ANGLE = 1637.0, 13.0, np.pi / 4
PRISM = PaperGeometry(ANGLE, ANGLE, LENGTH)
FACE = LENGTH * np.cos(ANGLE)


def smooth_depth(l: Array) -> Array:
    return PEAK / 2 * (1 - np.cos(2 * np.pi * l / LENGTH))


def smooth_slope(l: Array) -> Array:
    return PEAK * np.pi / LENGTH * np.sin(2 * np.pi * l / LENGTH)


def reflected_position(l: Array, sign: int) -> Array:
    """Where the ray of the camera at infinity that meets the mirror at l reaches the pattern face, by
    vectors.

    The camera looks along (-sin b0, -cos b0) in (l, d); sign -1 lets the mirror turn the ray the other way.
    """
    slope = sign * smooth_slope(l)
    normal = np.stack([-slope, np.ones_like(l)]) / np.hypot(slope, 1.0)
    ray = np.array([-np.sin(ANGLE), -np.cos(ANGLE)])[:, None]
    mirrored = ray - 2 * (ray * normal).sum(axis=0) * normal
    # (l, d) + t mirrored = m (cos a0, sin a0)
    along, across = np.array([np.cos(ANGLE), np.sin(ANGLE)]), np.array([-np.sin(ANGLE), np.cos(ANGLE)])
    place = np.stack([l, smooth_depth(l)])
    t = -(across @ place) / (across @ mirrored)
    return along @ (place + t * mirrored)


def seen_position(l: Array) -> Array:
    """Where that ray leaves the capture face: the distance from R0 along (-cos b0, sin b0)."""
    return (LENGTH - l) * np.cos(ANGLE) + smooth_depth(l) * np.sin(ANGLE)


def invert(rising: Callable[[Array], Array], values: Array) -> Array:
    """Bisection of a rising function on (0, L0), to the last bit."""
    low, high = np.zeros_like(values), np.full_like(values, LENGTH)
    for _ in range(70):
        middle = (low + high) / 2
        below = rising(middle) < values
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return (low + high) / 2


def middles(count: int) -> Array:
    return FACE * (np.arange(count) + 0.5) / count


def lattice_lines(sign: int) -> tuple[Array, Array, Array]:
    """64 lines equally spaced on the pattern: m, w, true depth."""
    m = middles(64)
    l = invert(lambda x: reflected_position(x, sign), m)
    return m, seen_position(l), smooth_depth(l)


def every_pixel(sign: int) -> tuple[Array, Array, Array]:
    """1637 camera pixels, equally spaced on the capture face: m, w, true depth."""
    w = middles(1637)[::-1]
    l = invert(lambda x: -seen_position(x), -w)
    return reflected_position(l, sign), w, smooth_depth(l)


def errors(m: Array, w: Array, depth: Array, sign: int, gamma: bool) -> tuple[Array, float]:
    """Rms over the peak of drops, rises, mean; the mean's largest error over the peak."""
    result = recursion(m, w, PRISM, sign=sign, gamma=gamma)
    rms = [np.sqrt(np.mean((p.d - depth) ** 2)) / PEAK for p in (result.drops, result.rises, result.mean)]
    return np.array(rms), float(np.max(np.abs(result.mean.d - depth)) / PEAK)


class TestPublishedTable:
    """What PAPER.md says beside its table; that itself is in tests/experiments/test_paper_study.py."""

    def test_about_one_percent_with_the_printed_sign_in_both_directions(self) -> None:
        _, largest = errors(*lattice_lines(-1), -1, True)
        assert largest == pytest.approx(0.0098, abs=5e-5)

    def test_every_pixel(self) -> None:
        rms, _ = errors(*every_pixel(1), 1, True)
        assert np.all(np.abs(rms - (1.3e-3, 3.7e-2, 1.9e-2)) <= (0.5e-4, 0.5e-3, 0.5e-3)), rms


class TestRecursion:
    def test_lines_march_independently(self) -> None:
        m, w, _ = lattice_lines(1)
        flat = FACE - w
        both = recursion(np.stack([m, flat]), np.stack([w, w]), PRISM)
        assert_allclose(both.drops.d[0], recursion(m, w, PRISM).drops.d, rtol=1e-12)
        assert_allclose(both.rises.d[1], 0, atol=1e-9)

    def test_missing_points_stay_missing_and_are_stepped_over(self) -> None:
        m, w, depth = every_pixel(1)
        holed = m.copy()
        holed[[0, 1, 700, 701]] = np.nan
        result = recursion(holed, w, PRISM)
        assert np.array_equal(np.isnan(result.drops.d), np.isnan(holed))
        error = result.drops.d - depth
        assert np.sqrt(np.nanmean(error**2)) / PEAK < 2e-3

    def test_hidden_lines_are_one_step_and_missing_pixels_many(self) -> None:
        """Lines that a crease hides lie nowhere in w: the march is that over the others."""
        m, w, depth = lattice_lines(1)
        hidden = np.insert(m, [30, 30, 30], np.nan), np.insert(w, [30, 30, 30], np.nan)
        with_gap, without = recursion(*hidden, PRISM), recursion(m, w, PRISM)
        kept = np.isfinite(hidden[0])
        for name in ("rises", "drops"):
            assert_allclose(with_gap.series(name).d[kept], without.series(name).d, rtol=1e-12)
        seen, w, depth = every_pixel(1)
        seen[800:820] = np.nan
        error = recursion(seen, w, PRISM).drops.d - depth
        assert np.nanmax(np.abs(error)) / PEAK < 5e-3

    def test_all_missing(self) -> None:
        nothing = np.full((2, 5), np.nan)
        assert np.isnan(series(nothing, np.ones((2, 5)), PRISM).d).all()
