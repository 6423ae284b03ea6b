"""Where the pattern meets the mirror there is no normal: its pixels are flagged first, the rest is solved."""

from dataclasses import replace

import numpy as np
import pytest

from lab.figures.figures import brute_force
from optolever.decode import Flag
from optolever.reconstruct import HeightFlag, PixelAnchor, reconstruct
from optolever.scene import dent, trace

from .touching import amid, dents_of, touching_rig, way_of


@pytest.mark.daily(1)
@pytest.mark.parametrize("number", [1, 6, 11])
def test_the_tracer_agrees_with_the_brute_force(number: int) -> None:
    scene = touching_rig(number)
    surface = dents_of(scene)[2]
    traced, (row, col) = trace(scene, surface), np.indices((48, 56)).astype(np.float64)
    u, v = (part.reshape(row.shape) for part in brute_force(scene, surface, row.ravel(), col.ravel()))
    o, d = scene.camera.rays()
    foot = o - o[..., 2:] / d[..., 2:] * d
    seen = (np.abs(u - 199.5) < 200) & (np.abs(v - 199.5) < 200) & (foot[..., 0] > 0)
    seen &= (foot[..., 0] < scene.mirror.length) & (foot[..., 1] > 0) & (foot[..., 1] < scene.mirror.width)
    assert (seen & traced.visible).sum() > 0.95 * seen.sum()
    for place, brute in ((traced.u, u), (traced.v, v)):
        np.testing.assert_allclose(place[traced.visible], brute[traced.visible], atol=1e-6)


@pytest.mark.daily(2)
@pytest.mark.parametrize("number", [1, 3, 5, 6, 11, 12, 15])
def test_a_pattern_that_touches_the_mirror_costs_its_pixels_alone(noisy, number: int) -> None:
    """LinAlgError, RuntimeError, infs or NaNs, or every pixel NOT_CONVERGED until they were flagged first."""
    scene = touching_rig(number)
    silent = solved = 0
    for k, surface in enumerate(dents_of(scene)):
        truth = trace(scene, surface)
        row, col = amid(scene, truth)
        anchor = PixelAnchor(row, col, float(truth.z[row, col]))
        for noise in (0.02, 0.0):
            height = reconstruct(noisy(truth, noise=noise, seed=k), scene, anchor=anchor)
            good = height.good
            assert good.sum() > 0.95 * truth.visible.sum()
            error = np.abs(height.z - truth.z)[good]
            silent += np.count_nonzero(error > 5 * height.sigma[good] + 1e-9 * scene.mirror.length)
            solved += error.size
    assert silent < 3e-4 * solved  # neighbours share an error: one run alone is one event


def test_a_pixel_on_the_pattern_is_flagged(noisy) -> None:
    scene = touching_rig(5)
    truth = trace(scene, dent("flat", scene))
    row, col = amid(scene, truth)
    height = reconstruct(noisy(truth), scene, anchor=PixelAnchor(row, col, 0.0))
    touching = truth.visible & (way_of(scene, truth) < 0.02 * scene.pattern.pitch)  # its noise
    assert touching.any()
    assert np.all(height.flags[touching] == HeightFlag.SINGULAR)
    assert np.isnan(height.z[touching]).all()


@pytest.mark.daily(2)
@pytest.mark.parametrize("preset", ["paper-simulation", "prism48", "monitor-mirror"])
@pytest.mark.parametrize("off", [1e-3, 0.1])
def test_exact_data_with_an_anchor_that_is_off(exact, noisy, preset: str, off: float) -> None:
    """The free mode takes no slope: steps along it were held for steps too far, no pixel converged."""
    scene, truth, _ = exact(preset, "flat", 96, 112)
    height = reconstruct(noisy(truth), scene, anchor=PixelAnchor(48, 56, off))
    assert height.diagnostics.converged
    assert height.good.mean() > 0.99
    assert height.z[48, 56] == pytest.approx(off, rel=1e-3)


def test_flagged_places_tell_nothing(exact, noisy) -> None:
    """Beside the pattern's end, too, where a noisy place is compared with those around."""
    scene, truth, _ = exact("paper-simulation", "gaussian", 96, 96)
    row, col = np.indices(truth.u.shape) // 6 % 2
    lost = (row == 0) & (col == 0)
    seen = noisy(truth, 0.3, 0.3)
    flags = np.where(lost, int(Flag.INVALID), seen.flags).astype(np.uint16)
    anything = np.random.default_rng(5).uniform(-5000, 5000, truth.u.shape)
    one, other = (
        reconstruct(replace(seen, u=np.where(lost, filled, seen.u), flags=flags), scene)
        for filled in (anything, np.nan)
    )
    np.testing.assert_array_equal(one.flags, other.flags)
    np.testing.assert_array_equal(one.z, other.z)
    np.testing.assert_array_equal(one.sigma, other.sigma)
