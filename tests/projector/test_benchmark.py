"""The benchmark measures what it says, on either renderer."""

import moderngl

from optolever.projector import measure_renderer
from optolever.scene import dent, load


def test_speeds_on_opengl(gl: moderngl.Context) -> None:
    scene = load("paper-simulation")
    speed = measure_renderer(scene, dent("flat", scene), 60, 80, seconds=0.05, renderer="gl")
    assert (speed.rows, speed.cols, speed.renderer) == (60, 80, "gl")
    assert speed.drawn > 0
    assert speed.read_back > 0
    assert speed.captured > 0
    assert speed.context


def test_speeds_on_numpy() -> None:
    scene = load("paper-simulation")
    speed = measure_renderer(scene, dent("flat", scene), 60, 80, seconds=0.05, renderer="numpy")
    assert (speed.renderer, speed.drawn, speed.read_back) == ("numpy", 0.0, 0.0)
    assert speed.captured > 0
