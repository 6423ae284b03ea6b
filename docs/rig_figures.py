"""Drawings of a rig: mirror, pattern and camera in the plane y = const, with rays from `scene.trace`."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from optolever.arrays import Floats
from optolever.scene import Scene, TelecentricCamera, dent_from_text, trace

MIRROR, PATTERN, CAMERA, RAY = "#1f5f8b", "#c8553d", "#2a9d8f", "#9aa0a8"


def rig(axes: Axes, scene: Scene, rays: int = 9, dent: str = "flat", exaggerate: float = 1.0) -> None:
    """The cut of a rig in mm, x to the right, z up; `rays` of the camera's middle row, followed exactly."""
    middle = 0.5 * scene.mirror.width
    x = np.linspace(0, scene.mirror.length, 400)
    height = dent_from_text(dent, scene).height(x, np.full_like(x, middle))
    axes.plot(x, exaggerate * height, color=MIRROR, lw=2.5)
    _line(axes, pattern_ends(scene), PATTERN)
    _line(axes, camera_ends(scene), CAMERA)
    for points in _rays(scene, dent, rays):
        axes.plot(points[:, 0], points[:, 2], color=RAY, lw=0.7, zorder=0)
    axes.set_aspect("equal")
    axes.set_xlabel("x [mm]")
    axes.set_ylabel("z [mm]")


def names(axes: Axes, scene: Scene) -> None:
    """Mirror, pattern and camera by name."""
    length = scene.mirror.length
    _text(axes, (0.5 * length, 0.0), "mirror (z = 0 at rest)", MIRROR, (0, -14), "center")
    for name, ends, colour in (
        ("pattern", pattern_ends(scene), PATTERN),
        ("camera", camera_ends(scene), CAMERA),
    ):
        place = ends.mean(axis=0)[[0, 2]]
        left = place[0] < 0.5 * length
        _text(axes, place, name, colour, (-8 if left else 8, 4), "right" if left else "left")


def frame_of_reference(axes: Axes, scene: Scene) -> None:
    """The mirror's x and z, the pattern's axis and the camera's columns that lie in the cut, as arrows."""
    unit = 0.2 * max(scene.mirror.length, camera_ends(scene)[:, 2].max())
    _arrow(axes, (0.0, 0.0), (unit, 0.0), "x", "black")
    _arrow(axes, (0.0, 0.0), (0.0, unit), "z", "black")
    along_u = _along_u(scene)
    axis = scene.pattern.u_axis if along_u else scene.pattern.v_axis
    _beside(axes, scene, pattern_ends(scene)[0], unit * axis, "u" if along_u else "v", PATTERN)
    _beside(axes, scene, camera_ends(scene)[0], unit * scene.camera.u_axis, "columns", CAMERA)


def pattern_ends(scene: Scene) -> Floats:
    """Both ends (2, 3) of the pattern in the cut, mm."""
    pattern = scene.pattern
    axis, cells = (pattern.u_axis, pattern.cols) if _along_u(scene) else (pattern.v_axis, pattern.rows)
    return np.stack([pattern.origin + place * pattern.pitch * axis for place in (-0.5, cells - 0.5)])


def camera_ends(scene: Scene) -> Floats:
    """Both ends (2, 3) of the face that the camera looks through, or the centre of its lens (1, 3), mm."""
    camera = scene.camera
    if not isinstance(camera, TelecentricCamera):
        return camera.origin[None]
    return np.stack(
        [camera.origin + place * camera.pitch[0] * camera.u_axis for place in (-0.5, camera.cols - 0.5)]
    )


def _along_u(scene: Scene) -> bool:
    """Whether the pattern's u, rather than its v, lies in the cut."""
    return bool(abs(scene.pattern.u_axis[1]) < 0.5)


def _rays(scene: Scene, dent: str, count: int) -> list[Floats]:
    """Points (3, 3) per ray: camera, mirror, pattern."""
    found = trace(scene, dent_from_text(dent, scene))
    row, pattern = found.visible.shape[0] // 2, scene.pattern
    seen = np.flatnonzero(found.visible[row])
    rays = []
    for col in seen[(np.linspace(0.04, 0.96, count) * (len(seen) - 1)).astype(int)]:
        mirror = np.array([found.x[row, col], found.y[row, col], found.z[row, col]])
        step = pattern.pitch * (found.u[row, col] * pattern.u_axis + found.v[row, col] * pattern.v_axis)
        rays.append(np.stack([scene.camera.rays()[0][row, col], mirror, pattern.origin + step]))
    return rays


def _line(axes: Axes, ends: Floats, colour: str) -> None:
    axes.plot(ends[:, 0], ends[:, 2], color=colour, lw=3, marker="s" if len(ends) == 1 else None, ms=8)


def _text(axes: Axes, place: Any, text: str, colour: str, shift: tuple[float, float], side: str) -> None:
    axes.annotate(
        text, place, shift, textcoords="offset points", ha=side, va="center", color=colour, fontsize=9
    )


def _arrow(axes: Axes, foot: Any, way: Any, name: str, colour: str) -> None:
    tip = np.asarray(foot) + np.asarray(way)
    axes.annotate("", tip, foot, arrowprops={"arrowstyle": "->", "color": colour, "lw": 1.8})
    ahead = 10 * np.asarray(way) / np.linalg.norm(way)
    _text(axes, tip, name, colour, (ahead[0], ahead[1]), "center")


def _beside(axes: Axes, scene: Scene, foot: Floats, way: Floats, name: str, colour: str) -> None:
    """An arrow beside what it belongs to, on the side away from the mirror's middle."""
    along = way[[0, 2]] / np.linalg.norm(way[[0, 2]])
    across = np.array([-along[1], along[0]])
    away = foot[[0, 2]] + way[[0, 2]] - np.array([0.5 * scene.mirror.length, 0.0])
    shift = 0.05 * scene.mirror.length * np.sign(across @ away) * across
    _arrow(axes, foot[[0, 2]] + shift, way[[0, 2]], name, colour)
