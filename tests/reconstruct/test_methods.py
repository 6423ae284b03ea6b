"""reconstruct(method=...): every dense method by name, against the truth and against each other."""

import numpy as np
import pytest

from optolever import InputError
from optolever.experiments.metrics import relative_error
from optolever.reconstruct import PixelAnchor, reconstruct

from .conftest import rms_score

DENSE = ("coupled", "direct", "robust", "march", "fixed-point")
SIDE = 64


@pytest.mark.daily(4)
@pytest.mark.parametrize("preset", ["paper-simulation", "monitor-mirror"])
@pytest.mark.parametrize("method", DENSE)
def test_smooth_dent_without_noise(method: str, preset: str, exact) -> None:
    """A whole rectangle: the prism, and the middle of the monitor's mirror."""
    scene, truth, seen = exact(preset, "gaussian", SIDE, SIDE)
    mask = np.zeros((SIDE, SIDE), dtype=bool)
    mask[16:48, 16:48] = True
    anchor = PixelAnchor(32.0, 32.0, float(truth.z[32, 32]))
    height = reconstruct(seen, scene, method=method, anchor=anchor, mask=mask)
    assert height.good.sum() == 32 * 32
    assert height.diagnostics.converged
    assert relative_error(height, truth) < 5e-5  # quadrature on 64 pixels


@pytest.mark.parametrize("method", DENSE)
def test_edge_anchor(method: str, exact) -> None:
    scene, truth, seen = exact("paper-simulation", "raised-cosine", SIDE, SIDE)
    assert relative_error(reconstruct(seen, scene, method=method), truth) < 1e-5


def test_direct_agrees_with_coupled_under_noise(exact, noisy) -> None:
    scene, truth, _ = exact("monitor-mirror", "gaussian", SIDE, SIDE)
    seen = noisy(truth, 0.1, 0.1)
    anchor = PixelAnchor(32.0, 32.0, float(truth.z[32, 32]))
    one, other = (reconstruct(seen, scene, method=name, anchor=anchor) for name in ("coupled", "direct"))
    both = one.good & other.good
    assert np.abs(one.z - other.z)[both].max() < 0.1 * np.median(one.sigma[both])


def test_marching_pays_with_noise_and_says_so(exact, noisy) -> None:
    """Sums along lines keep the noise that least squares averages; sigma tells it."""
    scene, truth, _ = exact("paper-simulation", "raised-cosine", SIDE, SIDE)
    ratios, scores = [], []
    for seed in range(8):
        seen = noisy(truth, 0.05, 0.05, seed)
        plain, march = (reconstruct(seen, scene, method=name) for name in ("coupled", "march"))
        away = truth.x > 16
        good = plain.good & march.good & away
        errors = [(h.z - truth.z)[good] for h in (plain, march)]
        ratios.append(np.linalg.norm(errors[1]) / np.linalg.norm(errors[0]))
        scores.append(np.mean((errors[1] / march.sigma[good]) ** 2))
    assert np.mean(ratios) > 2
    assert np.sqrt(np.mean(scores)) == pytest.approx(1.0, abs=0.35)


def test_marching_over_a_cusp_is_told_by_sigma(exact) -> None:
    """No row goes around the tip: what may be lost there stays in sigma all along the row."""
    scene, truth, seen = exact("paper-simulation", "needle", 96, 96)
    height = reconstruct(seen, scene, method="march")
    good = height.good & truth.visible
    assert np.all(np.abs(height.z - truth.z)[good] < 5 * height.sigma[good])


def test_march_needs_a_rectangle(exact, cut) -> None:
    scene, _, seen = exact("paper-simulation", "gaussian", SIDE, SIDE)
    keep = np.ones((SIDE, SIDE), dtype=bool)
    keep[20:40, 20:40] = False
    with pytest.raises(InputError, match="march': needs a full rectangle"):
        reconstruct(cut(seen, keep), scene, method="march")


@pytest.fixture(scope="module")
def spoiled(exact, noisy):
    """2 % of the pixels off by up to 20 pattern pixels, in patches of 2 x 2 so that none stands alone."""
    scene, truth, _ = exact("paper-simulation", "raised-cosine", SIDE, SIDE)
    rng = np.random.default_rng(7)
    seen = noisy(truth, 0.05, 0.05)
    half = (SIDE // 2, SIDE // 2)
    wrong = np.kron(rng.random(half) < 0.02, np.ones((2, 2))).astype(bool) & (truth.x < 150)
    for axis in (seen.u, seen.v):
        axis[wrong] += np.kron(rng.uniform(-20, 20, half), np.ones((2, 2)))[wrong]
    return scene, truth, seen, ~wrong & (truth.x > 16)


def test_robust_is_near_what_no_outliers_give(spoiled, noisy) -> None:
    scene, truth, seen, away = spoiled
    calm = reconstruct(noisy(truth, 0.05, 0.05), scene)
    robust = reconstruct(seen, scene, method="robust")
    errors = [(height.z - truth.z)[away] for height in (robust, calm)]
    # 2.9 or 3.2, by the order in which pixels are bridged
    assert rms_score(errors[0]) < 4 * rms_score(errors[1])
