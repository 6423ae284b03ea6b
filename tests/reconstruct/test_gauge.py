"""The way from pixels to an anchor beside them: what curves add to it, and when there is none."""

from types import SimpleNamespace

import numpy as np
import pytest

from optolever import InputError
from optolever.reconstruct import PointAnchor, reconstruct
from optolever.reconstruct.problem import prepare
from optolever.reconstruct.solver.anchors import anchor_rows, free_constants
from optolever.scene import adjusted, dent, trace

APART = "anchors contradict each other, sigma rms"


def test_the_bend_of_a_curve_is_more_than_the_cubic_misses_and_nothing_for_a_parabola(exact) -> None:
    scene, _, correspondence = exact("paper-simulation", "flat", 40, 48)
    problem = prepare(correspondence, scene)
    rows = anchor_rows(problem.samples, problem.data, problem.labels)
    at = np.arange(problem.data.mask.shape[1]) + np.zeros(problem.data.mask.shape)
    pixel = rows.pixel % at.shape[1]
    delta = problem.samples.col - pixel
    assert 0.05 < np.abs(delta).max() <= 1.0
    assert np.abs(rows.bend(0.3 + 0.2 * at - 0.1 * at**2)).max() < 1e-9
    for width in (4.0, 10.0):
        slope, integral = np.cosh((at - 3) / width) ** -2, width * np.tanh((at - 3) / width)
        way = rows.predict(np.zeros(at.shape), slope, np.zeros(at.shape))
        exactly = width * np.tanh((problem.samples.col - 3) / width) - integral.ravel()[rows.pixel]
        missed, told = np.abs(way - exactly), np.abs(rows.bend(slope))
        assert missed.max() > 1e-7
        assert np.all(missed <= told)
        assert np.all(told < 0.05 * np.abs(exactly))


def test_without_slopes_that_tell_the_way_there_is_no_anchor(exact) -> None:
    """Three pixels in a row are too few, four will do."""
    scene, _, correspondence = exact("paper-simulation", "flat", 40, 48)
    for columns, count in ((3, 0), (4, 40)):
        mask = np.zeros(correspondence.u.shape, dtype=bool)
        problem = prepare(correspondence, scene)
        first = int((problem.samples.col[0] > 10) * (48 - columns))
        mask[:, first : first + columns] = True
        problem.data.mask[...] = mask
        rows = anchor_rows(problem.samples, problem.data, mask.astype(np.int32))
        assert len(rows.pixel) == count


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


TWO = SimpleNamespace(component=np.array([1, 1]))


def test_a_tiny_integrating_factor_divides_by_nothing() -> None:
    factor = np.array([1e-200, 2e-200])
    constants, share = free_constants(TWO, 3.0 * factor, factor, np.ones(2), 1)  # type: ignore[arg-type]
    assert constants == pytest.approx([0.0, -3.0])
    assert share == pytest.approx([0.2, 0.8])


@pytest.mark.parametrize("factor", [0.0, np.nan])
def test_a_factor_of_nothing_is_refused_in_a_line(factor: float) -> None:
    with pytest.raises(InputError, match="anchor: its error would grow"):
        free_constants(TWO, np.ones(2), np.full(2, factor), np.ones(2), 1)  # type: ignore[arg-type]
