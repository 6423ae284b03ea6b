"""Contacts on rigs that are not as typed: errors of area, depth and position over sigma.

Every number of the rig is drawn from its prior, and so is the place of the whole rig along the mirror. Rest
and press are traced on that rig; the height is reconstructed with the typed scene against the rest capture.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.ndimage
from scipy.spatial.transform import Rotation

from optolever.arrays import Floats, Mask
from optolever.decode import Correspondence
from optolever.reconstruct import Contact, HeightMap, contacts, exact_correspondence, reconstruct
from optolever.scene import (
    Scene,
    Surface,
    Trace,
    adjusted,
    dent,
    parameter_values,
    rig_covariance,
    trace,
)

__all__ = ["Compared", "Finger", "captured", "changed", "compared", "press"]

_GAUGE = (0.5, 0.5, np.radians(1.0))  # mm, mm, rad: where the whole rig stands along the mirror
_FINE = 0.05  # mm: grid of the true areas


@dataclass(frozen=True, slots=True)
class Finger:
    """One contact that fades: place, depth and sigma in mm."""

    x: float
    y: float
    depth: float
    size: float

    @property
    def radius(self) -> float:
        """Where half of the depth is left, mm."""
        return float(self.size * np.sqrt(2 * np.log(2)))


@dataclass(frozen=True, slots=True)
class Compared:
    """A finger, the contact that was found (None: none) and errors over sigma by name."""

    finger: Finger
    contact: Contact | None
    scores: dict[str, float]


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
    parts = [dent("gaussian", scene, peak=f.depth, sigma=f.size, x=f.x, y=f.y) for f in fingers]

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
