"""The scenes on board are what the design says, and show what they should at rest."""

import math
from dataclasses import replace

import numpy as np
import pytest

from optolever.scene import dent, dent_from_text, load, resize, trace

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


def test_paper_simulation_is_as_fixed():
    scene = load("paper-simulation")
    camera, pattern = scene.camera, scene.pattern
    assert (camera.rows, camera.cols, pattern.rows, pattern.cols) == (1637, 1637, 1637, 1158)
    assert np.array_equal(camera.pitch, [0.1 / math.sqrt(2), 0.1])
    assert (pattern.pitch, pattern.blur_px) == (0.1, 0.5)
    assert (scene.mirror.length, scene.mirror.width) == (163.7, 163.7)
    assert (scene.medium, scene.display, scene.sensor) == (None, None, None)
    small = replace(scene, camera=replace(camera, rows=1))
    rest = trace(small, dent("flat", small))
    assert np.allclose(rest.incidence, math.pi / 4, atol=1e-15)
    assert np.allclose(rest.x[0], 163.7 - 0.1 * (np.arange(1637) + 0.5), atol=1e-10, rtol=0)


def test_prism48_keeps_total_reflection_for_its_dent():
    scene = resize(load("prism48"), 90, 120)
    assert scene.dent is not None
    assert scene.medium is not None
    seen = trace(scene, dent_from_text(scene.dent, scene))
    assert (scene.medium.reflectance(np.cos(seen.incidence[seen.visible])) == 1).all()
    rest = trace(scene, dent("flat", scene))
    assert np.degrees(rest.incidence) == pytest.approx(48, abs=1e-9)
