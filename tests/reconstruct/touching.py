"""Rigs whose pattern plane touches the mirror in view, and how far it is away."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from optolever.scene import (
    Camera,
    Face,
    Mirror,
    PinholeCamera,
    Scene,
    Surface,
    TelecentricCamera,
    Trace,
    dent,
    prism_pattern,
)

Axis = NDArray[np.float64]


def camera_axes(angle: float, sideways: float, roll: float) -> tuple[Axis, Axis]:
    """Axes u, v of a camera that looks down at `angle` from the normal, towards -x, `sideways` along y."""
    u, v = np.array([-np.cos(angle), 0.0, np.sin(angle)]), np.array([0.0, 1.0, 0.0])
    ahead = np.cross(u, v)
    v, ahead = (
        np.cos(sideways) * v - np.sin(sideways) * ahead,
        np.cos(sideways) * ahead + np.sin(sideways) * v,
    )
    u = np.cross(v, ahead)
    return np.cos(roll) * u + np.sin(roll) * v, np.cos(roll) * v - np.sin(roll) * u


def way_of(scene: Scene, seen: Trace) -> NDArray[np.float64]:
    """From mirror to pattern (H, W), mm."""
    return np.linalg.norm(
        scene.pattern.point(seen.u, seen.v) - np.stack([seen.x, seen.y, seen.z], axis=-1), axis=-1
    )


def amid(scene: Scene, seen: Trace) -> tuple[int, int]:
    """The pixel of the median way."""
    places = np.argwhere(seen.visible)
    row, col = places[np.argsort(way_of(scene, seen)[seen.visible])[len(places) // 2]]
    return int(row), int(col)


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
    o, d = camera.rays()
    x = (o - o[..., 2:] / d[..., 2:] * d)[..., 0]
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


def dents_of(scene: Scene) -> list[Surface]:
    """Flat, a usual one, one beside the pattern's edge that lifts the mirror there, a wide one."""
    length, width = scene.mirror.length, scene.mirror.width
    return [
        dent("flat", scene),
        dent("gaussian", scene),
        dent("gaussian", scene, x=0.1 * length, y=0.5 * width, sigma=0.1 * length, peak=0.004 * length),
        dent("raised-cosine", scene, peak=0.01 * length),
    ]
