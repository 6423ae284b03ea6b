"""The way from pixels to an anchor beside them: what curves add to it, and when there is none."""

import numpy as np
import pytest

from optolever.reconstruct import PointAnchor, reconstruct
from optolever.scene import adjusted, dent, trace

APART = "The anchors contradict each other; rms in sigma"


@pytest.mark.daily(1)
@pytest.mark.parametrize("preset", ["prism48", "paper-simulation", "monitor-mirror"])
def test_an_edge_that_cannot_rest_tells_that_the_rig_is_wrong(preset: str, exact, noisy) -> None:
    """A camera that is turned by 0.2 degrees tilts the mirror along its edge, which no other notice tells."""
    scene, truth, _ = exact(preset, "gaussian", 60, 80)
    turned = trace(adjusted(scene, {"camera.rx": np.radians(0.2)}), dent("gaussian", scene))
    for seed in range(3):
        right, wrong = (reconstruct(noisy(seen, 0.02, 0.02, seed), scene).notices for seen in (truth, turned))
        assert APART not in [notice.name for notice in right]
        assert APART in [notice.name for notice in wrong]


@pytest.mark.parametrize(("sigma", "told"), [(1e-3, True), (0.1, False)])
def test_known_points_that_contradict_each_other(sigma: float, told: bool, exact, noisy) -> None:
    scene, truth, _ = exact("prism48", "flat", 60, 80)
    points = [PointAnchor(50.0, 20.0, 0.0, sigma), PointAnchor(45.0, 25.0, 0.1, sigma)]
    height = reconstruct(noisy(truth, 0.02, 0.02, 0), scene, anchor=points)
    assert (APART in [notice.name for notice in height.notices]) == told
