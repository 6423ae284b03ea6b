"""The calibration's page: where the camera is drawn, and what is red."""

import re
from dataclasses import replace

import numpy as np
import pytest

from optolever.experiments import RigStudy, write_rig_report
from optolever.experiments.rig_drawing import camera_view
from optolever.notices import Notice
from optolever.scene import Covariance, Face, PinholeCamera, Scene, load, resize


def behind_face() -> Scene:
    """The prism seen by a pinhole camera through its other face."""
    rig = load("prism48")
    normal = np.array([np.sin(np.radians(48)), 0.0, np.cos(np.radians(48))])
    seen = load("monitor-mirror").camera
    assert isinstance(seen, PinholeCamera)
    axis = -np.array([np.sin(0.9), 0.0, np.cos(0.9)])
    across = np.cross([0.0, 1.0, 0.0], axis)
    camera = replace(
        seen,
        origin=np.array([30.0, 22.5, 0.0]) - 190 * axis,
        u_axis=across,
        v_axis=np.array([0.0, 1.0, 0.0]),
        focal=np.array([2100.0, 2100.0]),
        face=Face(np.array([60.0, 0.0, 0.0]), normal, 1.41),
    )
    return replace(rig, camera=camera)


def test_a_pinhole_is_drawn_where_it_is_and_its_ray_bends_at_the_face() -> None:
    rig = behind_face()
    (place, bend, foot), face = camera_view(rig)
    camera = rig.camera
    assert isinstance(camera, PinholeCamera)
    assert camera.face is not None
    assert np.array_equal(place, camera.origin)
    assert foot[2] == pytest.approx(0.0, abs=1e-9)
    assert np.abs((np.vstack([bend, face]) - camera.face.point) @ camera.face.normal).max() < 1e-9
    sines = [
        float(np.linalg.norm(np.cross(way, camera.face.normal))) / float(np.linalg.norm(way))
        for way in (bend - place, foot - bend)
    ]
    assert sines[0] == pytest.approx(1.41 * sines[1])


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Two captures, one with a chi of 1.5; four numbers: sharp, known from the prior, 4.9 and 5.1 off."""
    rig = resize(load("prism48"), 60, 80)
    names = ("camera.ry", "pattern.z")
    scene = replace(rig, covariance=Covariance(names, np.diag([1e-4, 1e-2]) ** 2))
    numbers = [
        {"name": name, "value": value, "sigma": sigma, "prior": 1.0, "prior_sigma": 0.1}
        for name, value, sigma in (("a", 1.1, 0.01), ("b", 1.1, 0.09), ("c", 1.49, 0.01), ("d", 0.49, 0.09))
    ]
    sign = np.where(np.arange(50) % 2, 1.0, -1.0)
    row, col = np.arange(50.0), np.arange(50.0)
    residuals = {name: (row, col, chi * sign, chi * sign) for name, chi in (("rest", 1.0), ("ball", 1.5))}
    judged = {"rest": {"chi": 1.0}, "ball": {"chi": 1.5}}
    notices = [Notice("wrong", 2.0, 1.0, "mend it"), Notice("remark", np.nan, np.nan, "")]
    path = tmp_path_factory.mktemp("rig") / "rig.html"
    write_rig_report(RigStudy(rig, scene, 1.5, numbers, residuals, judged, notices, {"adjust": 1.0}), path)
    return path.read_text()


def test_what_is_beyond_its_limit_is_red(page: str) -> None:
    rows = {name: kind for kind, name in re.findall(r'<tr(?: class="(\w+)")?><td>(\w+)</td>', page)}
    assert {name: rows[name] for name in "abcd"} == {"a": "", "b": "soft", "c": "", "d": "beyond"}
    assert rows["rest"] == ""
    assert rows["ball"] == "beyond"
    assert '<div class="value beyond">1.500</div>' in page
    assert '<span class="beyond">ball: chi 1.500</span>' in page
    assert "<span>rest: chi 1.000</span>" in page
    assert re.search(r'<li class="beyond">wrong', page)
    assert re.search(r"<li>remark", page)
    assert re.search(r"\.beyond[^{}]*\{ color: var\(--bad\)", page)
