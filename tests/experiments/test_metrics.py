"""Metrics against closed forms on made-up records."""

import math

import numpy as np
import pytest

from optolever.decode import Correspondence
from optolever.experiments import height_metrics
from optolever.experiments.maps import reliability
from optolever.reconstruct import HeightMap
from optolever.scene import Trace

SHAPE = (4, 5)


def truth(visible: np.ndarray) -> Trace:
    """A mirror 2 mm deep everywhere it is seen."""
    field = np.where(visible, 2.0, np.nan)
    x, y = (np.where(visible, grid, np.nan) for grid in np.meshgrid(np.arange(5.0), np.arange(4.0)))
    nothing = np.full((*SHAPE, 3), np.nan)
    return Trace(u=10 * x, v=10 * y, x=x, y=y, z=field, normal=nothing, incidence=field, visible=visible)


@pytest.fixture
def visible() -> np.ndarray:
    seen = np.ones(SHAPE, dtype=bool)
    seen[0, 0] = False
    return seen


def records(exact: Trace, error: float, flags: np.ndarray) -> tuple[Correspondence, HeightMap]:
    """Every coordinate and height off by `error`, every sigma 0.5; numbers even where nothing is seen."""
    u, v, x, y, z = (np.nan_to_num(a) + error for a in (exact.u, exact.v, exact.x, exact.y, exact.z))
    sigma = np.full(SHAPE, 0.5)
    return Correspondence(u, v, sigma, 2 * sigma, flags), HeightMap(x, y, z, sigma, flags)


def test_headline_numbers(visible: np.ndarray) -> None:
    exact, flags = truth(visible), np.zeros(SHAPE, dtype=np.uint16)
    flags[0, 0] = 1
    flags[1, 1] = 8
    numbers = height_metrics(exact, *records(exact, 0.1, flags))
    assert numbers["height_rms_rel"] == pytest.approx(0.05)
    assert numbers["height_max_rel"] == pytest.approx(0.05)
    assert numbers["peak_depth_mm"] == 2.0
    assert numbers["unflagged_share"] == pytest.approx(18 / 19)
    assert numbers["unflagged_invisible"] == 0
    assert numbers["sigma_ratio_u"] == pytest.approx(0.2)
    assert numbers["sigma_ratio_v"] == pytest.approx(0.1)
    assert numbers["sigma_ratio_height"] == pytest.approx(0.2)


def test_nothing_unflagged_is_no_number_and_no_warning(visible: np.ndarray) -> None:
    exact = truth(visible)
    numbers = height_metrics(exact, *records(exact, 0.1, np.ones(SHAPE, dtype=np.uint16)))
    assert math.isnan(numbers["height_rms_rel"])
    assert numbers["unflagged_share"] == 0


def test_reliability_finds_true_and_false_error_bars() -> None:
    rng = np.random.default_rng(5)
    sigma = 10 ** rng.uniform(-2, 0, 60_000)
    for factor in (1.0, 3.0):
        predicted, measured = reliability(factor * sigma * rng.standard_normal(sigma.size), sigma)
        assert np.all(np.diff(predicted) > 0)
        np.testing.assert_allclose(measured / predicted, factor, rtol=0.05)
