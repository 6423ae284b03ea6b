"""Slopes that change too fast between pixels: found, gone around, flagged, in sigma; no wrong pixels."""

from dataclasses import replace

import numpy as np
import pytest

from lab.calibration.rigs import correspondence_of, prism
from optolever.reconstruct import HeightFlag, reconstruct
from optolever.scene import Surface

from .conftest import scores

BALL = "ball:peak=2.452,radius=186.5,"


@pytest.mark.daily(9)
@pytest.mark.parametrize(
    ("preset", "dent", "size", "sigma", "noise", "seed", "good"),
    [
        ("paper-simulation", "needle:peak=6", (96, 96), 0.05, 0.05, 0, 0.98),
        ("paper-simulation", "rounded-needle:peak=8", (96, 96), 0.05, 0.05, 0, 0.98),
        ("monitor-mirror", "needle", (96, 96), 0.05, 0.05, 0, 0.98),
        ("monitor-mirror", "needle", (60, 70), 1e-4, 1e-4, 1, 0.93),
        # two pixels alone in a row, beside excluded ones: their edge counts no more than the edges around
        *(("paper-simulation", "ridge:angle_deg=30", (60, 70), 1e-4, 1e-4, seed, 0.93) for seed in range(6)),
        # one side agrees by accident in the very edges that a curved rim's slopes jump in, and all of these
        # are off to the same side: what is inside stands as a whole too low
        ("paper-simulation", BALL + "x=24.03,y=77.63", (169, 117), 0.01, 0.004, 11, 0.985),
        ("paper-simulation", BALL + "x=24.55,y=81.85", (169, 117), 0.01, 0.004, 11, 0.985),
    ],
)
def test_no_silent_error_around_steep_dents(exact, noisy, preset, dent, size, sigma, noise, seed, good):
    scene, truth, _ = exact(preset, dent, *size)
    height = reconstruct(noisy(truth, sigma, noise, seed), scene)
    assert (height.flags & (HeightFlag.STEEP | HeightFlag.CURL)).any()
    assert height.good.mean() > good
    assert np.nanmax(np.abs(scores(height, truth))) < 5.0


def test_a_punch_is_as_low_as_its_sigma_says() -> None:
    """The slope at its rim has no bound: the step there is taken for too small all around."""
    rng = np.random.default_rng(1)
    take = correspondence_of(0.005, rng)
    rig = prism(rng, 0, take, size=160)
    x, y, radius, peak = 30.0, 24.0, 3.6, 0.03

    def gradient(at, along):
        q = np.maximum(np.hypot(at - x, along - y) / radius, 1.0)
        fall = -2 / np.pi * peak / (q * radius) ** 2 / np.sqrt(np.maximum(q * q - 1, 1e-12)) * (q > 1)
        sides = zip(rig.rest.gradient(at, along), (at - x, along - y), strict=True)
        return tuple(slope + fall * side for slope, side in sides)

    def punch(at, along):
        return peak * 2 / np.pi * np.arcsin(1 / np.maximum(np.hypot(at - x, along - y) / radius, 1.0))

    pressed = Surface(lambda at, along: rig.rest.height(at, along) + punch(at, along), gradient)
    found = reconstruct(take(rig.truth, pressed, 0), rig.truth, rest=take(rig.truth, rig.rest, 0))
    off = (found.z - punch(found.x, found.y)) / found.total_sigma
    inside = found.good & (np.hypot(found.x - x, found.y - y) < 0.8 * radius)
    assert np.median(np.abs(off[inside])) < 4.0


SIGMA = 0.05


def curled(height) -> np.ndarray:
    return np.asarray((height.flags & HeightFlag.CURL) > 0)


def test_large_errors_are_found_in_pairs_too_and_little_else(exact, noisy) -> None:
    """Beside a missing pixel, too: what was interpolated from a wrong one is no witness."""
    scene, truth, _ = exact("monitor-mirror", "gaussian", 60, 70)
    clean = noisy(truth, SIGMA, SIGMA)
    places = [(5, 5), (0, 30), (20, 69), (21, 69), (40, 40), (40, 41), (30, 12)]
    u, flags = clean.u.copy(), clean.flags.copy()
    for k, place in enumerate(places):
        u[place] += (-1) ** k * (4.0 + 2 * k)
    flags[30, [11, 13]] = flags[29, 12] = 1
    height = reconstruct(replace(clean, u=u, flags=flags), scene)
    found = curled(height)
    assert all(found[place] for place in places)
    assert found.sum() <= 3 * len(places)
    score = np.where(height.good, (height.z - truth.z) / height.sigma, 0.0)
    assert np.abs(score).max() < 5


@pytest.mark.parametrize("off", [0.5, 30.0])
def test_a_patch_of_wrong_places_is_flagged(exact, noisy, off: float) -> None:
    """And nothing around it is off."""
    scene, truth, _ = exact("prism48", "gaussian", 60, 80)
    seen, wrong = noisy(truth, 0.02, 0.02), np.zeros(truth.u.shape, np.bool_)
    wrong[20:32, 30:42] = True
    height = reconstruct(replace(seen, u=np.where(wrong, seen.u + off, seen.u)), scene)
    assert curled(height)[wrong].mean() > 0.95
    assert height.good[~wrong].mean() > 0.97
    assert np.nanmax(np.abs(scores(height, truth)[~wrong])) < 5


@pytest.mark.daily(1)
@pytest.mark.parametrize("dent", ["ridge:angle_deg=30", "ball", "needle"])
def test_a_crease_a_rim_and_a_tip_are_no_outliers(exact, noisy, dent: str) -> None:
    """But for pixels of their very edge."""
    scene, truth, _ = exact("paper-simulation", dent, 60, 70)
    assert curled(reconstruct(noisy(truth, SIGMA, SIGMA), scene)).mean() < 0.002
    assert curled(reconstruct(noisy(truth, 1e-4, 1e-4), scene)).mean() < 0.03
