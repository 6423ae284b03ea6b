"""Differences of two maps of one rest capture and one anchor: their errors count once."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import lab.figures.contacts as drawn
from optolever.decode import Correspondence
from optolever.reconstruct import HeightMap, reconstruct
from optolever.scene import Scene, Surface, dent, load, resize, rig_covariance, trace

from .conftest import correspondence_of

SCENE = resize(load("prism48", exact=True), 48, 64)
NOISE = 0.02
DRAWS = 60


def captured(surface: Surface, sigma: float, rng: np.random.Generator) -> Correspondence:
    return correspondence_of(trace(SCENE, surface), sigma, sigma, rng)


def spread(differences: list[HeightMap]) -> float:
    """Rms of the differences' scatter over the draws, over the stated sigma, the sags' included: median."""
    good = np.all([each.good for each in differences], axis=0)
    scatter = np.std([each.z[good] for each in differences], axis=0, ddof=1)
    return float(np.median(scatter / np.median([each.total_sigma[good] for each in differences], axis=0)))


@cache
def differences(rest_noise: float) -> tuple[list[HeightMap], list[HeightMap]]:
    """Of two presses, drawn: less one rest capture; each less its own."""
    rng, other = np.random.default_rng(5), np.random.default_rng(6)
    pressed = [dent("gaussian", SCENE, peak=peak, sigma=6.0) for peak in (0.05, 0.08)]
    common, apart = list[HeightMap](), list[HeightMap]()
    for _ in range(DRAWS):
        rests = [captured(dent("flat", SCENE), rest_noise, each) for each in (rng, other)]
        first, second = (captured(surface, NOISE, rng) for surface in pressed)
        one = reconstruct(first, SCENE, rest=rests[0])
        for rest, found in zip(rests, (common, apart), strict=True):
            found.append(reconstruct(second, SCENE, rest=rest) - one)
    return common, apart


@pytest.mark.parametrize(
    ("rest_noise", "least"), [(NOISE, 0.85), pytest.param(5 * NOISE, 0.5, marks=pytest.mark.slow)]
)
def test_noise_of_a_common_rest_capture_counts_once(rest_noise: float, least: float) -> None:
    """As large as a capture's: sigma was 1.4 times too wide; five times as large (a short exposure): 5."""
    assert least < spread(differences(rest_noise)[0]) < 1.15


@pytest.mark.parametrize("rest_noise", [NOISE, pytest.param(5 * NOISE, marks=pytest.mark.slow)])
def test_nothing_cancels_of_two_rest_captures(rest_noise: float) -> None:
    assert 0.85 < spread(differences(rest_noise)[1]) < 1.15


def error_over_sigma(scene: Scene, truth: Scene, seed: int) -> float:
    """Rms over the good pixels of a press less another one, captured by the true rig, solved as `rest`."""
    rng, seen, true = np.random.default_rng(seed), [], []
    for peak in (0.20, 0.25):
        where, exact = drawn.captured(truth, dent("gaussian", scene, peak=peak, sigma=6.0), NOISE, rng)
        seen.append(where)
        true.append(exact.z)
    height = reconstruct(seen[1], scene, rest=seen[0])
    assert height.good.mean() > 0.9
    score = (height.z - (true[1] - true[0])) / height.total_sigma
    return float(np.sqrt(np.mean(np.square(score[height.good]))))


def test_a_press_against_another_one_holds_on_wrong_rigs() -> None:
    """On rigs drawn from the typed covariance, on one of a thirtieth of it (calibrated), on an exact one."""
    typed = resize(load("prism48"), 48, 64)
    known, found = rig_covariance(typed), []
    assert known is not None
    for seed in range(7):
        part = 1.0 if seed < 6 else 1 / 30
        share = part**2
        change = part * np.random.default_rng(seed).standard_normal(len(known.root)) @ known.root
        own = replace(known, matrix=share * known.matrix, parts=share * np.asarray(known.parts))
        scene = typed if seed < 6 else replace(typed, covariance=own, accuracy=None)
        found.append(error_over_sigma(scene, drawn.changed(typed, change), seed))
    assert 0.3 < np.sqrt(np.mean(np.square(found))) < 1.2, found
    assert 0.2 < min(found) <= max(found) < 1.5, found
    exact = [error_over_sigma(SCENE, SCENE, seed) for seed in range(7, 13)]
    assert 0.75 < np.sqrt(np.mean(np.square(exact))) < 1.2, exact


@pytest.mark.parametrize("against_rest", [False, True])
def test_a_difference_without_a_common_rest_says_so(against_rest: bool) -> None:
    scene, rng = resize(load("prism48"), 24, 32), np.random.default_rng(3)
    seen = [drawn.captured(scene, dent("gaussian", scene, peak=peak, sigma=6.0), NOISE, rng)[0]
            for peak in (1e-6, 0.05, 0.08)]  # fmt: skip
    one, two = (reconstruct(each, scene, rest=seen[0] if against_rest else None) for each in seen[1:])
    said = [str(each) for each in (two - one).notices if "do not cancel" in str(each)]
    assert bool(said) is not against_rest


def test_a_contact_in_the_rest_capture_is_the_cause_that_is_named() -> None:
    """Beside the press: neither is the silicone thin, as where nothing lies below rest."""
    rng, typed = np.random.default_rng(1), resize(load("prism48"), 48, 64)
    press, rest = (
        captured(dent("gaussian", SCENE, peak=0.2, sigma=6.0, x=x, y=24.0), NOISE, rng) for x in (18.0, 38.0)
    )
    load_, below = reconstruct(press, typed, rest=rest).notices
    assert "the rest capture has a contact of its own" in str(load_)
    assert "right for the difference of two presses" in str(below)
