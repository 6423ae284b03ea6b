"""The checker of scene.trace is itself right where the answer is known, and a figure knows its limits."""

import numpy as np
import pytest

from lab.figures.figures import Figure, brute_force
from lab.figures.renderer_speed import measure_renderer
from lab.figures.solver_bound import least_variance
from optolever.projector import chosen_renderer
from optolever.scene import dent, dent_from_text, load, resize, trace


def test_brute_force_on_a_flat_mirror_at_45_degrees() -> None:
    """Rays along (-1, 0, -1) meet z = 0 at x, leave along (-1, 0, 1) and meet the face at x / sqrt 2."""
    scene = resize(load("paper-simulation", exact=True), 64, 64)
    row, col = np.array([3.0, 40.0]), np.array([10.0, 50.5])
    u, v = brute_force(scene, dent_from_text("flat", scene), row, col)
    pitch = scene.mirror.length / 64
    x = scene.mirror.length - (col + 0.5) * pitch
    assert scene.pattern.pitch * (u + 0.5) == pytest.approx(x / np.sqrt(2), abs=1e-9)
    assert v == pytest.approx(row, abs=1e-9)


def test_limits() -> None:
    assert Figure("a", 1.0).met
    assert Figure("a", 1.0, high=1.0).met
    assert not Figure("a", 1.1, high=1.0).met
    assert not Figure("a", 0.5, low=0.9, high=1.1).met
    assert not Figure("a", float("nan"), high=1.0).met


def test_the_bound_of_a_flat_mirror_is_the_same_from_top_to_bottom() -> None:
    scene = resize(load("paper-simulation", exact=True), 13, 13)
    least = least_variance(scene, trace(scene, dent_from_text("flat", scene)), 11)
    assert least.shape == (5, 4)
    assert (least > 0).all()
    np.testing.assert_allclose(least, least[::-1], rtol=1e-3)


@pytest.mark.parametrize("renderer", ["numpy", "auto"])
def test_speeds_of_the_renderers(renderer: str) -> None:
    """Without OpenGL nothing is drawn or read back."""
    scene, chosen = load("paper-simulation"), chosen_renderer(renderer)
    speed = measure_renderer(scene, dent("flat", scene), 60, 80, seconds=0.05, renderer=renderer)
    assert (speed.rows, speed.cols, speed.renderer) == (60, 80, chosen)
    assert (speed.drawn > 0) == (speed.read_back > 0) == (chosen == "gl")
    assert speed.captured > 0
