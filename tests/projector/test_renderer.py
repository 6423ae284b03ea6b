"""Frames drawn by OpenGL are NumPy's, bit for bit."""

import moderngl
import numpy as np
import pytest

from optolever.patterns import Frame, Sequence, sequence, sequence_names
from optolever.projector import PatternRenderer

KINDS = Sequence(
    (
        Frame("white"), Frame("black"), Frame("uniform", level=77),
        Frame("stripe", "u", width_px=9.5, at_u=20.25), Frame("gray", "v", bit=3, inverted=True),
        Frame("binary", "u", bit=0), Frame("long-run-gray", "v", bit=2, cell_px=1.5),
        Frame("phase", "u", period_px=7.3, shift=1.1),
        Frame("phase", "v", period_px=100.0, shift=0.2, inverted=True), Frame("crossed", period_px=9.7),
        Frame("crossed", period_px=9.7, inverted=True), Frame("lattice", period_px=12.5, width_px=2.25),
        Frame("levels", "u", levels=tuple(range(0, 256, 5))),
    ),
    53,
    131,
)  # fmt: skip


@pytest.mark.parametrize("name", ["every kind", *sequence_names()])
def test_frames_are_bit_equal_in_any_order(gl: moderngl.Context, name: str) -> None:
    shown = KINDS if name == "every kind" else sequence(name, 61, 97)
    out = np.zeros((shown.rows, shown.cols), np.uint8)
    with PatternRenderer(shown) as renderer:
        for index in reversed(range(len(shown))):
            assert renderer.frame(index, out) is out
            np.testing.assert_array_equal(out, shown.render_frame(index))
