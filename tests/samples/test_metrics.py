"""Metrics against closed forms on made-up records."""

import math

import numpy as np
import pytest

from optolever.decode import Correspondence
from optolever.reconstruct import HeightMap
from optolever.report.maps import reliability
from optolever.samples import height_metrics
from optolever.scene import Trace

SHAPE = (4, 5)


def test_headline_numbers() -> None:
    """A mirror 2 mm deep, a corner out of view; coordinates and heights off by 0.1, sigmas 0.5 and 1."""
    visible = np.ones(SHAPE, dtype=bool)
    visible[0, 0] = False
    x, y, z = (
        np.where(visible, part, np.nan) for part in (*np.meshgrid(range(5), range(4)), np.full(SHAPE, 2.0))
    )
    exact = Trace(10 * x, 10 * y, x, y, z, np.full((*SHAPE, 3), np.nan), z, visible)
    u, v, at_x, at_y, height = (np.nan_to_num(a) + 0.1 for a in (exact.u, exact.v, x, y, z))
    flags, sigma = np.zeros(SHAPE, dtype=np.uint16), np.full(SHAPE, 0.5)
    flags[0, 0], flags[1, 1] = 1, 8
    numbers, none = (
        height_metrics(
            exact, Correspondence(u, v, sigma, 2 * sigma, each), HeightMap(at_x, at_y, height, sigma, each)
        )
        for each in (flags, np.ones_like(flags))
    )
    expected = {
        "height_rms_rel": 0.05, "height_max_rel": 0.05, "peak_depth_mm": 2.0, "unflagged_share": 18 / 19,
        "unflagged_invisible": 0, "sigma_ratio_u": 0.2, "sigma_ratio_v": 0.1, "sigma_ratio_height": 0.2,
        "sigma_ratio_total": 0.2, "height_sigma_mm": 0.5, "height_median_mm": 0.1,
    }  # fmt: skip
    assert {name: numbers[name] for name in expected} == pytest.approx(expected)
    rig = HeightMap(at_x, at_y, height, sigma, flags, modes=np.full((1, *SHAPE), 1.2, np.float32))
    total = height_metrics(exact, Correspondence(u, v, sigma, sigma, flags), rig)
    assert total["sigma_ratio_total"] == pytest.approx(0.1 / 1.3)
    assert total["sigma_ratio_height"] == pytest.approx(0.2)
    assert math.isnan(none["height_rms_rel"])
    assert none["unflagged_share"] == 0


def test_reliability_finds_true_and_false_error_bars() -> None:
    rng = np.random.default_rng(5)
    sigma = 10 ** rng.uniform(-2, 0, 60_000)
    for factor in (1.0, 3.0):
        predicted, measured = reliability(factor * sigma * rng.standard_normal(sigma.size), sigma)
        assert np.all(np.diff(predicted) > 0)
        np.testing.assert_allclose(measured / predicted, factor, rtol=0.05)
