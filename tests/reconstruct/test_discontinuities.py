"""Slopes that change too fast between pixels: found, gone around, flagged, in sigma; no wrong pixels."""

from dataclasses import replace

import numpy as np
import pytest

from optolever.reconstruct import HeightFlag, reconstruct
from optolever.scene import Surface, load, resize, trace

from .conftest import correspondence_of, rms_score, scores

BALL = "ball:peak=2.452,radius=186.5,"


@pytest.mark.daily(3)
@pytest.mark.parametrize(
    ("preset", "dent", "size", "sigma", "noise", "seed", "good"),
    [
        ("paper-simulation", "needle:peak=6", (96, 96), 0.05, 0.05, 0, 0.98),
        ("paper-simulation", "rounded-needle:peak=8", (96, 96), 0.05, 0.05, 0, 0.98),
        ("monitor-mirror", "needle", (96, 96), 0.05, 0.05, 0, 0.98),
        # what one side explains by accident is as large as the noise allows: the edges beside say more
        ("paper-simulation", "ridge:angle_deg=30", (60, 70), 1e-4, 1e-4, 1, 0.93),
        ("monitor-mirror", "needle", (60, 70), 1e-4, 1e-4, 1, 0.93),
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


def test_a_plateau_whose_rim_leaves_the_pattern() -> None:
    """Where the rim is seen its slopes jump between pixels: its height is nowhere to be had, as the rest of
    it leaves the pattern."""
    scene = resize(load("paper-simulation", exact=True), 64, 72)
    middle, radius, peak = scene.mirror.length / 2, 0.2 * scene.mirror.length, 8.0
    width = scene.mirror.length / scene.camera.cols

    def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        distance = np.hypot(x - middle, y - scene.mirror.width / 2)
        return 0.5 * peak * (1 + np.tanh((radius - distance) / width))

    def gradient(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        off = x - middle, y - scene.mirror.width / 2
        distance = np.maximum(np.hypot(*off), 1e-9)
        slope = -0.5 * peak / width / np.cosh((radius - distance) / width) ** 2
        return slope * off[0] / distance, slope * off[1] / distance

    truth = trace(scene, Surface(height, gradient))
    found = reconstruct(correspondence_of(truth, 0.02, 0.02), scene)
    assert found.good.mean() > 0.8
    assert (np.abs(scores(found, truth)) > 5).sum() <= 2


def test_dense_outliers_are_gone_around(exact, noisy) -> None:
    """5 % wrong pixels: the height stays within a few percent of the dent, as one solve does not."""
    scene, truth, _ = exact("paper-simulation", "gaussian", 96, 96)
    clean = noisy(truth, sigma=0.05, noise=0.05)
    rng = np.random.default_rng(4)
    wrong = rng.random(truth.u.shape) < 0.05
    u = clean.u + np.where(wrong, rng.normal(0.0, 20.0, wrong.shape), 0.0)
    height = reconstruct(replace(clean, u=u), scene)
    assert (np.abs(scores(height, truth)) > 5).sum() < 1e-3 * height.good.sum()


@pytest.mark.daily(1)
@pytest.mark.parametrize("sigma", [0.012, 0.003])
def test_a_rim_that_one_side_explains_by_accident(exact, noisy, sigma: float) -> None:
    """Outside its contact a ball's slope leaves like a root: some edges agree with it from that side. What
    lies inside is as unsure as the rim, whose edges count next to nothing: a long way for a linear solve."""
    scene, truth, _ = exact("monitor-mirror", "ball", 128, 153)
    height = reconstruct(noisy(truth, sigma=sigma, noise=sigma, seed=1), scene)
    score = scores(height, truth)
    assert height.good.mean() > 0.95
    assert (np.abs(score) > 5).mean() < 1e-4
    assert rms_score(score) < 1.3


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
