"""The scenes on board are what the design says, and show what they should at rest."""

import math

import numpy as np
import pytest

from optolever.scene import Medium, dent, dent_from_text, load, resize, trace

ALL = ("monitor-mirror", "paper-prototype", "paper-simulation", "prism48")


@pytest.mark.parametrize("name", ALL)
def test_every_pixel_sees_the_pattern_at_rest(name):
    small = resize(load(name), 101, 127)
    assert trace(small, dent("flat", small)).visible.all()


@pytest.mark.parametrize("name", ALL)
def test_the_presets_dent_is_seen_and_does_not_fold_the_image(name):
    scene = resize(load(name), 90, 110)
    assert scene.dent is not None
    seen = trace(scene, dent_from_text(scene.dent, scene))
    assert seen.visible.mean() > 0.97
    du, dv = (np.gradient(a) for a in (seen.u, seen.v))
    turn = du[1] * dv[0] - du[0] * dv[1]
    rest = trace(scene, dent("flat", scene))
    still = np.gradient(rest.u)[1] * np.gradient(rest.v)[0] - np.gradient(rest.u)[0] * np.gradient(rest.v)[1]
    inner = np.isfinite(turn)
    assert (np.sign(turn[inner]) == np.sign(still[inner])).all()


@pytest.mark.parametrize("name", ALL)
def test_column_0_is_at_the_cameras_edge(name):
    """Where the default anchor is: its pixels look at x = L0, or at most 0.2 % of the length away."""
    scene = load(name)
    o, d = scene.camera.rays_at(np.linspace(0, scene.camera.rows - 1, 50), -0.5)
    x = o[:, 0] - o[:, 2] / d[:, 2] * d[:, 0]
    assert (x <= scene.mirror.length * (1 + 1e-12)).all()
    assert (x >= 0.998 * scene.mirror.length).all()


def test_prism48_keeps_total_reflection_for_its_dent():
    scene = resize(load("prism48"), 90, 120)
    assert scene.dent is not None
    assert scene.medium is not None
    seen = trace(scene, dent_from_text(scene.dent, scene))
    assert (scene.medium.reflectance(np.cos(seen.incidence[seen.visible])) == 1).all()
    rest = trace(scene, dent("flat", scene))
    assert np.degrees(rest.incidence) == pytest.approx(48, abs=1e-9)


def at(medium, degrees):
    return float(medium.reflectance(np.cos(np.radians(degrees))))


def test_reflectance_is_that_of_textbooks():
    glass = Medium(1.0, outside=1.5)
    assert at(glass, 0) == pytest.approx(0.04, abs=1e-12)
    assert at(Medium(1.5), 0) == pytest.approx(0.04, abs=1e-12)
    brewster = math.degrees(math.atan(1.5))
    r_s = math.sin(math.radians(2 * brewster - 90)) ** 2  # at Brewster's angle only R_s is left: sin^2(i - t)
    assert at(glass, brewster) == pytest.approx(0.5 * r_s, abs=1e-12)
    assert at(glass, 90) == pytest.approx(1.0, abs=1e-12)
