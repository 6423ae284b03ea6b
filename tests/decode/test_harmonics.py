"""Harmonic error that is predicted against the error that is there."""

from dataclasses import replace

import numpy as np
import pytest

from optolever import InputError
from optolever.calibration import harmonic_errors
from optolever.decode import Response, decode
from optolever.patterns import sequence

from .conftest import Map, Shoot

TOP = 60000.0


def predicted_and_true(
    shoot: Shoot, smooth: Map, steps: int, gamma: float | None, noise: float, uneven: bool
) -> tuple[float, float, float]:
    """rms_px, rms of the real error, sigma_px of u under gamma 2.2, inverted as `gamma`."""
    shown = sequence("gray+phase", 150, 170, steps=steps, axes="u")
    light = TOP / 2 * (np.linspace(1.0, 0.6, 140)[None, :] if uneven else 1.0) * np.ones((120, 1))
    camera = {"gamma": 2.2, "dtype": np.uint16, "offset": light, "amplitude": light}
    response = None if gamma is None else Response.from_gamma(gamma, TOP)
    seen = [
        shoot(shown, *smooth, **camera, noise=noise * light / 127.5, seed=seed)
        for seed in range(8 if noise else 2)
    ]
    (error,) = harmonic_errors(seen[0], shown, response)
    assert error.axis == "u"
    off = np.array([decode(one, shown, response=response, on_cells=False).u - smooth[0] for one in seen])
    # what noise leaves in the mean of some captures is taken off
    true = np.mean(off.mean(axis=0) ** 2) - np.mean(off.var(axis=0, ddof=1)) / len(off)
    return error.rms_px, float(np.sqrt(max(true, 0.0))), error.sigma_px


@pytest.mark.parametrize(
    "gamma", [None, 1.5, *(pytest.param(gamma, marks=pytest.mark.slow) for gamma in (1.8, 2.8))]
)
@pytest.mark.parametrize(
    ("steps", "noise", "uneven"),
    [(3, 0.0, False), (4, 0.0, False), (5, 0.0, True), (3, 0.1, True), (4, 0.1, True)],
)
def test_of_a_wrong_gamma(
    shoot: Shoot, smooth: Map, steps: int, gamma: float | None, noise: float, uneven: bool
) -> None:
    told, true, sigma = predicted_and_true(shoot, smooth, steps, gamma, noise, uneven)
    assert told == pytest.approx(true, rel=0.2, abs=3 * sigma)


@pytest.mark.parametrize("steps", [3, 4, 5])
def test_of_the_right_gamma_is_nought(shoot: Shoot, smooth: Map, steps: int) -> None:
    told, true, _ = predicted_and_true(shoot, smooth, steps, 2.2, 0.0, False)
    assert told < 1e-3
    assert true < 1e-3


def test_shifts_that_tell_nothing_are_left_out(shoot: Shoot, smooth: Map) -> None:
    shown = sequence("gray+phase", 150, 170)
    frames = shoot(shown, *smooth)
    uneven = [k for k, frame in enumerate(shown.frames) if (frame.axis, frame.shift) != ("v", 0.0)]
    shorter = replace(shown, frames=tuple(shown.frames[k] for k in uneven))
    assert [error.axis for error in harmonic_errors(frames[uneven], shorter)] == ["u"]
    with pytest.raises(InputError, match="must be uint8 or uint16"):
        harmonic_errors(frames.astype(np.float32), shown, Response.from_gamma(2.2))
