"""What a capture is worth, against adjustments without it."""

from dataclasses import replace

import numpy as np
import pytest

from lab.calibration.rigs import correspondence_of, open_air
from optolever.calibration import Calibration, calibrate, judged, predicted_maps
from optolever.calibration.adjust import adjust
from optolever.scene import Covariance


@pytest.fixture(scope="module")
def found() -> Calibration:
    rng = np.random.default_rng(3)
    rig = open_air(rng, 4, correspondence_of(0.0016, rng), size=60)
    return calibrate(rig.truth, rig.observations, guess=True)


def sigmas_without(found: Calibration, names: set[str]) -> tuple[float, float]:
    """Sigma of height and depth (mm) from an adjustment anew, its covariance through `reconstruct`."""
    whole = found.adjustment.problem
    own = {key for key in whole.sigmas if key.partition(".")[0] in names}
    less = replace(
        whole,
        samples=[sample for sample in whole.samples if sample.name not in names],
        sigmas={key: value for key, value in whole.sigmas.items() if key not in own},
    )
    again = adjust(less, whole.named(found.adjustment.values))
    known = found.scene.covariance
    assert known is not None
    by = found.by[:, [whole.names.index(name) for name in less.names]]
    scene, covariance = less.scene_at(again.values), Covariance(known.names, by @ again.covariance @ by.T)
    _, height, rest = predicted_maps(replace(scene, covariance=covariance))
    change = height - rest
    both = change.good
    deepest = np.argmax(change.z[both])
    return float(np.median(height.calibration_sigma[both])), float(change.calibration_sigma[both][deepest])


@pytest.mark.slow
def test_a_capture_is_worth_what_an_adjustment_without_it_loses(found: Calibration) -> None:
    first, second, third, last = judged(found)
    assert [each.name for each in (first, second, third, last)] == ["flat0", "flat1", "flat2", "flat3"]
    assert first.depth_without is None
    by_three = sigmas_without(found, {"flat3"})
    for each, expected in ((second, sigmas_without(found, {"flat1"})), (last, by_three)):
        assert (each.height_without, each.depth_without) == pytest.approx(expected, rel=0.1)
    assert (third.height_so_far, third.depth_so_far) == pytest.approx(by_three, rel=0.1)
    assert (last.height_so_far, last.depth_so_far) == pytest.approx(sigmas_without(found, set()), rel=0.02)
    assert first.depth_so_far > second.depth_so_far > third.depth_so_far > last.depth_so_far
