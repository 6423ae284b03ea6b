"""A rig to scale, from the side and from above, as SVG whose colours a page sets."""

from collections.abc import Mapping

import numpy as np
from markupsafe import Markup

from optolever.arrays import Floats
from optolever.scene import PinholeCamera, Scene

__all__ = ["rig_drawing"]

#: Points (n, 3), mm, of a line by its CSS class.
Lines = dict[str, Floats]


def _camera_view(scene: Scene) -> tuple[Floats, Floats]:
    """The camera's middle ray (n, 3), from the camera to the mirror at rest, and the face that it crosses, a
    line in its plane of x and z (2, 3), or none (0, 3); mm.

    A pinhole stands where it is. A telecentric camera has no place along its axis: it is drawn outside.
    """
    camera, reach = scene.camera, scene.mirror.length
    (start,), (way,) = camera.rays_at(*(0.5 * np.array([[camera.rows - 1], [camera.cols - 1]])))
    foot = start - start[2] / way[2] * way
    bends = np.empty((0, 3)) if camera.face is None else start[None]
    if isinstance(camera, PinholeCamera):
        place = camera.origin
    else:
        axis = np.cross(camera.u_axis, camera.v_axis)
        place = (foot if camera.face is None else start) - reach * axis
    ray = np.vstack([place, bends, foot])
    if camera.face is None:
        return ray, bends
    normal = camera.face.normal
    along = np.array([normal[2], 0.0, -normal[0]]) / np.hypot(normal[0], normal[2])
    return ray, start + 0.3 * reach * np.array([[-1.0], [1.0]]) * along


def rig_drawing(rigs: Mapping[str, Scene]) -> tuple[Markup, float]:
    """Both views of rigs by CSS class, and the length of the scale bar in mm."""
    parts = {name: _lines(scene) for name, scene in rigs.items()}
    points = np.vstack([line for lines in parts.values() for line in lines.values()])
    size = float(np.ptp(points, axis=0).max())
    power = 10.0 ** np.floor(np.log10(0.4 * size))
    bar = float(max(step for step in (1, 2, 5) if step * power <= 0.4 * size) * power)
    views = [_view(parts, points, axes, bar, 0.05 * size) for axes in ((0, 2), (0, 1))]
    return Markup("").join(views), bar


def _lines(scene: Scene) -> Lines:
    """Mirror, pattern, face and the middle ray from the camera over the mirror to the pattern's plane."""
    pattern, (length, width) = scene.pattern, (scene.mirror.length, scene.mirror.width)
    corners = np.array([[-0.5, pattern.cols - 0.5], [-0.5, pattern.rows - 0.5]])
    screen = pattern.point(corners[0][[0, 1, 1, 0, 0]], corners[1][[0, 0, 1, 1, 0]])
    mirror = np.array([[0, 0, 0], [length, 0, 0], [length, width, 0], [0, width, 0], [0, 0, 0]], float)
    ray, face = _camera_view(scene)
    way = (ray[-1] - ray[-2]) * [1, 1, -1]
    u, v, ahead = pattern.landing(ray[-1][:, None], (way / np.linalg.norm(way))[:, None])
    if ahead[0] > 0:
        ray = np.vstack([ray, pattern.point(u, v)])
    lines = {"mirror": mirror, "pattern": screen, "ray": ray, "camera": ray[:1]}
    return lines | {"face": face} if len(face) else lines


def _view(
    parts: Mapping[str, Lines], points: Floats, axes: tuple[int, int], bar: float, margin: float
) -> Markup:
    low, high = points[:, axes].min(axis=0) - margin, points[:, axes].max(axis=0) + margin
    width, height = high - low + [0, margin]
    title = "rig from the side, x to the right, z up" if axes[1] == 2 else "rig from above, y up"
    shapes = []
    for rig, lines in parts.items():
        for kind, line in lines.items():
            at = [(float(p[axes[0]] - low[0]), float(high[1] - p[axes[1]])) for p in line]
            if kind == "camera":
                dot = 'cx="{:.5g}" cy="{:.5g}" r="{:.3g}"'.format(*at[0], 0.2 * margin)
                shapes.append(f'<circle class="{kind} {rig}" {dot}/>')
            else:
                text = " ".join(f"{x:.5g},{y:.5g}" for x, y in at)
                shapes.append(f'<polyline class="{kind} {rig}" points="{text}"/>')
    foot = float(height) - 0.5 * margin
    shapes.append(f'<polyline class="bar" points="{margin:.5g},{foot:.5g} {margin + bar:.5g},{foot:.5g}"/>')
    return Markup(
        f'<svg viewBox="0 0 {width:.5g} {height:.5g}" role="img" aria-label="{title}">{"".join(shapes)}</svg>'
    )
