"""Cameras: rays against OpenCV's projection, Snell's law against Fermat's principle, poses, resizing."""

import math

import cv2
import numpy as np
import pytest

from optolever.scene import Face, PinholeCamera, TelecentricCamera, load, resize

LENSES = [(0, 0, 0, 0, 0), (-0.3, 0.1, 0, 0, 0), (0.2, -0.1, 0.003, -0.004, 0.05)]


def axes(rotation_vector):
    rotation = cv2.Rodrigues(np.asarray(rotation_vector, float))[0]
    return rotation[:, 0], rotation[:, 1], rotation


def pinhole(distortion=LENSES[2], **changes):
    u, v, _ = axes([2.0, 0.5, -1.0])
    values = {
        "origin": np.array([10.0, -20.0, 300.0]),
        "u_axis": u,
        "v_axis": v,
        "focal": np.array([800.0, 780.0]),
        "centre": np.array([321.5, 236.25]),
        "rows": 480,
        "cols": 640,
        "distortion": np.array(distortion, float),
    }
    return PinholeCamera(**(values | changes))


@pytest.mark.parametrize("lens", LENSES)
def test_pinhole_rays_project_back_by_opencv(lens):
    camera = pinhole(lens)
    rng = np.random.default_rng(7)
    row, col = rng.uniform(-0.5, 479.5, 500), rng.uniform(-0.5, 639.5, 500)
    origins, directions = camera.rays_at(row, col)
    points = origins + rng.uniform(50, 900, 500)[:, None] * directions
    *_, rotation = axes([2.0, 0.5, -1.0])  # camera to mirror; OpenCV wants mirror to camera
    matrix = np.array([[800.0, 0, 321.5], [0, 780.0, 236.25], [0, 0, 1]])
    seen, _ = cv2.projectPoints(
        points, cv2.Rodrigues(rotation.T)[0], -rotation.T @ camera.origin, matrix, np.array(lens, float)
    )
    assert np.abs(seen[:, 0] - np.stack([col, row], axis=1)).max() < 1e-9
    assert np.abs(np.linalg.norm(directions, axis=1) - 1).max() < 1e-15


@pytest.mark.parametrize(("outside", "index"), [(1.0, 1.41), (1.5, 1.0)])
@pytest.mark.parametrize("flipped", [1, -1])
def test_refracted_rays_obey_fermat(outside, index, flipped):
    """The optical path from the pinhole to a point of the refracted ray is stationary at the face."""
    ahead = np.cross(pinhole().u_axis, pinhole().v_axis)
    tilted = ahead + 0.2 * pinhole().u_axis - 0.1 * pinhole().v_axis
    face = Face(pinhole().origin + 100 * ahead, flipped * tilted, index, outside)
    camera = pinhole(face=face)
    origins, directions = camera.rays_at(np.array([10.0, 240.0, 470.0]), np.array([5.0, 320.0, 600.0]))
    assert np.abs((origins - face.point) @ face.normal).max() < 1e-11
    assert np.abs(np.linalg.norm(directions, axis=1) - 1).max() < 1e-14
    target = origins + 70 * directions
    assert ((origins - camera.origin) @ face.normal * (directions @ face.normal) > 0).all()

    def path(shift):
        foot = origins + shift
        before = np.linalg.norm(foot - camera.origin, axis=1)
        return outside * before + index * np.linalg.norm(target - foot, axis=1)

    across = np.cross(face.normal, [1.0, 0, 0])
    for along in (across, np.cross(face.normal, across)):
        assert np.abs(path(1e-3 * along) - path(-1e-3 * along)).max() / 2e-3 < 1e-9


def test_face_turns_total_reflection_and_misses_into_nan():
    level = TelecentricCamera(
        (0, 0, 10), (math.cos(1.0), 0, math.sin(1.0)), (0, -1, 0), (1.0, 1.0), 2, 2
    )  # 57 degrees off the vertical
    inside_out = Face((0, 0, 5), (0, 0, 1), index=1.0, outside=1.5)
    behind = Face((0, 0, 50), (0, 0, 1), index=1.5)
    for face in (inside_out, behind):
        camera = TelecentricCamera(level.origin, level.u_axis, level.v_axis, level.pitch, 2, 2, face)
        origins, directions = camera.rays()
        assert np.isnan(directions).all()
        assert origins.shape == (2, 2, 3)


@pytest.mark.parametrize("name", ["paper-simulation", "prism48", "monitor-mirror"])
@pytest.mark.parametrize("size", [(192, 192), (300, 200)])
def test_resize_keeps_the_field_of_view(name, size):
    scene = load(name)
    small = resize(scene, *size)
    assert (small.camera.rows, small.camera.cols) == size
    for fr, fc in ((0, 0), (1, 0), (0.3, 0.8), (1, 1)):
        wide = scene.camera.rays_at(fr * scene.camera.rows - 0.5, fc * scene.camera.cols - 0.5)
        narrow = small.camera.rays_at(fr * size[0] - 0.5, fc * size[1] - 0.5)
        for one, other in zip(wide, narrow, strict=True):
            assert np.allclose(one, other, atol=1e-10, rtol=0)
    corner = scene.pattern.point(-0.5, -0.5)
    assert np.allclose(small.pattern.point(-0.5, -0.5), corner, atol=1e-10, rtol=0)
    for side in ("rows", "cols"):
        before = getattr(scene.pattern, side) * scene.pattern.pitch
        after = getattr(small.pattern, side) * small.pattern.pitch
        assert before - 1e-4 <= after < before + small.pattern.pitch
