"""Fields of small motions and heights: d(u, v) of a flat mirror at rest by differences of the exact geometry,
on nodes of the image, and cubic splines between them.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.interpolate import make_interp_spline

from optolever.scene import Scene, adjusted

from ..arrays import Floats

__all__ = [
    "MotionPrior",
    "bump_heights",
    "filled",
    "height_fields",
    "height_sensitivity",
    "interpolated",
    "mirror_place",
    "rigid_sensitivity",
    "sag_heights",
]

_POSE = ("x", "y", "z", "rx", "ry", "rz")


@dataclass(frozen=True, slots=True)
class MotionPrior:
    """Standard deviations of what moves between two captures: image, camera pixels; turn, rad; shift, mm;
    sag of the body under load, mm."""

    image: float = 0.02
    turn: float = np.radians(5 / 3600)
    shift: float = 1e-3
    sag: float = 3e-3


def _landing(
    scene: Scene, row: Floats, col: Floats, height: float = 0.0, slope: tuple[float, float] = (0.0, 0.0)
) -> Floats:
    """Pattern coordinates (2, ...) of pixels by a mirror z = height with these slopes; NaN where they see no
    pattern's plane."""
    origins, directions = (part.reshape(-1, 3).T for part in scene.camera.rays_at(row, col))
    with np.errstate(divide="ignore", invalid="ignore"):
        away = (height - origins[2]) / directions[2]
        points = origins + away * directions
        x, y = slope
        normal = np.array([-x, -y, 1.0])[:, None] / np.sqrt(1.0 + x * x + y * y)
        reflected = directions - 2.0 * (directions * normal).sum(axis=0) * normal
        u, v, way = scene.pattern.landing(points, reflected)
        seen = (away > 0) & (way > 0)
    return np.where(seen, np.stack([u, v]), np.nan).reshape(2, *row.shape)


def mirror_place(scene: Scene, row: Floats, col: Floats) -> Floats:
    """x and y (2, ...) where pixels look at the mirror at rest, mm."""
    origins, directions = (np.moveaxis(part, -1, 0) for part in scene.camera.rays_at(row, col))
    with np.errstate(divide="ignore", invalid="ignore"):
        place: Floats = (origins - origins[2] / directions[2] * directions)[:2]
    return place


def height_sensitivity(scene: Scene, row: Floats, col: Floats) -> Floats:
    """d(u, v)/d(z, dz/dx, dz/dy) of the mirror in every pixel, (3, 2, ...)."""
    high, turn = 1e-3, 1e-5

    def slope(x: float, y: float) -> Floats:
        return (_landing(scene, row, col, slope=(x, y)) - _landing(scene, row, col, slope=(-x, -y))) / (
            2 * turn
        )

    by_z = (_landing(scene, row, col, high) - _landing(scene, row, col, -high)) / (2 * high)
    return np.stack([by_z, slope(turn, 0.0), slope(0.0, turn)])


def rigid_sensitivity(
    scene: Scene, row: Floats, col: Floats, prior: MotionPrior
) -> tuple[tuple[str, ...], Floats, Floats]:
    """Names, prior standard deviations (p,) and d(u, v, row, col)/d(parameter) (p, 4, ...) of the rigid
    motions."""
    turns = {axis: prior.turn if axis.startswith("r") else prior.shift for axis in _POSE}
    steps = {"image.u": prior.image, "image.v": prior.image}
    steps |= {f"{part}.{axis}": turns[axis] for part in ("camera", "pattern") for axis in _POSE}
    steps |= {f"mirror.{axis}": turns[axis] for axis in ("z", "rx", "ry")}
    steps = {name: step for name, step in steps.items() if step > 0}
    by_height, (x, y) = height_sensitivity(scene, row, col), mirror_place(scene, row, col)
    along, across = (
        0.5 * (mirror_place(scene, row + di, col + dj) - mirror_place(scene, row - di, col - dj))
        for di, dj in ((0.5, 0.0), (0.0, 0.5))
    )
    per_pixel = np.moveaxis(2 * np.stack([along, across], axis=1), (0, 1), (-2, -1))  # d(x, y)/d(row, col)
    heights = {
        "mirror.z": np.stack([1.0 + 0 * x, 0 * x, 0 * x]),
        "mirror.rx": np.stack([y - 0.5 * scene.mirror.width, 0 * x, 1.0 + 0 * x]),
        "mirror.ry": np.stack([0.5 * scene.mirror.length - x, -1.0 + 0 * x, 0 * x]),
    }

    def effect(name: str, step: float) -> Floats:
        """d(u, v, x, y)/d(parameter) (4, ...)."""
        if name in heights:
            return np.concatenate(
                [np.einsum("k...,kc...->c...", heights[name], by_height), 0.0 * by_height[0]]
            )
        ends = []
        for change in (step, -step):
            moved, at = scene, (row, col)
            if name.startswith("image"):
                at = (row, col + change) if name == "image.u" else (row + change, col)
            else:
                moved = adjusted(scene, {name: change})
            ends.append(np.concatenate([_landing(moved, *at), mirror_place(moved, *at)]))
        found: Floats = (ends[0] - ends[1]) / (2 * step)
        return found

    effects: Floats = np.stack([effect(name, step) for name, step in steps.items()])
    pixels = np.linalg.solve(per_pixel, np.moveaxis(effects[:, 2:], 1, -1)[..., None])[..., 0]
    effects[:, 2:] = np.moveaxis(pixels, -1, 1)
    return tuple(steps), np.array(list(steps.values())), filled(effects)


def filled(fields: Floats) -> Floats:
    """Fields on nodes; nodes that see no pattern take the nearest one's value."""
    gaps = ~np.isfinite(fields).all(axis=tuple(range(fields.ndim - 2)))
    if not gaps.any() or gaps.all():
        return np.nan_to_num(fields)
    nearest = ndimage.distance_transform_edt(gaps, return_distances=False, return_indices=True)
    filled: Floats = fields[(..., *nearest)]
    return filled


def sag_heights(scene: Scene, x: Floats, y: Floats) -> Floats:
    """Heights and slopes (3, k, ...) of a body that sags by 1 along x, along y, and about both."""
    s, t = 2 * x / scene.mirror.length - 1, 2 * y / scene.mirror.width - 1
    s_x, t_y = 2 / scene.mirror.length, 2 / scene.mirror.width
    zero = 0.0 * s
    return np.stack(
        [
            np.stack([1 - s * s, 1 - t * t, s * t]),
            np.stack([-2 * s * s_x, zero, s_x * t]),
            np.stack([zero, -2 * t * t_y, s * t_y]),
        ]
    )


def bump_heights(x: Floats, y: Floats, length: float) -> Floats:
    """Heights and slopes (3, k, ...) of Gaussian bumps on a grid as wide as they are, and one beyond."""
    at = [np.arange(part.min() - length, part.max() + 1.5 * length, 1.25 * length) for part in (x, y)]
    x0, y0 = (part.ravel()[:, None, None] for part in np.meshgrid(*at))
    dx, dy = (x - x0) / length, (y - y0) / length
    bump = np.exp(-0.5 * (dx * dx + dy * dy))
    return np.stack([bump, -dx / length * bump, -dy / length * bump])


def height_fields(by_height: Floats, heights: Floats) -> Floats:
    """Fields (k, 2, rows, cols) of heights and slopes (3, k, rows, cols)."""
    fields: Floats = np.einsum("hkij,hcij->kcij", heights, by_height)
    return fields


def interpolated(fields: Floats, shape: tuple[int, int], at: tuple[Floats, Floats]) -> Floats:
    """Fields (..., nodes, nodes) at rows and columns of the image, by cubic splines."""
    for axis, (size, places) in enumerate(zip(shape, at, strict=True), start=-2):
        nodes = np.linspace(0.0, size - 1.0, fields.shape[axis])
        degree = min(3, len(nodes) - 1)
        fields = make_interp_spline(nodes, fields, degree, axis=axis)(places) if degree else fields
    return fields
