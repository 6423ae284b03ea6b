"""Rigs whose pattern plane touches the mirror in view, and their exact correspondences by brute force.

Nothing of `optolever.scene` is used to follow a ray: rays, Snell's law, the meeting with the mirror by
bisection of a sampled bracket, reflection and the pattern's plane are written out here once more.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from optolever.decode import Correspondence, Flag
from optolever.scene import (
    Camera,
    Face,
    Mirror,
    PinholeCamera,
    Scene,
    Surface,
    TelecentricCamera,
    dent,
    prism_pattern,
)

Floats = NDArray[np.float64]

SAMPLES = 600  # along every ray, to find the first crossing
HALVINGS = 60


@dataclass(frozen=True)
class Seen:
    """What pixels see, (H, W): pattern coordinates, mirror points (3, H, W), way to the pattern (mm)."""

    u: Floats
    v: Floats
    point: Floats
    way: Floats
    visible: NDArray[np.bool_]

    def amid(self) -> tuple[int, int]:
        """The pixel of the median way."""
        seen = np.argwhere(self.visible)
        row, col = seen[np.argsort(self.way[self.visible])[len(seen) // 2]]
        return int(row), int(col)

    def correspondence(self, sigma: float = 0.02, noise: float = 0.0, seed: int = 0) -> Correspondence:
        """What a decoder would make of it."""
        rng = np.random.default_rng(seed)
        u, v = (part + noise * rng.standard_normal(part.shape) for part in (self.u, self.v))
        flags = np.where(self.visible, 0, int(Flag.OFF_PATTERN)).astype(np.uint16)
        return Correspondence(u, v, *np.full((2, *u.shape), sigma), flags)


def rays_of(camera: Camera) -> tuple[Floats, Floats]:
    """Origins and unit directions (3, H, W), by Snell's law in angles behind a face."""
    row, col = np.mgrid[: camera.rows, : camera.cols].astype(np.float64)
    u, v = camera.u_axis[:, None, None], camera.v_axis[:, None, None]
    ahead = np.cross(camera.u_axis, camera.v_axis)[:, None, None]
    origin = camera.origin[:, None, None]
    if isinstance(camera, TelecentricCamera):
        o = origin + col * camera.pitch[0] * u + row * camera.pitch[1] * v
        d = np.broadcast_to(ahead, o.shape)
    else:
        assert not camera.distortion.any()
        x, y = ((at - c) / f for at, c, f in zip((col, row), camera.centre, camera.focal, strict=True))
        d = x * u + y * v + ahead
        d = d / np.linalg.norm(d, axis=0)
        o = np.broadcast_to(origin, d.shape)
    if camera.face is None:
        return o, d
    n, point = camera.face.normal[:, None, None], camera.face.point[:, None, None]
    o = o + ((point - o) * n).sum(axis=0) / (d * n).sum(axis=0) * d
    cosine = (d * n).sum(axis=0)
    across = d - cosine * n
    sine = np.linalg.norm(across, axis=0)
    bent = np.arcsin(camera.face.outside * sine / camera.face.index)
    along = across / np.where(sine > 0, sine, 1.0)
    return o, np.cos(bent) * np.sign(cosine) * n + np.sin(bent) * along


def see(scene: Scene, surface: Surface) -> Seen:
    """Follow the ray of every pixel's centre to the pattern; NaN where it does not get there."""
    o, d = rays_of(scene.camera)
    mirror, pattern = scene.mirror, scene.pattern
    reach = 0.25 * mirror.length  # the mirror is nowhere deeper or higher
    first, last = (reach - o[2]) / d[2], (-reach - o[2]) / d[2]

    def above(t: Floats) -> Floats:
        x, y, z = o + t * d
        return z - surface.height(x, y)

    low, high, found = first.copy(), last.copy(), np.zeros(first.shape, np.bool_)
    before = first
    for k in range(1, SAMPLES + 1):
        t = first + (last - first) * k / SAMPLES
        crossed = ~found & (above(t) < 0)
        low, high = np.where(crossed, before, low), np.where(crossed, t, high)
        found |= crossed
        before = t
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        outside = above(middle) >= 0
        low, high = np.where(outside, middle, low), np.where(outside, high, middle)
    point = o + 0.5 * (low + high) * d
    x, y, _ = point
    found &= (x >= 0) & (x <= mirror.length) & (y >= 0) & (y <= mirror.width)
    slope_x, slope_y = surface.gradient(x, y)
    normal = np.stack([-slope_x, -slope_y, np.ones(x.shape)])
    normal /= np.linalg.norm(normal, axis=0)
    facing = -(d * normal).sum(axis=0)
    out = d + 2 * facing * normal
    across = np.cross(pattern.u_axis, pattern.v_axis)[:, None, None]
    way = ((pattern.origin[:, None, None] - point) * across).sum(axis=0) / (out * across).sum(axis=0)
    landed = point + way * out - pattern.origin[:, None, None]
    u, v = (
        (landed * axis[:, None, None]).sum(axis=0) / pattern.pitch
        for axis in (pattern.u_axis, pattern.v_axis)
    )
    visible = found & (facing > 0) & (way > 0)
    visible &= (u >= -0.5) & (u <= pattern.cols - 0.5) & (v >= -0.5) & (v <= pattern.rows - 0.5)
    u, v, way = (np.where(visible, part, np.nan) for part in (u, v, way))
    return Seen(u, v, np.where(visible, point, np.nan), way, visible)


def touching_rig(number: int, size: tuple[int, int] = (48, 56)) -> Scene:
    """A prism of 35 to 60 degrees drawn by that seed, telecentric (even) or pinhole, as a rule behind a face,
    tilted and rolled, whose pattern plane meets the resting mirror in view or passes over it by up to 0.015
    mm.
    """
    rng = np.random.default_rng([77, number])
    length = float(rng.uniform(30, 160))
    mirror = Mirror(length, length * float(rng.uniform(0.6, 1.3)))
    angle, pattern_angle = np.radians(rng.uniform(35, 60, 2))
    roll = np.radians(rng.uniform(-20, 20)) if rng.random() < 0.7 else 0.0
    tilt = np.radians(rng.uniform(-6, 6, 2)) if rng.random() < 0.7 else np.zeros(2)
    u, v = camera_axes(angle + tilt[0], tilt[1], roll + 0.5 * np.pi * rng.integers(4))
    ahead = np.cross(u, v)
    middle = np.array([0.5 * length, 0.5 * mirror.width, 0.0])
    rows, cols = size
    field = np.array([1.3 * length * np.cos(angle), mirror.width]) * float(rng.uniform(0.8, 1.1))
    inward = np.array([-np.sin(angle), 0.0, -np.cos(angle)])
    index = float(rng.uniform(1.33, 1.55)) if rng.random() < 0.6 else None
    face = None if index is None else Face(np.array([length, 0.0, 0.0]), inward, index)
    camera: Camera
    if number % 2:
        distance = length * float(rng.uniform(2, 5))
        focal, centre = distance * np.array([cols, rows]) / field, 0.5 * np.array([cols - 1, rows - 1])
        camera = PinholeCamera(middle - distance * ahead, u, v, focal, centre, rows, cols, face=face)
    else:
        pitch = field / (cols, rows)
        corner = middle - 2 * length * ahead - 0.5 * ((cols - 1) * pitch[0] * u + (rows - 1) * pitch[1] * v)
        camera = TelecentricCamera(corner, u, v, pitch, rows, cols, face)
    o, d = rays_of(camera)
    x = (o - o[2] / d[2] * d)[0]
    inside = np.sort(x[(x > 0) & (x < length)])
    kind = rng.integers(3)
    if kind == 0:  # at the mirror's edge, or just above it
        at, gap = 0.0, float(rng.choice([0, 0.015]))
    elif kind == 1:  # through the view
        at, gap = float(np.quantile(inside, 0.1)), 0.0
    else:  # through a pixel, or just above it
        at, gap = float(inside[30]), float(rng.uniform(0, 0.015))
    pattern = prism_pattern(float(pattern_angle), 400, 400, 1.4 * length / 400)
    shift = np.array([at, -0.2 * length, gap])
    return Scene(f"touching {number}", mirror, replace(pattern, origin=pattern.origin + shift), camera)


def camera_axes(angle: float, sideways: float, roll: float) -> tuple[Floats, Floats]:
    """Axes u, v of a camera that looks down at `angle` (rad) from the normal, towards -x."""
    u, v = np.array([-np.cos(angle), 0.0, np.sin(angle)]), np.array([0.0, 1.0, 0.0])
    ahead = np.cross(u, v)
    v, ahead = (
        np.cos(sideways) * v - np.sin(sideways) * ahead,
        np.cos(sideways) * ahead + np.sin(sideways) * v,
    )
    u = np.cross(v, ahead)
    return np.cos(roll) * u + np.sin(roll) * v, np.cos(roll) * v - np.sin(roll) * u


def dents_of(scene: Scene) -> list[Surface]:
    """Flat, a usual one, one beside the pattern's edge that lifts the mirror there, a wide one."""
    length, width = scene.mirror.length, scene.mirror.width
    return [
        dent("flat", scene),
        dent("gaussian", scene),
        dent("gaussian", scene, x=0.1 * length, y=0.5 * width, sigma=0.1 * length, peak=0.004 * length),
        dent("raised-cosine", scene, peak=0.01 * length),
    ]
