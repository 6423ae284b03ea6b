"""A rest capture as reference, and a start from an earlier height."""

from dataclasses import replace

import numpy as np

from optolever.experiments.metrics import relative_error
from optolever.reconstruct import reconstruct


def test_rest_capture_takes_off_the_calibration_and_adds_its_noise_and_its_gaps(exact) -> None:
    """The pattern is 0.3 cells off in both captures."""
    scene, truth, correspondence = exact("paper-simulation", "raised-cosine", 96, 96)
    _, _, rest = exact("paper-simulation", "flat", 96, 96)
    flags = rest.flags.copy()
    flags[40, 50] = 1
    alone = reconstruct(correspondence, scene)
    seen, rest = (replace(each, u=each.u + 0.3, v=each.v - 0.3) for each in (correspondence, rest))
    both = reconstruct(seen, scene, rest=replace(rest, flags=flags))
    assert relative_error(both, truth) < 1e-3 * relative_error(reconstruct(seen, scene), truth)
    assert both.flags[40, 50] == 128
    ratio = both.sigma[alone.good & both.good] / alone.sigma[alone.good & both.good]
    np.testing.assert_allclose(ratio, np.sqrt(2), rtol=0.01)


def test_warm_start(exact, cut) -> None:
    """From a neighbouring dent with a hole: the same height as from rest."""
    scene, _, correspondence = exact("paper-simulation", "raised-cosine:peak=1.2", 96, 96)
    _, _, before = exact("paper-simulation", "raised-cosine:peak=1.3", 96, 96)
    keep = np.ones((96, 96), dtype=bool)
    keep[30:40, 30:40] = False
    start = reconstruct(cut(before, keep), scene)
    warm, cold = reconstruct(correspondence, scene, start=start), reconstruct(correspondence, scene)
    assert np.nanmax(np.abs(warm.z - cold.z)) < 1e-6
    assert warm.diagnostics.steps[0] < 0.3 * cold.diagnostics.steps[0]
    same = reconstruct(correspondence, scene, start=cold)
    assert len(same.diagnostics.steps) <= 2
