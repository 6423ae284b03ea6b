"""Where the pattern meets the mirror there is no normal: its pixels are flagged first, the rest is solved."""

import numpy as np
import pytest

from optolever.reconstruct import HeightFlag, PixelAnchor, reconstruct
from optolever.scene import dent, load, resize, trace

from .brute_force import dents_of, see, touching_rig


@pytest.mark.parametrize("number", [1, 6, 11])
def test_the_tracer_agrees_with_the_brute_force(number: int) -> None:
    scene = touching_rig(number)
    surface = dents_of(scene)[2]
    seen, traced = see(scene, surface), trace(scene, surface)
    both = seen.visible & traced.visible
    assert both.sum() > 0.95 * seen.visible.sum()
    np.testing.assert_allclose(seen.u[both], traced.u[both], atol=1e-6)
    np.testing.assert_allclose(seen.point[2][both], traced.z[both], atol=1e-9 * scene.mirror.length)


@pytest.mark.parametrize(
    ("number", "method"),
    [
        *[(1, "coupled"), (5, "coupled"), (6, "direct"), (12, "fixed-point")],
        *(pytest.param(n, "coupled", marks=pytest.mark.slow) for n in (3, 6, 11)),
        *(pytest.param(n, "direct", marks=pytest.mark.slow) for n in (1, 3, 5, 11)),
        *(pytest.param(n, m, marks=pytest.mark.slow) for n, m in ((1, "robust"), (15, "fixed-point"))),
    ],
)
def test_a_pattern_that_touches_the_mirror_costs_its_pixels_alone(number: int, method: str) -> None:
    """LinAlgError, RuntimeError, infs or NaNs, or every pixel NOT_CONVERGED until they were flagged first."""
    scene = touching_rig(number)
    silent = solved = 0
    for k, surface in enumerate(dents_of(scene)):
        seen = see(scene, surface)
        row, col = seen.amid()
        anchor = PixelAnchor(row, col, float(seen.point[2, row, col]))
        for noise in (0.02, 0.0):
            height = reconstruct(seen.correspondence(noise=noise, seed=k), scene, method, anchor)
            good = height.good
            assert good.sum() > 0.95 * seen.visible.sum()
            error = np.abs(height.z - seen.point[2])[good]
            silent += np.count_nonzero(error > 5 * height.sigma[good] + 1e-9 * scene.mirror.length)
            solved += error.size
    assert silent < 3e-4 * solved  # neighbours share an error: one run alone is one event


def test_a_pixel_on_the_pattern_is_flagged() -> None:
    scene = touching_rig(5)
    seen = see(scene, dent("flat", scene))
    row, col = seen.amid()
    height = reconstruct(seen.correspondence(), scene, anchor=PixelAnchor(row, col, 0.0))
    touching = seen.visible & (seen.way < 0.02 * scene.pattern.pitch)  # its noise
    assert touching.any()
    assert np.all(height.flags[touching] == HeightFlag.SINGULAR)
    assert np.isnan(height.z[touching]).all()


@pytest.mark.parametrize("preset", ["paper-simulation", "prism48", "monitor-mirror"])
@pytest.mark.parametrize("off", [1e-3, 0.1])
def test_exact_data_with_an_anchor_that_is_off(noisy, preset: str, off: float) -> None:
    """The free mode takes no slope: steps along it were held for steps too far, no pixel converged."""
    scene = resize(load(preset), 96, 112)
    truth = trace(scene, dent("flat", scene))
    height = reconstruct(noisy(truth), scene, anchor=PixelAnchor(48, 56, off))
    assert height.diagnostics.converged
    assert height.good.mean() > 0.99
    assert height.z[48, 56] == pytest.approx(off, rel=1e-3)
