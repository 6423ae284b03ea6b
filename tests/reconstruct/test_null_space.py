"""What no slope measurement sees, against the closed form."""

import numpy as np

from optolever.reconstruct import null_space


def test_the_prism_turns_about_the_pattern_edge(exact) -> None:
    """45 degrees: in proportion to x; the trapezoid's integrating factor is exact for that."""
    scene, truth, _ = exact("paper-simulation", "flat", 64, 96)
    mode = null_space(scene)
    known = np.isfinite(mode)
    assert known.mean() > 0.9
    ratio = (mode / truth.x)[known]
    np.testing.assert_allclose(ratio, ratio.mean(), rtol=1e-6)
    assert np.nanmax(mode) == 1.0
