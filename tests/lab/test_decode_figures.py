"""The decoder's figures: errors are those that noise allows; how fast it is, is not a matter of tests."""

import math

import numpy as np
import pytest

from lab.figures.decode_speed import (
    SPEED_CODES,
    SpeedCode,
    run_decode_figures,
    smooth_map,
    speed_frames,
    speed_sequence,
)
from optolever.decode import decode

SIZE = (40, 64)
#: On which 40 fringes have periods of more than four cells.
LARGER = (180, 240)


@pytest.mark.slow
def test_every_code_has_its_row() -> None:
    """Ratio and time of each; what is decoded is good."""
    figures = run_decode_figures(size=SIZE, parts=("codes",))
    assert [f.name for f in figures] == [f"{code.name}, decode over floor" for code in SPEED_CODES]
    for figure in figures:
        assert 0 < figure.value < math.inf
        assert "ns per frame and pixel" in figure.note


@pytest.mark.daily(1)
@pytest.mark.parametrize("code", SPEED_CODES, ids=lambda code: code.name)
def test_frames_show_the_smooth_map(code: SpeedCode) -> None:
    """Most pixels are decoded, to within a cell and a half of where they look."""
    shown = speed_sequence(code, LARGER)
    found = decode(speed_frames(shown, LARGER, code.noise), shown)
    u, v = smooth_map(LARGER, (shown.rows, shown.cols))
    good = found.good
    assert good.mean() > 0.5
    assert max(np.abs(found.u - u)[good].max(), np.abs(found.v - v)[good].max()) < 1.5


@pytest.mark.slow
def test_all_are_met() -> None:
    figures = run_decode_figures(parts=("errors",))
    assert len(figures) == 19
    assert [figure.name for figure in figures if not figure.met] == []
