"""Whether noise explains how the slopes contradict each other: chi2 on right and on wrong geometry."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optolever.notices import Notice
from optolever.reconstruct import HeightMap, PixelAnchor, PointAnchor, reconstruct
from optolever.samples.metrics import relative_error
from optolever.scene import Scene, adjusted, dent, trace

SIZE = (120, 136)


def turned(scene: Scene, axis: int) -> Scene:
    """The camera turned about an axis of the mirror's frame."""
    return adjusted(scene, {f"camera.r{'xyz'[axis]}": np.radians(0.2)})


def known(truth) -> PixelAnchor:
    row, col = SIZE[0] // 2, SIZE[1] // 2
    return PixelAnchor(row, col, float(truth.z[row, col]))


@pytest.mark.daily(3)
@pytest.mark.parametrize("preset", ["paper-simulation", "prism48", "monitor-mirror"])
@pytest.mark.parametrize("dent", ["flat", "gaussian", "raised-cosine", "ridge:angle_deg=30"])
@pytest.mark.parametrize("noise", [1e-3, 0.05])
def test_chi2_is_one_where_the_scene_is_right(exact, noisy, preset: str, dent: str, noise: float) -> None:
    """Whatever the noise: curvature is no contradiction."""
    scene, truth, _ = exact(preset, dent, *SIZE)
    height = reconstruct(noisy(truth, noise, noise, seed=7), scene, anchor=known(truth))
    found = height.diagnostics
    assert found.freedom > 100
    assert abs(found.chi2 - 1) < 4 * np.sqrt(2 / found.freedom)
    assert height.notices == ()


@pytest.mark.daily(3)
@pytest.mark.parametrize(
    ("preset", "wrong"),
    [
        (preset, wrong)
        for preset in ("paper-simulation", "prism48", "monitor-mirror")
        for wrong in ("camera 2", "pitch")
    ]
    + [("monitor-mirror", "camera 0")],
)
def test_wrong_scenes_are_noticed(exact, noisy, preset: str, wrong: str) -> None:
    """Not so a camera that leans within or across the plane of a prism's section: there another mirror, in
    which no slope contradicts another, shows the same.
    """
    scene, truth, _ = exact(preset, "gaussian", *SIZE)
    finer = replace(scene.pattern, pitch=0.998 * scene.pattern.pitch)
    other = replace(scene, pattern=finer) if wrong == "pitch" else turned(scene, int(wrong[-1]))
    height = reconstruct(noisy(truth, 0.02, 0.02), other, anchor=known(truth))
    *before, notice = height.notices
    assert all("did not converge" in text.name for text in before)
    assert notice.size == height.diagnostics.chi2 > notice.limit
    assert "--rest" in notice.cure
    assert len(str(notice).splitlines()) == 1


def test_a_camera_that_sees_beyond_the_mirror_is_noticed(exact, noisy) -> None:
    """Moved along it, no slope contradicts another."""
    scene, truth, _ = exact("prism48", "flat", *SIZE)
    height = reconstruct(noisy(truth, 0.02, 0.02), adjusted(scene, {"camera.x": 3.0}))
    (notice,) = height.notices
    assert notice.size == pytest.approx(height.x[height.good].max() - scene.mirror.length)
    assert notice.size > 2.0


def test_notices_are_carried_and_saved(exact, tmp_path: Path) -> None:
    scene, truth, c = exact("paper-simulation", "gaussian", *SIZE)
    told = Notice("frames contradict each other", 2.0, 1.0, "take them again")
    height = reconstruct(replace(c, notices=(told,)), turned(scene, 2), anchor=known(truth))
    assert height.notices[0] == told
    assert len(height.notices) == 2
    height.save(tmp_path / "h.npz")
    assert HeightMap.load(tmp_path / "h.npz").notices == height.notices


@pytest.mark.daily(2)
@pytest.mark.parametrize("preset", ["paper-simulation", "monitor-mirror"])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_capture_at_rest_takes_off_a_camera_that_looks_elsewhere(
    exact, noisy, preset: str, axis: int
) -> None:
    """By the default anchor; in open air too, where a wrong scene has the mirror's edges elsewhere."""
    scene, truth, _ = exact(preset, "gaussian", *SIZE)
    _, flat, _ = exact(preset, "flat", *SIZE)
    seen, rest = (noisy(each, 0.02, 0.02, seed) for seed, each in enumerate((truth, flat)))
    other = turned(scene, axis)
    raw = reconstruct(seen, other, anchor=known(truth))
    mended = reconstruct(seen, other, rest=rest)
    assert relative_error(mended, truth) < 0.02
    assert not raw.good.any() or relative_error(mended, truth) < 0.1 * relative_error(raw, truth)
    assert (mended.good & truth.visible).sum() > 0.95 * truth.visible.sum()


APART = "The anchors contradict each other; rms in sigma"


@pytest.mark.daily(1)
@pytest.mark.parametrize("preset", ["prism48", "paper-simulation", "monitor-mirror"])
def test_an_edge_that_cannot_rest_tells_that_the_rig_is_wrong(preset: str, exact, noisy) -> None:
    """A camera that is turned by 0.2 degrees tilts the mirror along its edge, which no other notice names."""
    scene, truth, _ = exact(preset, "gaussian", 60, 80)
    turned = trace(adjusted(scene, {"camera.rx": np.radians(0.2)}), dent("gaussian", scene))
    for seed in range(3):
        right, wrong = (reconstruct(noisy(seen, 0.02, 0.02, seed), scene).notices for seen in (truth, turned))
        assert APART not in [notice.name for notice in right]
        assert APART in [notice.name for notice in wrong]


@pytest.mark.parametrize(("sigma", "named"), [(1e-3, True), (0.1, False)])
def test_known_points_that_contradict_each_other(sigma: float, named: bool, exact, noisy) -> None:
    scene, truth, _ = exact("prism48", "flat", 60, 80)
    points = [PointAnchor(50.0, 20.0, 0.0, sigma), PointAnchor(45.0, 25.0, 0.1, sigma)]
    height = reconstruct(noisy(truth, 0.02, 0.02, 0), scene, anchor=points)
    assert (APART in [notice.name for notice in height.notices]) == named
