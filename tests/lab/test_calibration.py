"""chi2 of mode coefficients: against draws of maps made of the modes, and of rigs with several minima."""

import numpy as np
import pytest

from lab.calibration.figures import figures, mode_chi2


@pytest.mark.parametrize(("factor", "expected"), [(1.0, 1.0), (3.0, 9.0)])
def test_mode_chi2_of_drawn_maps(factor: float, expected: float) -> None:
    rng = np.random.default_rng(0)
    modes = (rng.standard_normal((5, 400)) * np.array([5.0, 2.0, 1.0, 1.0, 1e-3])[:, None]).astype(np.float32)
    found = []
    for _ in range(300):
        error = factor * (rng.standard_normal(5) @ modes + 0.1 * rng.standard_normal(400))
        chi2, count = mode_chi2(error, modes)
        found.append(chi2)
        assert count == 4
    assert np.mean(found) == pytest.approx(expected, rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "linear"),
    [
        pytest.param(1087, 26.4, id="a minimum that few starts find"),
        pytest.param(1066, 18.8, id="two minima of nearly one sum of squares"),
    ],
)
def test_covariance_of_a_rig_with_several_minima(seed: int, linear: float) -> None:
    """By the linear covariance of the least minimum from eight starts chi2 was `linear`."""
    (figure,) = figures("prism, rest", range(seed, seed + 1))
    assert figure.chi2 < 2.5 < linear


def test_a_dent_measured_by_priors_alone() -> None:
    """Of a rig 0.1 degree off, whose modes are 1.4 of the dent's depth: what is pressed less what was there
    before. Neighbours that err together by such a rig are no outliers."""
    (figure,) = figures("prism, priors alone", range(2, 3))
    assert figure.error < 3.5e-3
    assert abs(figure.scale) < figure.sigma_scale
