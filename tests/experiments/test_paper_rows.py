"""The paper's method on whole scenes, from exact traced correspondences."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from optolever import InputError
from optolever.experiments.paper.rows import prism_geometry, reconstruct_paper
from optolever.notices import Notice
from optolever.reconstruct import exact_correspondence
from optolever.scene import Scene, Trace, dent, load, resize, trace

SCENE = resize(load("paper-simulation", exact=True), 40, 320)
PEAK = 1.3


@pytest.fixture(scope="module")
def seen() -> Trace:
    return trace(SCENE, dent("raised-cosine", SCENE, peak=PEAK))


def test_geometry_is_read_off_the_scene() -> None:
    geometry = prism_geometry(SCENE)
    assert_allclose([geometry.alpha0, geometry.beta0, geometry.length], [np.pi / 4, np.pi / 4, 163.7])
    assert_allclose(np.rad2deg(prism_geometry(load("prism48", exact=True)).beta0), 48)


def test_drops_recover_the_dent_with_its_places(seen: Trace) -> None:
    height = reconstruct_paper(exact_correspondence(seen, 0.02), SCENE, series="drops")
    assert np.array_equal(height.good, seen.visible)
    error = (height.z - seen.z)[seen.visible]
    assert np.sqrt(np.mean(error**2)) / PEAK < 0.006
    assert_allclose(height.y[seen.visible], seen.y[seen.visible], atol=1e-9)
    assert_allclose((height.x - seen.x)[seen.visible], error, atol=1e-9)  # along a ray of 45 degrees
    assert np.isinf(height.sigma).all()


def test_unequal_angles() -> None:
    scene = resize(load("prism48", exact=True), 20, 400)
    seen = trace(scene, dent("gaussian", scene))
    height = reconstruct_paper(exact_correspondence(seen, 0.02), scene, series="drops")
    peak = np.nanmax(seen.z)
    assert np.sqrt(np.nanmean((height.z - seen.z) ** 2)) / peak < 0.02


def test_printed_sign_turns_the_dent_round(seen: Trace) -> None:
    height = reconstruct_paper(exact_correspondence(seen, 0.02), SCENE, sign=-1, series="drops")
    middle = (SCENE.camera.rows // 2, SCENE.camera.cols // 4)
    assert height.z[middle] < 0 < seen.z[middle]


def test_a_rest_capture_is_taken_off_and_notices_stay(seen: Trace) -> None:
    """An error of a tenth of a pixel that both captures share."""
    notice = Notice("frames contradict each other", 2.0, 1.0, "take them again")
    flat = exact_correspondence(trace(SCENE, dent("flat", SCENE)), 0.02)
    measured = exact_correspondence(seen, 0.02)
    off = replace(measured, u=measured.u + 0.1, notices=(notice,))
    known = reconstruct_paper(measured, SCENE)
    height = reconstruct_paper(off, SCENE, rest=replace(flat, u=flat.u + 0.1))
    assert height.notices == (notice,)
    both = known.good & height.good
    assert_allclose(height.z[both], known.z[both], atol=1e-9)


def test_flagged_pixels_have_no_height(seen: Trace) -> None:
    measured = exact_correspondence(seen, 0.02)
    measured.flags[5, 100:110] = 4
    height = reconstruct_paper(measured, SCENE)
    assert np.isnan(height.z[5, 100:110]).all()
    assert (height.flags[5, 100:110] == 4).all()
    assert np.isfinite(height.z[4]).all()


def moved_off_the_edge(scene: Scene) -> Scene:
    pattern = scene.pattern
    return replace(scene, pattern=replace(pattern, origin=pattern.origin + np.array([-5.0, 0.0, 0.0])))


@pytest.mark.parametrize(
    "scene", [load("monitor-mirror", exact=True), moved_off_the_edge(SCENE)], ids=["pinhole", "gap"]
)
def test_only_prisms(scene: Scene) -> None:
    with pytest.raises(InputError, match=scene.name):
        prism_geometry(scene)
