"""Closed-form start values from flat mirrors in open air.

The mirror image of the display behind each flat is a plane of known pitch. `cv2.calibrateCamera` yields the
lens and the poses of these images, V_i = S_i V, S_i = I - 2 n_i n_i^T. V_i V_j^T = S_i S_j is a rotation
about n_i x n_j: n_i is perpendicular to the rotation axes of all its pairs. V follows, and from
o_i = S_i o + 2 d_i n_i linearly the display's origin o and the distances d_i (Sturm, Bonfort, inria-00387128;
Takahashi et al., IPSJ TCVA 8:11).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from scipy.linalg import block_diag

from optolever.arrays import Floats
from optolever.scene import PinholeCamera, Scene

from .observation import Sample

__all__ = ["open_air_start"]


_LEAST_TURN = 1e-3  # rad of rotation between two images: below, the axis is noise


def open_air_start(scene: Scene, views: Sequence[Sample]) -> tuple[Scene, Mapping[str, float]] | None:
    """A scene whose z = 0 is the first view's mirror, and the poses of the others; None: no solution.

    The captures do not determine the pattern's pitch and cells, the image's size, and place and orientation
    of the image's centre on the mirror: these are the given scene's.
    """
    camera = scene.camera
    if not isinstance(camera, PinholeCamera) or camera.face is not None or len(views) < 3:
        return None
    found = _virtual_displays(scene, views)
    if found is None:
        return None
    lens, axes, origins = found
    normals = _normals(axes)
    if normals is None:
        return None
    mirrors = np.eye(3) - 2 * normals[:, :, None] * normals[:, None, :]
    display = _orthogonal(np.einsum("kij,kjl->il", mirrors, axes))
    origin, distances = _offsets(mirrors, normals, origins)
    sign = np.where(distances < 0, 1.0, -1.0)  # normals towards the camera: n . x = -|d|
    normals, distances = sign[:, None] * normals, sign * distances
    rotation, position = _frame(scene, lens, normals[0], distances[0])
    u_axis, v_axis, pattern = rotation[:, 0], rotation[:, 1], scene.pattern
    start = replace(
        scene,
        camera=replace(lens, origin=position, u_axis=u_axis, v_axis=v_axis),
        pattern=replace(
            pattern,
            origin=rotation @ origin + position,
            u_axis=rotation @ display[:, 0],
            v_axis=rotation @ display[:, 1],
        ),
    )
    poses: dict[str, float] = {}
    middle = np.array([0.5 * scene.mirror.length, 0.5 * scene.mirror.width])
    for view, normal, distance in zip(views[1:], normals[1:], distances[1:], strict=True):
        n = rotation @ normal
        d = distance + float(n @ position)
        a, b = -n[0] / n[2], -n[1] / n[2]
        poses |= {f"{view.name}.tilt_x": float(a), f"{view.name}.tilt_y": float(b)}
        poses[f"{view.name}.height"] = float(d / n[2] + a * middle[0] + b * middle[1])
    return start, poses


def _virtual_displays(scene: Scene, views: Sequence[Sample]) -> tuple[PinholeCamera, Floats, Floats] | None:
    """The lens, and axes (K, 3, 3) and origins (K, 3) of the display's mirror images, camera frame."""
    camera, width = scene.camera, scene.pattern.pitch
    assert isinstance(camera, PinholeCamera)
    height = width * scene.pattern.aspect
    places = [
        np.stack([width * view.u, height * view.v, 0 * view.u], axis=-1).astype(np.float32) for view in views
    ]
    pixels = [np.stack([view.col, view.row], axis=-1).astype(np.float32) for view in views]
    size = camera.cols, camera.rows
    matrix: Any = None
    lens: Any = None
    for flags in (
        cv2.CALIB_FIX_PRINCIPAL_POINT | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K1,
        cv2.CALIB_USE_INTRINSIC_GUESS,
    ):
        try:
            _, matrix, lens, turns, shifts = cv2.calibrateCamera(
                places,
                pixels,
                size,
                matrix,
                lens,
                flags=flags | cv2.CALIB_FIX_K3 | cv2.CALIB_FIX_ASPECT_RATIO,
            )
        except cv2.error:
            return None
    axes = np.array([cv2.Rodrigues(turn)[0] for turn in turns], dtype=np.float64)
    axes[:, :, 2] = -axes[:, :, 2]  # a mirror's image is left-handed
    origins = np.array([np.ravel(shift) for shift in shifts], dtype=np.float64)
    inner = np.array(matrix, dtype=np.float64)
    focal, centre = np.diag(inner)[:2], inner[:2, 2]
    coefficients = np.array(lens, dtype=np.float64).ravel()[:5]
    try:
        found = replace(camera, focal=focal, centre=centre, distortion=coefficients)
    except ValueError:  # InputError: the image folds
        return None
    return found, axes, origins


def _normals(axes: Floats) -> Floats | None:
    """Normals (K, 3) up to their sign: perpendicular to the rotation axes between a mirror and the others."""
    normals = []
    for i, one in enumerate(axes):
        turns = [np.ravel(cv2.Rodrigues(one @ other.T)[0]) for j, other in enumerate(axes) if j != i]
        if np.linalg.norm(turns, axis=1).max() < _LEAST_TURN:
            return None
        normals.append(np.linalg.svd(turns)[2][-1])
    return np.stack(normals)


def _orthogonal(matrix: Floats) -> Floats:
    """The nearest rotation matrix."""
    left, _, right = np.linalg.svd(matrix)
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    nearest: Floats = left @ flip @ right
    return nearest


def _offsets(mirrors: Floats, normals: Floats, origins: Floats) -> tuple[Floats, Floats]:
    """The display's origin and the mirrors' distances: o_i = S_i o + 2 d_i n_i by least squares."""
    system = np.hstack([mirrors.reshape(-1, 3), block_diag(*(2 * normals[:, :, None]))])
    solved = np.asarray(np.linalg.lstsq(system, origins.ravel(), rcond=None)[0], np.float64)
    return solved[:3], solved[3:]


def _frame(scene: Scene, lens: PinholeCamera, normal: Floats, distance: float) -> tuple[Floats, Floats]:
    """Rotation (camera to mirror) and position of the camera: z = 0 is n . x = d; x, y of the image's centre
    on the mirror, and the azimuth of its u axis, are those of the given scene."""
    old = scene.camera
    middle = 0.5 * (old.rows - 1), 0.5 * (old.cols - 1)
    at, along = (np.asarray(part) for part in old.rays_at(*middle))
    foot = at - at[2] / along[2] * along
    azimuth = np.arctan2(old.u_axis[1], old.u_axis[0])
    first = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    first /= np.linalg.norm(first)
    base = np.stack([first, np.cross(normal, first), normal])  # rows: axes of a frame on the mirror
    c, s = np.cos(azimuth), np.sin(azimuth)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ base
    upright = replace(lens, origin=np.zeros(3), u_axis=np.eye(3)[0], v_axis=np.eye(3)[1])
    ray = rotation @ upright.rays_at(*middle)[1]
    height = -distance
    return rotation, np.array([*(foot[:2] + height / ray[2] * ray[:2]), height])
