"""One period's fit, against NumPy in float64."""

import numpy as np
import pytest

from optolever.decode import decode
from optolever.patterns import Frame, Sequence


@pytest.mark.parametrize("shifts", [(0.0, 2.1, 4.2), (0.0, 1.57, 3.14, 4.71), (0.3, 1.9, 4.0, 5.5, 2.2)])
@pytest.mark.parametrize("top", [np.inf, 200.0])
def test_a_period_is_fitted_by_least_squares(shifts: tuple[float, ...], top: float) -> None:
    """Any shifts, all directions; saturated samples leave the fit where three others are left."""
    rng, read, gain = np.random.default_rng(0), 2.0, 0.05
    shown = Sequence(tuple(Frame("phase", "u", period_px=20.0, shift=shift) for shift in shifts), 4, 20)
    design = np.stack([np.ones(len(shifts)), np.cos(shifts), np.sin(shifts)], axis=1)
    light = design @ np.stack([np.full(600, 120.0), *(60 * rng.standard_normal((2, 600)))])
    frames = np.minimum(light + rng.normal(0, read, light.shape), top).astype(np.float32)
    options = {"noise": read, "gain": gain, "white_level": min(top, 1e9), "on_cells": False, "check": False}
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
