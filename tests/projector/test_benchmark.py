"""The benchmark measures what it says, on either renderer."""

from optolever.projector import measure_renderer
from optolever.scene import dent, load


def test_speeds(renderer: str) -> None:
    scene = load("paper-simulation")
    speed = measure_renderer(scene, dent("flat", scene), 60, 80, seconds=0.05, renderer=renderer)
    assert (speed.rows, speed.cols, speed.renderer) == (60, 80, renderer)
    assert (speed.drawn > 0) == (speed.read_back > 0) == (renderer == "gl")
    assert speed.captured > 0
