"""Rigs drawn at random: prisms and open air, telecentric and pinhole cameras, faces, tilts, fills, light.

A rig is built around the ray in the middle of its view: it comes down on the middle of the mirror, is
reflected, and ends on the pattern's plane. How large the pattern's cells are, and which part of its plane it
covers, follows from a coarse trace of the resting mirror.
"""

from dataclasses import dataclass, replace

import numpy as np

from optolever.errors import InputError
from optolever.experiments.arrays import Floats
from optolever.projector import Lighting
from optolever.scene import (
    Camera,
    Face,
    Medium,
    Mirror,
    Pattern,
    PinholeCamera,
    Scene,
    Sensor,
    Surface,
    TelecentricCamera,
    dent,
    prism_pattern,
    resize,
    trace,
)

from .drawn import between, drawn_dent, together

KINDS = ("prism telecentric", "prism pinhole", "open air telecentric", "open air pinhole")
LEAST_LIT = 0.03
"""Share of the image that sees the pattern, at least; rigs below are drawn again."""

_TRIES = 200
_COARSE = 40  # rows and columns of the trace that a pattern is fitted to
_PLANE = 4.0  # half a side of the provisional pattern, in lengths of the mirror
_PLANE_CELLS = 4000


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """A scene with its blur, its mirror's shape and light; lit: share of the image that sees the pattern (of
    a coarse trace).
    """

    kind: str
    scene: Scene
    surface: Surface
    lighting: Lighting
    lit: float


def draw_rig(rng: np.random.Generator, kind: str, size: tuple[int, int]) -> Rig:
    """A rig of a kind (KINDS), camera of size (rows, cols), drawn until it sees enough of the pattern."""
    for _ in range(_TRIES):
        scene = _drawn_scene(rng, kind, size)
        lighting = _drawn_lighting(rng)
        dents = [drawn_dent(rng) for _ in range(rng.choice(3, p=(0.1, 0.7, 0.2)))]
        if scene is None:
            continue
        surface = together(dents, scene) if dents else dent("flat", scene)
        lit = float(trace(_coarse(scene), surface).visible.mean())
        if lit >= LEAST_LIT:
            return Rig(kind, scene, surface, lighting, lit)
    raise RuntimeError(f"{kind}: no rig in {_TRIES} draws sees {100 * LEAST_LIT:g} % of its image lit")


def _drawn_scene(rng: np.random.Generator, kind: str, size: tuple[int, int]) -> Scene | None:
    """None where the drawn camera is none, or sees nothing."""
    length = between(rng, 30, 160)
    mirror = Mirror(length, length * float(rng.uniform(0.6, 1.3)))
    prism = kind.startswith("prism")
    index = float(rng.uniform(1.33, 1.55))
    pattern_angle, angle = np.radians(rng.uniform(35, 60, 2) if prism else rng.uniform(10, 50, 2))
    if rng.random() < 0.5:
        pattern_angle = angle
    medium = Medium(index) if prism and rng.random() < 0.5 else None
    if medium is not None and angle < medium.critical_angle + np.radians(1.0):
        medium = None  # a mirror coat: without it the prism would reflect next to nothing
    face = None
    if prism and rng.random() < 0.7:
        inward = np.array([-np.sin(angle), 0.0, -np.cos(angle)])
        face = Face(np.array([length, 0.0, 0.0]), inward, index)
    try:
        camera = _drawn_camera(rng, kind, mirror, float(angle), face, size)
    except InputError:  # a lens that folds the image
        return None
    plane = _prism_plane(mirror, float(pattern_angle)) if prism else _open_plane(rng, mirror, float(angle))
    scene = Scene(kind, mirror, plane, camera, medium, accuracy=None)
    pattern = _fitted_pattern(rng, scene)
    return None if pattern is None else replace(scene, pattern=pattern)


def _drawn_camera(
    rng: np.random.Generator,
    kind: str,
    mirror: Mirror,
    angle: float,
    face: Face | None,
    size: tuple[int, int],
) -> Camera:
    """A camera that looks down at `angle` (rad) from the normal, more or less at the middle of the mirror,
    tilted by up to 6 degrees and rolled by up to 20; half of the cameras see all of the mirror and more.
    """
    rows, cols = size
    tilt = np.radians(rng.uniform(-6, 6, 2)) if rng.random() < 0.7 else np.zeros(2)
    roll = np.radians(rng.uniform(-20, 20)) if rng.random() < 0.7 else 0.0
    quarter = 0.5 * np.pi * rng.integers(4)
    u_axis, v_axis = camera_axes(angle + tilt[0], tilt[1], roll + quarter)
    zoom = float(np.sqrt(between(rng, 0.03, 1.0))) if rng.random() < 0.5 else float(rng.uniform(1.0, 1.2))
    fields = mirror.length * np.cos(angle), mirror.width
    along, down = fields[::-1] if quarter % np.pi else fields
    field = np.array([along, down]) / zoom
    shift = rng.uniform(-0.5, 0.5, 2) * np.abs(1.0 - 1.0 / zoom) * np.array([along, down])
    looking = np.cross(u_axis, v_axis)
    middle = np.array([0.5 * mirror.length, 0.5 * mirror.width, 0.0]) + shift[0] * u_axis + shift[1] * v_axis
    distance = mirror.length * float(rng.uniform(2.0, 6.0))
    stand = middle - distance * looking
    if "telecentric" in kind:
        pitch = field / (cols, rows)
        corner = stand - 0.5 * (cols - 1) * pitch[0] * u_axis - 0.5 * (rows - 1) * pitch[1] * v_axis
        return TelecentricCamera(corner, u_axis, v_axis, pitch, rows, cols, face)
    focal = distance * np.array([cols, rows]) / field
    centre = 0.5 * np.array([cols - 1, rows - 1]) + rng.uniform(-0.02, 0.02, 2) * cols
    corner2 = float((0.25 * field * field).sum()) / distance**2
    radial = rng.uniform(-0.06, 0.06, 2) / np.array([corner2, corner2**2])  # up to 6 % in the corners each
    tangential = rng.uniform(-0.01, 0.01, 2) / np.sqrt(corner2)
    distortion = np.array([radial[0], radial[1], *tangential, 0.0])
    return PinholeCamera(stand, u_axis, v_axis, focal, centre, rows, cols, distortion, face)


def camera_axes(angle: float, sideways: float, roll: float) -> tuple[Floats, Floats]:
    """Axes u, v of a camera that looks down at `angle` from the normal, towards -x, `sideways` along y."""
    u, v = np.array([-np.cos(angle), 0.0, np.sin(angle)]), np.array([0.0, 1.0, 0.0])
    looking = np.cross(u, v)
    v, looking = (
        np.cos(sideways) * v - np.sin(sideways) * looking,
        np.cos(sideways) * looking + np.sin(sideways) * v,
    )
    u = np.cross(v, looking)
    return np.cos(roll) * u + np.sin(roll) * v, np.cos(roll) * v - np.sin(roll) * u


def _prism_plane(mirror: Mirror, angle: float) -> Pattern:
    """The face of a prism that rises at `angle` (rad) from x = 0, in provisional cells."""
    pitch = 2.0 * _PLANE * mirror.length / _PLANE_CELLS
    face = prism_pattern(angle, _PLANE_CELLS, _PLANE_CELLS, pitch)
    aside = 0.5 * (_PLANE_CELLS * pitch - mirror.width)
    return replace(face, origin=face.origin - aside * face.v_axis)


def _open_plane(rng: np.random.Generator, mirror: Mirror, angle: float) -> Pattern:
    """A monitor across the reflected view, 1 to 3 lengths away, tilted and rolled by up to 20 degrees."""
    away = np.array([-np.sin(angle), 0.0, np.cos(angle)])
    distance = mirror.length * float(rng.uniform(1.0, 3.0))
    tilt = np.radians(rng.uniform(-20, 20, 2))
    roll = np.radians(rng.uniform(-20, 20)) + 0.5 * np.pi * rng.integers(4)
    u, v = camera_axes(angle + tilt[0], tilt[1], roll)
    u, v = u * (1.0, 1.0, -1.0), v * (1.0, 1.0, -1.0)  # the plane that a camera in the mirror image faces
    pitch = 2.0 * _PLANE * mirror.length / _PLANE_CELLS
    middle = np.array([0.5 * mirror.length, 0.5 * mirror.width, 0.0]) + distance * away
    return Pattern(middle - 0.5 * _PLANE_CELLS * pitch * (u + v), u, v, pitch, _PLANE_CELLS, _PLANE_CELLS)


def _fitted_pattern(rng: np.random.Generator, scene: Scene) -> Pattern | None:
    """The part of the pattern's plane that the camera sees in the resting mirror, or some of it, in cells of
    0.5 to 2 camera pixels; None if it sees nothing.
    """
    blur, density = float(rng.uniform(0.3, 1.0)), between(rng, 0.5, 2.0)  # cells; cells per camera pixel
    cover = rng.uniform(0.6, 1.0, 2) if rng.random() < 0.3 else rng.uniform(1.0, 1.3, 2)
    place = rng.random(2)
    coarse = _coarse(scene)
    seen = trace(coarse, dent("flat", scene))
    if seen.visible.mean() < LEAST_LIT:
        return None
    by = (coarse.camera.rows / scene.camera.rows, coarse.camera.cols / scene.camera.cols)
    moves = [np.hypot(np.diff(seen.u, axis=axis), np.diff(seen.v, axis=axis)) * by[axis] for axis in (0, 1)]
    moved = [float(np.nanmedian(move)) for move in moves if np.isfinite(move).any()]
    if len(moved) < 2:
        return None
    plane = scene.pattern
    cell = float(np.sqrt(moved[0] * moved[1])) / density  # provisional cells per cell
    low = np.array([np.nanmin(seen.u), np.nanmin(seen.v)])
    span = np.array([np.nanmax(seen.u), np.nanmax(seen.v)]) - low
    start = low + (1.0 - cover) * place * span
    cols, rows = np.ceil(cover * span / cell).astype(int)
    if not (8 <= rows <= 2000 and 8 <= cols <= 2000):
        return None
    start = start + 0.5 * cell
    origin = plane.origin + plane.pitch * (start[0] * plane.u_axis + start[1] * plane.v_axis)
    return Pattern(origin, plane.u_axis, plane.v_axis, plane.pitch * cell, int(rows), int(cols), blur)


def _coarse(scene: Scene) -> Scene:
    return replace(resize(scene, _COARSE, _COARSE), pattern=scene.pattern)


def drawn_sensor(rng: np.random.Generator) -> Sensor:
    """White at a third to all of full scale, one in ten beyond; 10, 12 or 16 bits in one of four."""
    offset = float(rng.uniform(0, 40))
    fill = float(rng.uniform(1.0, 1.2)) if rng.random() < 0.1 else between(rng, 0.35, 0.95)
    return Sensor(
        bits=int(rng.choice([10, 12, 16])) if rng.random() < 0.25 else 8,
        noise=between(rng, 0.3, 3.0),
        gain_e=between(rng, 5, 500) if rng.random() < 0.5 else 0.0,
        exposure=fill * (255.0 - offset) / 255.0,
        offset=offset,
    )


def _drawn_lighting(rng: np.random.Generator) -> Lighting:
    """A backlight uneven by up to 30 %, vignetting up to 50 %, a dark current up to 15 levels."""
    u, v = rng.random(2)
    return Lighting(
        float(rng.uniform(0, 0.3)),
        (float(u), float(v)),
        float(rng.uniform(0, 0.5)),
        float(rng.uniform(0, 15)),
    )
