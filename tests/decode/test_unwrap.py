"""Orders of two periods are as often wrong as the best decision; one period's fit is NumPy's in float64."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import cumulative_simpson, simpson
from scipy.special import erfc, ndtr

from optolever.decode import Correspondence, decode
from optolever.patterns import Frame, Sequence

from .conftest import F64

EXTENT, STEPS, PIXELS = 1260, 4, (300, 1000)


def shown(counts: tuple[int, int]) -> Sequence:
    """Two periods whose range is the whole surface, as the counts differ by one."""
    return Sequence(
        tuple(
            Frame("phase", "u", period_px=EXTENT / count, shift=2 * math.pi * k / STEPS)
            for count in counts
            for k in range(STEPS)
        ),
        1,
        EXTENT,
    )


def captured(sequence: Sequence, u: F64, ratio: float) -> F64:
    rng = np.random.default_rng(2)
    light = [120 + 60 * np.cos(2 * np.pi * u / (f.period_px or 1) - (f.shift or 0)) for f in sequence.frames]
    return np.stack(light) + 60 / ratio * rng.standard_normal((len(light), *u.shape))


def decoded(
    counts: tuple[int, int], ratio: float, low: float, high: float
) -> tuple[Correspondence, NDArray[np.bool_]]:
    """What is found of places drawn from `low` to `high` (px), and whose orders are wrong."""
    u = np.random.default_rng(1).uniform(low, high, PIXELS)
    sequence = shown(counts)
    found = decode(captured(sequence, u, ratio), sequence, noise=60 / ratio, white_level=1e9, on_cells=False)
    return found, np.abs(found.u - u) > 0.3 * EXTENT / max(counts)


def best_rate(counts: tuple[int, int], ratio: float) -> float:
    """Share of wrong orders of the nearest line on the torus of both phases, P(|v1 e2 - v2 e1| > pi).

    With the density of the phase e of a complex number of modulus r and unit noise, r = 1 / sigma_phi:
    exp(-r^2 / 2) / 2 pi + r cos(e) Phi(r cos(e)) exp(-(r sin e)^2 / 2) / sqrt(2 pi)
    (a sine wave in Gaussian noise: Middleton, Introduction to Statistical Communication Theory, 1960).
    """
    e, r = np.linspace(-np.pi, np.pi, 20001), ratio * math.sqrt(STEPS / 2)
    ray = r * np.cos(e)
    density = np.exp(-0.5 * r * r) / (2 * np.pi)
    density = density + ray * ndtr(ray) * np.exp(-0.5 * (r * np.sin(e)) ** 2) / math.sqrt(2 * np.pi)
    below = cumulative_simpson(density, x=e, initial=0)
    first, second = counts
    high, low = (np.pi + second * e) / first, (second * e - np.pi) / first
    wrong = 1 - np.interp(high, e, below) + np.interp(low, e, below)
    return float(simpson(density * wrong, x=e))


@pytest.mark.daily(1)
@pytest.mark.parametrize(("counts", "ratio"), [((9, 10), 4.3), ((14, 15), 6.0), ((9, 10), 8.0)])
def test_two_periods_reach_the_best_decision(counts: tuple[int, int], ratio: float) -> None:
    """erfc(pi / (sqrt 2 sigma_phi sqrt(v1^2 + v2^2))) takes the phase for Gaussian, and lies below."""
    found, wrong = decoded(counts, ratio, 0.05 * EXTENT, 0.95 * EXTENT)
    bound = best_rate(counts, ratio)
    counting = math.sqrt(bound * (1 - bound) / wrong.size)
    assert wrong.mean() == pytest.approx(bound, abs=3 * counting)
    gaussian = erfc(math.pi / (math.sqrt(2) * math.sqrt(2 / STEPS) / ratio * math.hypot(*counts)))
    assert gaussian < bound < 1.1 * gaussian
    assert found.order_error.mean() == pytest.approx(wrong.mean(), rel=0.15)


@pytest.mark.daily(2)
@pytest.mark.parametrize("shifts", [(0.0, 2.1, 4.2), (0.0, 1.57, 3.14, 4.71), (0.3, 1.9, 4.0, 5.5, 2.2)])
@pytest.mark.parametrize("top", [np.inf, 200.0])
def test_a_period_is_fitted_by_least_squares(shifts: tuple[float, ...], top: float) -> None:
    """Any shifts, all directions; saturated samples leave the fit where three others are left."""
    rng, read, gain = np.random.default_rng(0), 2.0, 0.05
    shown = Sequence(tuple(Frame("phase", "u", period_px=20.0, shift=shift) for shift in shifts), 4, 20)
    design = np.stack([np.ones(len(shifts)), np.cos(shifts), np.sin(shifts)], axis=1)
    light = design @ np.stack([np.full(600, 120.0), *(60 * rng.standard_normal((2, 600)))])
    frames = np.minimum(light + rng.normal(0, read, light.shape), top).astype(np.float32)
    options = {"noise": read, "gain": gain, "white_level": min(top, 1e9), "on_cells": False}
    found = decode(frames[:, None], shown, **options)
    ratio = []
    for x in range(600):
        kept = frames[:, x] < top
        own = design[kept]
        if kept.sum() < 3 or np.linalg.det(own.T @ own) < 0.05 * np.linalg.det(design.T @ design):
            continue
        a, c, s = np.linalg.lstsq(own, frames[kept, x].astype(float))[0]
        assert (found.u[0, x] - 10 / np.pi * np.arctan2(s, c) + 10) % 20 == pytest.approx(10, abs=1e-5)
        assert found.amplitude[0, x] == pytest.approx(np.hypot(c, s), rel=1e-5)
        assert found.offset[0, x] == pytest.approx(a, abs=1e-4)
        along = 10 / np.pi * np.array([-s, c]) / (c * c + s * s)
        variance = along @ np.linalg.inv(own.T @ own)[1:, 1:] @ along * (read**2 + gain * max(a, 0))
        ratio.append(found.sigma_u[0, x] / np.sqrt(variance))
    assert len(ratio) > 400
    assert np.median(ratio) == pytest.approx(1, rel=1e-3)
    assert min(ratio) > 1 - 1e-3  # neighbours that look elsewhere widen it
