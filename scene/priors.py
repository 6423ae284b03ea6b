"""The covariance that every scene has: of its calibration, or of numbers that were typed."""

import numpy as np

from .accuracy import TYPED, Accuracy
from .covariance import Covariance
from .parameters import parameter_values
from .pinhole import PinholeCamera
from .scene import Scene

__all__ = ["GAUGE_HELD", "rig_covariance", "typed_covariance", "typed_sigmas"]

#: Fixed: the mirror's frame follows the camera in x, y and its turn about z; no height depends on them.
GAUGE_HELD = ("camera.x", "camera.y", "camera.rz")

_SOURCES = {
    "camera pose": ("camera.x", "camera.y", "camera.z", "camera.rx", "camera.ry", "camera.rz"),
    "camera scale": ("camera.f", "camera.pitch_u", "camera.pitch_v"),
    "lens": ("camera.cx", "camera.cy", "camera.k1"),
    "face and index": ("face.rx", "face.ry", "face.distance", "face.index"),
    "pattern pose": ("pattern.x", "pattern.y", "pattern.z", "pattern.rx", "pattern.ry", "pattern.rz"),
    "pattern pitch": ("pattern.pitch",),
    "display bow": ("pattern.b20", "pattern.b11", "pattern.b02"),
}


def rig_covariance(scene: Scene) -> Covariance | None:
    """The covariance of a scene's numbers: its calibration's, else that of typed numbers; None where the
    scene is exact.

    >>> rig_covariance(load("prism48", exact=True)) is None
    True
    """
    if scene.covariance is not None:
        return scene.covariance
    return None if scene.accuracy is None else typed_covariance(scene, scene.accuracy)


def typed_covariance(scene: Scene, accuracy: Accuracy | None = None) -> Covariance | None:
    """Independent errors of `typed_sigmas`, with their sources; None where all are 0."""
    sigmas = {name: sigma for name, sigma in typed_sigmas(scene, accuracy).items() if sigma > 0}
    if not sigmas:
        return None
    names = tuple(sigmas)
    sources = tuple(source for source, members in _SOURCES.items() if set(members) & set(names))
    parts = np.stack(
        [
            np.diag([sigmas[name] ** 2 if name in _SOURCES[source] else 0.0 for name in names])
            for source in sources
        ]
    )
    return Covariance(names, parts.sum(axis=0), sources=sources, parts=parts, gauge="typed")


def typed_sigmas(scene: Scene, accuracy: Accuracy | None = None) -> dict[str, float]:
    """Name (see `parameter_values`) -> standard deviation of a number that was typed; finite everywhere.

    Omitted: the gauge (`GAUGE_HELD`), and numbers without an effect (the distance of a telecentric camera,
    higher terms of a lens's distortion).
    """
    known = TYPED if accuracy is None else accuracy
    values = parameter_values(scene)
    by_key = {"rx": known.angle, "ry": known.angle, "rz": known.angle}
    by_key |= dict.fromkeys(("x", "y", "z", "distance"), known.distance)
    by_key |= {"index": known.index, "k1": known.distortion}
    by_key |= dict.fromkeys(("cx", "cy"), known.centre * scene.camera.cols)
    by_key |= dict.fromkeys(("b20", "b11", "b02"), known.bow)
    relative = ("f", "pitch_u", "pitch_v", "pitch")
    held = set(GAUGE_HELD)
    if not isinstance(scene.camera, PinholeCamera):
        held.add("camera.z")
    sigmas = {}
    for name, value in values.items():
        key = name.partition(".")[2]
        if name not in held and (key in by_key or key in relative):
            sigmas[name] = known.scale * abs(value) if key in relative else by_key[key]
    return sigmas
