"""Which slopes of the mirror a pixel can measure, from the scene at rest: rays turned, not traced."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optolever.scene import Scene

__all__ = ["Rest", "lever_arm", "reflected", "rest_of", "slope_limits"]

Floats = NDArray[np.float64]
WIDEST = np.radians(45.0)  # no ray is turned farther
SCAN, BISECTIONS = 181, 40


@dataclass(frozen=True, slots=True)
class Rest:
    """The mirror at rest as the camera sees it: points (H, W, 3) mm on z = 0, directions of the rays (unit),
    inside: whether the point is on the mirror."""

    points: Floats
    directions: Floats
    inside: NDArray[np.bool_]


def rest_of(scene: Scene) -> Rest:
    """Where every pixel's ray meets the plane of the mirror."""
    origins, directions = scene.camera.rays()
    with np.errstate(divide="ignore", invalid="ignore"):
        points = origins - (origins[..., 2:] / directions[..., 2:]) * directions
    x, y = points[..., 0], points[..., 1]
    inside = (x >= 0) & (x <= scene.mirror.length) & (y >= 0) & (y <= scene.mirror.width)
    return Rest(points, np.asarray(directions), inside & (directions[..., 2] < 0))


def reflected(
    scene: Scene, rest: Rest, angle: Floats | float, along: str
) -> tuple[Floats, Floats, Floats, Floats]:
    """(u, v, path in mm, cosine of incidence), (H, W), where the slope along x or y is tan(angle).

    u, v: NaN where the ray does not reach the pattern's plane ahead of it.
    """
    turn = np.broadcast_to(np.asarray(angle, np.float64), rest.inside.shape)
    normal = np.zeros(rest.points.shape)
    normal[..., "xy".index(along)] = -np.sin(turn)
    normal[..., 2] = np.cos(turn)
    cosine = -(rest.directions * normal).sum(axis=-1)
    out = rest.directions + 2 * cosine[..., None] * normal
    pattern = scene.pattern
    with np.errstate(divide="ignore", invalid="ignore"):
        path = ((pattern.origin - rest.points) @ pattern.normal) / (out @ pattern.normal)
        landed = rest.points + path[..., None] * out
        u, v = pattern.coordinates(landed)
    ahead = (path > 0) & (cosine > 0)
    return np.where(ahead, u, np.nan), np.where(ahead, v, np.nan), path, cosine


def slope_limits(scene: Scene, rest: Rest, along: str) -> tuple[Floats, Floats]:
    """Least and greatest slope angle along x or y (rad, (H, W)) up to which the ray lands on the pattern.

    From rest outwards until it first leaves; NaN where it misses at rest. In a telecentric 45-degree prism
    along x: from -atan((L0 - x) / x) / 2 (the apex) to 22.5 degrees (along the mirror to the pattern's edge).
    """
    seen = _lands(scene, rest, 0.0, along)
    limits = []
    for sign in (-1.0, 1.0):
        good, bad = np.zeros(seen.shape), np.full(seen.shape, WIDEST)
        still = seen.copy()
        for angle in np.linspace(0, WIDEST, SCAN)[1:]:
            lands = _lands(scene, rest, sign * angle, along)
            bad = np.where(still & ~lands, angle, bad)
            still &= lands
            good = np.where(still, angle, good)
        for _ in range(BISECTIONS):
            middle = 0.5 * (good + bad)
            lands = _lands(scene, rest, sign * middle, along)
            good, bad = np.where(lands, middle, good), np.where(lands, bad, middle)
        limits.append(np.where(seen, sign * good, np.nan))
    return limits[0], limits[1]


def lever_arm(scene: Scene, rest: Rest) -> tuple[Floats, Floats]:
    """(path from mirror to pattern in mm, cells by which the image moves per mrad of slope along x), (H,
    W).
    """
    step = 1e-5
    _, _, path, _ = reflected(scene, rest, 0.0, "x")
    before, behind = (reflected(scene, rest, sign * step, "x")[:2] for sign in (-1.0, 1.0))
    moved = np.hypot(behind[0] - before[0], behind[1] - before[1]) / (2 * step) * 1e-3
    return np.where(_lands(scene, rest, 0.0, "x"), path, np.nan), np.asarray(moved)


def _lands(scene: Scene, rest: Rest, angle: Floats | float, along: str) -> NDArray[np.bool_]:
    u, v, _, _ = reflected(scene, rest, angle, along)
    pattern = scene.pattern
    with np.errstate(invalid="ignore"):
        on = (u >= -0.5) & (u <= pattern.cols - 0.5) & (v >= -0.5) & (v <= pattern.rows - 0.5)
    return np.asarray(on & rest.inside)
