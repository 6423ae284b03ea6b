"""Captures that were silently wrong (`../shared/cases/t4`), with what is right."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

from optolever.decode import decode
from optolever.patterns import sequence
from optolever.reconstruct import PixelAnchor, reconstruct
from optolever.scene import dent_from_text, load, trace

CASES = Path(__file__).parents[3] / "shared/cases/t4"
pytestmark = pytest.mark.skipif(not CASES.is_dir(), reason="../shared/cases/t4 is absent")


def test_a_mirror_that_moves_while_frames_are_taken() -> None:
    """A dent that grows from 195 to 405 um: the depth at the mean time of the fringes, about 370 um."""
    frames = np.load(CASES / "moving10/frames.npz")["frames"]
    rig = load(CASES / "moving10/rig.toml")
    found = decode(frames, sequence("gray+phase", rig.pattern.rows, rig.pattern.cols))
    height = reconstruct(found, rig, anchor=PixelAnchor(frames.shape[1] // 2, 9, 0.0))
    assert found.notices[0].name.startswith("the mirror moved while the frames were taken")
    moved = height.good & (height.z > 0.05)
    assert moved.any()

    def scores(form: NDArray[np.float64]) -> NDArray[np.float64]:
        text = "gaussian:peak=0.37,sigma={:.9g},x={:.9g},y={:.9g}".format(*form)
        return np.asarray((trace(rig, dent_from_text(text, rig)).z - height.z)[moved] / height.sigma[moved])

    error = scores(least_squares(scores, [6.0, 25.0, 20.0], diff_step=1e-4).x)
    assert 0.5 < np.sqrt(np.mean(error**2)) < 1.25
    assert np.abs(error).max() < 5
    assert height.z[height.good].max() == pytest.approx(0.37, abs=0.02)
