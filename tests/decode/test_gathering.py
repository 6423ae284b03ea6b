"""Runs of pixels that gather at cells: the kernel against the formulas in NumPy."""

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.decode.gathering import gathered

F64 = NDArray[np.float64]
RUN = 32


def phasors(places: F64) -> NDArray[np.complex128]:
    return np.asarray(np.exp(2j * np.pi * places).mean(axis=1))


def by_formula(runs: F64, noise: F64) -> tuple[F64, F64, F64]:
    """What `gathered` says of unflagged runs (K, RUN) of usual sigma (K,)."""
    place = np.linspace(-1, 1, RUN)
    design = np.stack([np.ones(RUN), place, place**2], axis=1)
    fit = (design @ np.linalg.lstsq(design, runs.T, rcond=None)[0]).T
    rest, wave = runs - fit, np.sin(2 * np.pi * fit)
    stairs = np.sum(rest * wave, axis=1) ** 2 / np.sum(wave**2, axis=1)
    like = np.sum(rest**2, axis=1) - 2 * stairs <= RUN * noise**2 * (1 + 5 * np.sqrt(2 / RUN))
    even = (np.abs(phasors(fit)) < 0.3) & (np.abs(phasors(2 * fit)) < 0.3)
    gradient = np.abs(np.diff(fit, axis=1)).mean(axis=1)
    keep = like & even & (gradient > 0.05) & (np.abs(rest).max(axis=1) < 0.75 + 4 * noise)
    seen = (phasors(runs) - phasors(fit)).real * np.exp(2 * (np.pi * noise) ** 2)
    return seen[keep], gradient[keep], np.sinc(gradient[keep])


def maps(rng: np.random.Generator) -> tuple[F64, NDArray[np.float32], NDArray[np.uint16]]:
    """(96, 160): lines of any gradient, bend and height of stairs, some too rough, some too bent."""
    x = np.arange(160.0)
    slope, bend = rng.uniform(0.0, 2.2, (96, 1)), rng.uniform(-2e-3, 2e-3, (96, 1))
    smooth = rng.uniform(0, 900, (96, 1)) + slope * x + bend * x**2
    stairs = rng.uniform(0, 0.15, (96, 1)) * np.sin(2 * np.pi * smooth)
    noise = rng.choice([0.01, 0.05, 0.2], (96, 1))
    coord = smooth - stairs + noise * rng.standard_normal((96, 160))
    coord[::7, 30] += 3.0
    sigma = (noise * rng.uniform(0.7, 1.3, (96, 160))).astype(np.float32)
    flags = (rng.random((96, 160)) < 0.002).astype(np.uint16)
    return coord, sigma, flags


@pytest.mark.parametrize("down", [False, True])
def test_runs_gather_as_the_formula_says(down: bool) -> None:
    coord, sigma, flags = maps(np.random.default_rng(3))  # fewer runs than are looked at: all of them are
    good = (flags.reshape(-1, RUN) == 0).all(axis=1)
    runs = coord.reshape(-1, RUN)[good]
    noise = np.sort(sigma.reshape(-1, RUN)[good], axis=1)[:, RUN // 2].astype(np.float64)
    want = by_formula(runs, noise)
    turned = [np.ascontiguousarray(chart.T) if down else chart for chart in (coord, sigma, flags)]
    got = gathered(*turned, down)
    assert 100 < len(want[0]) < len(runs) - 50  # all reasons to leave one out occur
    assert len(got[0]) == len(want[0])
    for one, other in zip(got, want, strict=True):
        np.testing.assert_allclose(one, other, atol=2e-5)


def test_images_smaller_than_a_run_tell_nothing() -> None:
    small = np.zeros((4, RUN - 1))
    told = gathered(small, small.astype(np.float32), small.astype(np.uint16), False)
    assert [len(values) for values in told] == [0, 0, 0]
