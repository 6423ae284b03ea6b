"""Contacts on rigs that are not as typed: how often area, depth and position lie within one sigma.

Every number of the rig is drawn from its prior, and so is the place of the whole rig along the mirror. Rest
and press are traced on that rig; the height is reconstructed with the typed scene against the rest capture.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy.ndimage
from scipy.spatial.transform import Rotation

from optolever.arrays import Floats, Mask
from optolever.decode import Correspondence
from optolever.errors import InputError
from optolever.reconstruct import Contact, HeightMap, contacts, exact_correspondence, reconstruct
from optolever.scene import (
    Scene,
    Surface,
    Trace,
    adjusted,
    dent,
    load,
    parameter_values,
    resize,
    rig_covariance,
    trace,
)

__all__ = [
    "KINDS", "Compared", "Finger", "captured", "changed", "contact_figures", "coverage", "drawn_press",
    "press",
]  # fmt: skip

KINDS = ("ball", "punch", "gaussian", "needle")
_GAUGE = (0.5, 0.5, np.radians(1.0))  # mm, mm, rad: where the whole rig stands along the mirror
_TAPER = 0.1  # of the mirror's length, as dents of a scene fade to the edge at rest
_FINE, _COARSE = 0.05, 0.25  # mm: grids of the true areas and of the dents that merge


@dataclass(frozen=True, slots=True)
class Finger:
    """One contact: kind, place, depth and size (contact radius, sigma or decay) in mm."""

    kind: str
    x: float
    y: float
    depth: float
    size: float

    @property
    def radius(self) -> float:
        """Where about half of the depth is left, mm."""
        factor = {"ball": 1.0, "punch": 1.3, "gaussian": np.sqrt(2 * np.log(2)), "needle": np.log(2)}
        return float(self.size * factor[self.kind])

    def surface(self, scene: Scene) -> Surface:
        """Its dent alone."""
        place = {"peak": self.depth, "x": self.x, "y": self.y}
        if self.kind == "ball":
            return dent("ball", scene, radius=self.size**2 / self.depth, **place)
        if self.kind == "needle":
            return dent("needle", scene, decay=self.size, **place)
        if self.kind == "gaussian":
            return dent("gaussian", scene, sigma=self.size, **place)
        return _punch(scene, self)


@dataclass(frozen=True, slots=True)
class Compared:
    """A finger, the contact that was found (None: none) and errors over sigma by name."""

    finger: Finger
    contact: Contact | None
    scores: dict[str, float]


def contact_figures(rigs: int, seed: int = 0, size: tuple[int, int] = (120, 160)) -> Iterator[list[Compared]]:
    """Fingers of every drawn rig against what was found, none where the rig gives no height."""
    scene = resize(load("prism48"), *size)
    for number in range(rigs):
        rng = np.random.default_rng([60, seed, number])
        fingers = drawn_press(scene, rng)
        try:
            pressed = press(scene, fingers, rng)
        except InputError:  # the anchor is not in view
            yield [Compared(finger, None, {}) for finger in fingers]
        else:
            yield compared(pressed, fingers, scene)


def coverage(some: list[Compared]) -> dict[str, float]:
    """How many fingers there are, how many were found and cut, and the share of errors within one sigma."""
    found = [each for each in some if each.contact is not None]
    counts = {"fingers": len(some), "found": len(found)}
    counts["cut"] = sum(each.contact is not None and each.contact.cut for each in found)
    if not found:
        return {name: float(count) for name, count in counts.items()}
    within = {name: np.mean([abs(each.scores[name]) < 1 for each in found]) for name in found[0].scores}
    shares = {"depth": within["depth"], "area": within["area"]}
    shares["position"] = 0.5 * (within["x"] + within["y"])
    return {name: float(value) for name, value in (counts | shares).items()}


def drawn_press(scene: Scene, rng: np.random.Generator) -> list[Finger]:
    """Two to five fingers whose dents do not merge above half of their depths."""
    wanted = int(rng.integers(2, 6))
    while True:
        fingers = [_drawn(scene, rng) for _ in range(wanted)]
        if not _merge(fingers, scene):
            return fingers


def _drawn(scene: Scene, rng: np.random.Generator) -> Finger:
    length, width = scene.mirror.length, scene.mirror.width
    depth, size = float(np.exp(rng.uniform(*np.log([0.02, 0.3])))), float(rng.uniform(2.0, 4.5))
    x, y = rng.uniform([0.2 * length, 0.15 * width], [0.8 * length, 0.85 * width])
    return Finger(KINDS[rng.integers(len(KINDS))], float(x), float(y), depth, size)


def _merge(fingers: list[Finger], scene: Scene) -> bool:
    """Whether at half of its depth any dent contains another one, or reaches the mirror's edge."""
    x, y = np.meshgrid(np.arange(0, scene.mirror.length, _COARSE), np.arange(0, scene.mirror.width, _COARSE))
    z = surface_of(fingers, scene).height(x, y)
    at = [(round(finger.y / _COARSE), round(finger.x / _COARSE)) for finger in fingers]
    for finger, place in zip(fingers, at, strict=True):
        labels, _ = scipy.ndimage.label(z > 0.45 * z[place])
        mine = labels == labels[place]
        if sum(mine[other] for other in at) > 1 or np.hypot(x - finger.x, y - finger.y)[mine].max() > 9.0:
            return True
    return False


def press(scene: Scene, fingers: list[Finger], rng: np.random.Generator, at_rest: bool = True) -> HeightMap:
    """Height of fingers on a rig drawn from the priors of a typed scene; at_rest: against a rest capture."""
    covariance = rig_covariance(scene)
    assert covariance is not None
    true = changed(scene, rng.standard_normal(len(covariance.root)) @ covariance.root)
    truth = _moved(true, *(_GAUGE * rng.standard_normal(3)))
    noise = float(rng.uniform(0.01, 0.02))
    rest = captured(truth, dent("flat", scene), noise, rng)[0] if at_rest else None
    places, _ = captured(truth, surface_of(fingers, scene), noise, rng)
    return reconstruct(places, scene, rest=rest)


def changed(scene: Scene, change: Floats) -> Scene:
    """The scene, exact, with the numbers of its covariance changed."""
    covariance, own = rig_covariance(scene), parameter_values(scene)
    assert covariance is not None
    values = {name: own[name] + by for name, by in zip(covariance.names, change, strict=True)}
    return replace(adjusted(scene, values), covariance=None, accuracy=None)


def compared(height: HeightMap, fingers: list[Finger], scene: Scene) -> list[Compared]:
    """Every finger against the nearest contact of a map."""
    found = contacts(height)
    surface, result = surface_of(fingers, scene), []
    for finger in fingers:
        off = [np.hypot(c.x - finger.x, c.y - finger.y) for c in found]
        near = int(np.argmin(off)) if off else -1
        if near < 0 or off[near] > finger.radius + 2.0:
            result.append(Compared(finger, None, {}))
            continue
        result.append(Compared(finger, found[near], _scores(found[near], finger, surface)))
    return result


def surface_of(fingers: list[Finger], scene: Scene) -> Surface:
    """The sum of all dents."""
    parts = [finger.surface(scene) for finger in fingers]

    def both(x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
        z, zx, zy = (np.sum(part, axis=0) for part in zip(*(p.evaluate(x, y) for p in parts), strict=True))
        return z, zx, zy

    return Surface(lambda x, y: both(x, y)[0], lambda x, y: both(x, y)[1:], both=both)


def _moved(scene: Scene, along: float, across: float, turn: float) -> Scene:
    """The whole rig shifted along the mirror and turned about the normal in its middle."""
    rotation = Rotation.from_rotvec([0.0, 0.0, turn]).as_matrix()
    middle = np.array([0.5 * scene.mirror.length, 0.5 * scene.mirror.width, 0.0])

    def point(at: Floats) -> Floats:
        to: Floats = rotation @ (at - middle) + middle + [along, across, 0.0]
        return to

    camera, pattern = scene.camera, scene.pattern
    face = camera.face
    if face is not None:
        face = replace(face, point=point(face.point), normal=rotation @ face.normal)
    axes = {"u_axis": rotation @ camera.u_axis, "v_axis": rotation @ camera.v_axis}
    turned = {"u_axis": rotation @ pattern.u_axis, "v_axis": rotation @ pattern.v_axis}
    return replace(
        scene,
        camera=replace(camera, origin=point(camera.origin), face=face, **axes),
        pattern=replace(pattern, origin=point(pattern.origin), **turned),
    )


def captured(
    scene: Scene, surface: Surface, noise: float, rng: np.random.Generator
) -> tuple[Correspondence, Trace]:
    """Where the pixels look, with noise, and where they do."""
    truth = trace(scene, surface)
    exact = exact_correspondence(truth, noise)
    u, v = (part + noise * rng.standard_normal(part.shape) for part in (exact.u, exact.v))
    return replace(exact, u=u, v=v), truth


def _punch(scene: Scene, finger: Finger) -> Surface:
    """Flat rigid cylinder on an elastic half-space: depth inside, 2/pi depth asin(a/r) outside."""
    length, taper = scene.mirror.length, _TAPER * scene.mirror.length

    def both(x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
        dx, dy = x - finger.x, y - finger.y
        q = np.maximum(np.hypot(dx, dy) / finger.size, 1.0)
        z = finger.depth * 2 / np.pi * np.arcsin(1 / q)
        root = np.sqrt(np.maximum(q * q - 1, 1e-12))
        over_r = np.where(q > 1, -2 / np.pi * finger.depth / (finger.size * q) ** 2 / root, 0.0)
        s = np.clip((length - x) / taper, 0.0, 1.0)
        fade, fading = s**3 * (10 + s * (6 * s - 15)), -30 / taper * (s * (1 - s)) ** 2
        return z * fade, over_r * dx * fade + z * fading, over_r * dy * fade

    return Surface(lambda x, y: both(x, y)[0], lambda x, y: both(x, y)[1:], both=both)


def _scores(contact: Contact, finger: Finger, surface: Surface) -> dict[str, float]:
    """Errors over sigma of depth, area and position against the true surface."""
    reach = 10.0
    steps = np.arange(-reach, reach + _FINE, _FINE)
    x, y = np.meshgrid(finger.x + steps, finger.y + steps)
    z = surface.height(x, y)
    close = np.hypot(x - finger.x, y - finger.y) < finger.radius
    depth = float(z[close].max())
    labels, _ = scipy.ndimage.label(z > 0.5 * depth)
    middle = steps.size // 2
    half: Mask = labels == labels[middle, middle]
    area, place = np.count_nonzero(half) * _FINE**2, np.array([x[half].mean(), y[half].mean()])
    off = (np.array([contact.x, contact.y]) - place) / contact.position_sigma
    return {
        "depth": (contact.depth - depth) / contact.depth_sigma,
        "area": float(contact.area - area) / contact.area_sigma,
        "x": float(off[0]),
        "y": float(off[1]),
    }
