"""Rigs with errors and captures of targets on them, for the figures and tests of the calibration.

The truth is traced by `scene.trace` (or rendered through it), never by the adjustment's own model.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from optolever.arrays import Floats
from optolever.calibration import Ball, Flat, Observation, Rest, default_priors
from optolever.decode import Correspondence
from optolever.scene import (
    Face,
    Mirror,
    PinholeCamera,
    Scene,
    Surface,
    adjusted,
    load,
    parameter_changes,
    parameter_values,
    resize,
    trace,
)

__all__ = [
    "Rig", "ball_cap", "behind_face", "correspondence_of", "dented", "frame_change", "open_air", "prism",
    "shape_surface",
]  # fmt: skip

Rng = np.random.Generator
Capturer = Callable[[Scene, Surface, int], Correspondence]


@dataclass(frozen=True, eq=False)
class Rig:
    """truth: the scene as it is; given: as it was typed; observations of targets; dent: to measure, and the
    same mirror without it; numbers: of the truth, as changes of the given (`parameter_values`); reference:
    the flat whose plane is the frame of a calibration without a guess."""

    truth: Scene
    given: Scene
    observations: list[Observation]
    dent: Surface
    rest: Surface
    numbers: dict[str, float] = field(default_factory=dict)
    reference: Surface | None = None


def frame_change(rig: Rig, start: Scene) -> tuple[Floats, Floats]:
    """Rotation (3, 3) and shift (3,) from the truth's frame to that of a calibration from `start`: its gauge
    holds the camera's x, y and turn about z there, and the reference's quadratic form has no plane."""
    if rig.reference is None:
        return np.eye(3), np.zeros(3)
    length, width, camera = rig.truth.mirror.length, rig.truth.mirror.width, rig.truth.camera
    x, y = (part.ravel() for part in np.meshgrid(np.linspace(0, length, 5), np.linspace(0, width, 5)))
    points = np.stack([x, y, rig.reference.height(x, y)], axis=-1)

    def off(pose: Floats) -> Floats:
        turn, shift = Rotation.from_rotvec(pose[:3]).as_matrix(), pose[3:]
        at = points @ turn.T + shift
        s, t = 2 * at[:, 0] / length - 1, 2 * at[:, 1] / width - 1
        form = np.stack([np.ones_like(s), s, t, 1.5 * s * s - 0.5, s * t, 1.5 * t * t - 0.5], axis=-1)
        plane = np.linalg.lstsq(form, at[:, 2], rcond=None)[0][:3]
        axes = {"u_axis": turn @ camera.u_axis, "v_axis": turn @ camera.v_axis}
        moved = replace(start, camera=replace(start.camera, origin=turn @ camera.origin + shift, **axes))
        changes = parameter_changes(start, moved)
        return np.array([*plane, *(changes[f"camera.{name}"] for name in ("x", "y", "rz"))])

    found = least_squares(
        off, np.zeros(6), x_scale=[1e-3] * 3 + [1.0] * 3, xtol=1e-15, ftol=1e-15, gtol=1e-15
    )
    return Rotation.from_rotvec(found.x[:3]).as_matrix(), found.x[3:]


def correspondence_of(noise: float, rng: Rng) -> Capturer:
    """Captures as exact correspondences with Gaussian noise (cells)."""

    def capture(scene: Scene, surface: Surface, _: int) -> Correspondence:
        seen = trace(scene, surface)
        size = seen.u.shape
        u, v = (part + noise * rng.standard_normal(size) for part in (seen.u, seen.v))
        sigma = np.full(size, noise)
        return Correspondence(u, v, sigma, sigma, flags=np.where(seen.visible, 0, 1).astype(np.uint16))

    return capture


def shape_surface(height: Callable[[Floats, Floats], Floats]) -> Surface:
    """A surface from its height alone: slopes by the complex step (h(x + i e) / e, exact to rounding)."""
    tiny = 1e-30

    def gradient(x: Floats, y: Floats) -> tuple[Floats, Floats]:
        x, y = np.asarray(x, np.complex128), np.asarray(y, np.complex128)
        return height(x + 1j * tiny, y).imag / tiny, height(x, y + 1j * tiny).imag / tiny  # type: ignore[arg-type]

    return Surface(height, gradient)


def form(coefficients: Floats, mirror: Mirror) -> Callable[[Floats, Floats], Floats]:
    """Height of Legendre shapes of total order 2 (3 coefficients) and 3 (7), written out."""
    places = [(total - j, j) for total in (2, 3) for j in range(total + 1)]

    def height(x: Floats, y: Floats) -> Floats:
        s, t = 2 * x / mirror.length - 1, 2 * y / mirror.width - 1
        along, across = ((1.0, at, 1.5 * at**2 - 0.5, 2.5 * at**3 - 1.5 * at) for at in (s, t))
        terms = zip(coefficients, places, strict=False)
        total: Floats = sum((c * along[i] * across[j] for c, (i, j) in terms), 0 * (x + y))
        return total

    return height


def dented(
    under: Callable[[Floats, Floats], Floats], x: float, y: float, depth: float, size: float
) -> Surface:
    """A mirror `under` with a Gaussian dent, mm."""

    def height(a: Floats, b: Floats) -> Floats:
        square = (a - x) ** 2 + (b - y) ** 2
        dent: Floats = under(a, b) + depth * np.exp(-square / (2 * size**2))
        return dent

    return shape_surface(height)


def open_air(
    rng: Rng,
    poses: int,
    capture: Capturer,
    tilts: tuple[float, float] = (3.0, 8.0),
    size: int = 160,
    flatness: float = 1e-6,
) -> Rig:
    """`monitor-mirror` with another lens, display pose and a bow of 0.2 mm; K poses of one reference, whose
    form is drawn from its flatness (mm); nothing of them is known before."""
    base = resize(load("monitor-mirror", exact=True), size * 4 // 5, size)
    values = {f"pattern.{name}": 0.2 * rng.standard_normal() for name in ("b20", "b11", "b02")}
    values["camera.f"] = parameter_values(base)["camera.f"] * (1.0 + 0.05 * rng.uniform(-1, 1))
    values |= {"camera.rx": 0.01 * rng.uniform(-1, 1), "camera.k1": -0.1, "camera.k2": 0.05}
    values |= {f"pattern.{name}": 0.03 * rng.uniform(-1, 1) for name in ("rx", "ry", "rz")}
    values |= {f"pattern.{name}": 8.0 * rng.uniform(-1, 1) for name in ("x", "y", "z")}
    truth = adjusted(base, values)
    observations: list[Observation] = []
    bulge = form(flatness * rng.standard_normal(3), truth.mirror)
    x, y = 0.5 * truth.mirror.length, 0.5 * truth.mirror.width

    def reference(z0: float, a: float, b: float) -> Surface:
        return shape_surface(lambda at, along: z0 + a * (at - x) + b * (along - y) + bulge(at, along))

    turn = rng.uniform(0, 2 * np.pi)
    for k in range(poses):
        tilt = np.radians(rng.uniform(*tilts)) if k else 0.0
        angle = turn + 2 * np.pi * k * 0.382  # golden: no two tilts about one axis
        surface = reference(rng.uniform(-5, 5) if k else 0.0, tilt * np.cos(angle), tilt * np.sin(angle))
        observations.append(Observation(f"flat{k}", Flat(flatness), capture(truth, surface, k)))

    flat, form_alone = form(np.zeros(0), truth.mirror), reference(0.0, 0.0, 0.0)
    dent = dented(flat, x, y, 0.5, 18.0)
    return Rig(truth, base, observations, dent, shape_surface(flat), reference=form_alone)


def prism(
    rng: Rng, balls: int, capture: Capturer, pinhole: bool = False, size: int = 200, lens: bool = False
) -> Rig:
    """`prism48`, or a pinhole behind its capture face, every number off by a draw of its prior; the mirror
    sags by 20 um; rest and `balls` balls of 25 to 40 mm. lens: k1 is +-0.08, cx and cy are off by +-10 px."""
    base = behind_face(size) if pinhole else resize(load("prism48", exact=True), size * 3 // 4, size)
    length, width = base.mirror.length, base.mirror.width
    priors = default_priors(base)
    own = parameter_values(base)
    numbers = {name: own[name] + sigma * rng.standard_normal() for name, sigma in priors.items()}
    if lens:
        signs = rng.choice([-1.0, 1.0], 3)
        off = zip(("camera.k1", "camera.cx", "camera.cy"), signs * [0.08, 10.0, 10.0], strict=True)
        numbers |= {name: own[name] + by for name, by in off}
    truth = adjusted(base, numbers)
    sag = form(0.02 / np.sqrt(7) * rng.standard_normal(7), base.mirror)
    rest = shape_surface(sag)
    observations = [Observation("rest", Rest(3), capture(truth, rest, 0))]
    for k in range(balls):
        radius = rng.uniform(25, 40)
        x, y = length * rng.uniform(0.35, 0.7), width * rng.uniform(0.35, 0.65)
        surface = shape_surface(ball_cap(sag, x, y, 0.3, radius))
        c = capture(truth, surface, 1 + k)
        seen = trace(truth, surface)
        with np.errstate(invalid="ignore"):
            inside = np.hypot(seen.x - x, seen.y - y) < 0.8 * np.sqrt(0.3 * radius)
        observations.append(Observation(f"ball{k}", Ball(radius, 1e-4 * radius), c, np.asarray(inside)))

    dent = dented(sag, 0.5 * length, 0.5 * width, 0.3, 8.0)
    return Rig(truth, base, observations, dent, rest, numbers)


def ball_cap(
    under: Callable[[Floats, Floats], Floats], x0: float, y0: float, depth: float, radius: float
) -> Callable[[Floats, Floats], Floats]:
    """Height of a mirror `under` into which a ball is pressed: a sphere in the contact, a = sqrt(R d),
    outside of it a skirt with the same height and slope at a that falls to `under`'s."""
    a = np.sqrt(radius * depth)

    def sphere(square: Floats) -> Floats:
        cap: Floats = depth - radius + np.sqrt(radius**2 - square)
        return cap

    edge, slope = sphere(np.float64(a * a)), -a / np.sqrt(radius**2 - a * a)  # type: ignore[arg-type]

    def height(x: Floats, y: Floats) -> Floats:
        square = (x - x0) ** 2 + (y - y0) ** 2
        in_contact = np.real(square) < a * a
        far = np.sqrt(np.where(in_contact, a * a, square)) - a
        skirt = edge * np.exp(slope / edge * far)
        blend = np.exp(-far)  # under's own form is left to the ball within the contact only
        cap = sphere(np.where(in_contact, square, 0.0))
        result: Floats = np.where(in_contact, cap, skirt + (1 - blend) * under(x, y))
        return result

    return height


def behind_face(size: int) -> Scene:
    """`prism48` seen by a pinhole 150 mm before its capture face."""
    flat = resize(load("prism48", exact=True), size * 3 // 4, size)
    camera, index, away = flat.camera, flat.medium.index if flat.medium else 1.41, 150.0
    assert not isinstance(camera, PinholeCamera)
    centre = 0.5 * np.array([camera.cols - 1, camera.rows - 1])
    middle, forward = camera.rays_at(centre[1], centre[0])
    axes, focal = (camera.u_axis, camera.v_axis), 1.05 * away / camera.pitch
    face, size_px = Face(middle, forward, index), (camera.rows, camera.cols)
    lens = PinholeCamera(middle - away * forward, *axes, focal, centre, *size_px, face=face)
    return replace(flat, camera=lens)
