"""One period's fit and the phase of two sums, against NumPy in float64."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.decode.frames import light_of
from optolever.decode.noise import Noise
from optolever.decode.phase import fit_line, periods_of, turn_of
from optolever.decode.plan import plan
from optolever.kernels import exact
from optolever.patterns import Frame, Sequence

F32 = NDArray[np.float32]


@exact
def _turns(c: Any, s: Any, out: Any) -> None:
    for x in range(c.size):
        out[x] = turn_of(s[x], c[x])


def turns(c: Any, s: Any) -> F32:
    out = np.empty(len(c), np.float32)
    _turns(c.astype(np.float32), s.astype(np.float32), out)
    return out


def test_all_directions() -> None:
    """Axes and bisectors among them, whole numbers as of grey values; a number too where both sums are 0.

    Error: the polynomial's 6e-9 turns, and a rounding at 1/2.
    """
    at = np.linspace(-np.pi, np.pi, 8 * 12345 + 1)
    circles = [size * part(at) for part in (np.cos, np.sin) for size in (0.5, 37.25, 65535.0)]
    grid = np.meshgrid(np.arange(-255.0, 256), np.arange(-255.0, 256))
    c, s = (np.concatenate([*circles[3 * k : 3 * k + 3], grid[k].ravel()]).astype(np.float32) for k in (0, 1))
    found = turns(c, s)
    off = found - np.arctan2(s.astype(float), c.astype(float)) / (2 * np.pi)
    assert np.abs((off[(c != 0) | (s != 0)] + 0.5) % 1 - 0.5).max() < 6e-9 + 2**-24
    assert np.abs(found).max() <= 0.5


@pytest.mark.parametrize("shifts", [(0.0, 2.1, 4.2), (0.0, 1.57, 3.14, 4.71), (0.3, 1.9, 4.0, 5.5, 2.2)])
@pytest.mark.parametrize("clipped", [False, True])
def test_a_period_is_fitted_by_least_squares(shifts: tuple[float, ...], clipped: bool) -> None:
    """Any shifts; saturated samples leave the fit where three others are left, else nothing is known."""
    rng, read, gain = np.random.default_rng(0), 2.0, 0.05
    shown = Sequence(tuple(Frame("phase", "u", period_px=20.0, shift=shift) for shift in shifts), 4, 20)
    design = np.stack([np.ones(len(shifts)), np.cos(shifts), np.sin(shifts)], axis=1)
    light = design @ np.stack([np.full(600, 120.0), *(60 * rng.standard_normal((2, 600)))])
    frames = np.clip(light + rng.normal(0, 2, light.shape), 0, 200 if clipped else None)
    frames = frames.astype(np.float32)[:, None]
    fringe = plan(shown).axes[0].fringes[0]
    turn, variance, amplitude, offset, chi2, _ = fit = tuple(np.empty((6, 600), np.float32))
    light_in = light_of(frames, shown, 200.0 if clipped else 1e9, None).numbers()
    work, periods = np.empty((2, 600), np.float32), periods_of((fringe,), (0.0,))
    fit_line(light_in, Noise(read**2, gain).numbers(), periods, 0, 0, work, fit)
    checked = 0
    for x in range(600):
        kept = frames[:, 0, x] < (200.0 if clipped else np.inf)
        if kept.sum() < 3:
            assert variance[x] > 1
            continue
        own, level = design[kept], frames[kept, 0, x].astype(float)
        if np.linalg.det(own.T @ own) < 0.05 * np.linalg.det(design.T @ design):
            continue
        a, c, s = np.linalg.lstsq(own, level, rcond=None)[0]
        covariance = np.linalg.inv(own.T @ own)[1:, 1:] * (read**2 + gain * max(a, 0))
        along = np.array([-s, c]) / (c * c + s * s) / (2 * np.pi)
        assert (turn[x] - np.arctan2(s, c) / (2 * np.pi) + 0.5) % 1 == pytest.approx(0.5, abs=1e-5)
        assert variance[x] == pytest.approx(along @ covariance @ along, rel=2e-3)
        assert amplitude[x] == pytest.approx(np.hypot(c, s), rel=1e-4)
        assert offset[x] == pytest.approx(a, rel=1e-4, abs=1e-3)
        rss = np.sum((level - own @ [a, c, s]) ** 2) / (read**2 + gain * max(a, 0))
        assert chi2[x] == pytest.approx(rss, rel=2e-3, abs=2e-3)
        checked += 1
    assert checked > 200
