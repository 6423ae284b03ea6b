"""reconstruct() of smooth dents, against the truth."""

import numpy as np
import pytest

from optolever.experiments.metrics import relative_error
from optolever.reconstruct import PixelAnchor, reconstruct

SIDE = 64


@pytest.mark.daily(4)
@pytest.mark.parametrize("preset", ["paper-simulation", "monitor-mirror"])
def test_smooth_dent_without_noise(preset: str, exact) -> None:
    """A whole rectangle: the prism, and the middle of the monitor's mirror."""
    scene, truth, seen = exact(preset, "gaussian", SIDE, SIDE)
    mask = np.zeros((SIDE, SIDE), dtype=bool)
    mask[16:48, 16:48] = True
    anchor = PixelAnchor(32.0, 32.0, float(truth.z[32, 32]))
    height = reconstruct(seen, scene, anchor=anchor, mask=mask)
    assert height.good.sum() == 32 * 32
    assert height.diagnostics.converged
    assert relative_error(height, truth) < 5e-5  # quadrature on 64 pixels


def test_edge_anchor(exact) -> None:
    scene, truth, seen = exact("paper-simulation", "raised-cosine", SIDE, SIDE)
    assert relative_error(reconstruct(seen, scene), truth) < 1e-5
