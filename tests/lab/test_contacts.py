"""Contacts on rigs drawn from the priors: errors in units of their total sigma."""

import numpy as np
import pytest

from lab.figures.contacts import Finger, compared, press
from optolever.scene import load, resize

FINGERS = [Finger(25, 16, 0.3, 4.0), Finger(42, 30, 0.1, 3.0)]


@pytest.mark.slow
@pytest.mark.parametrize("at_rest", [True, False])
def test_two_fingers_on_a_drawn_rig(at_rest: bool) -> None:
    """Against a rest capture; and alone, where errors of the rig are larger than the dents."""
    scene = resize(load("prism48"), 120, 160)
    for seed in (1, 2):
        height = press(scene, FINGERS, np.random.default_rng(seed), at_rest)
        if not at_rest:
            assert np.nanmedian(height.calibration_sigma) > 0.3
        found = compared(height, FINGERS, scene)
        for each, depth in zip(found, (0.3, 0.1), strict=True):
            assert each.contact is not None
            assert max(np.abs(list(each.scores.values()))) < 3.5
            assert each.contact.depth_sigma < 0.25 * depth
            assert each.contact.position_sigma > 0.5  # mm: where the rig stands along the mirror
