"""The covariance that every scene has: of its calibration, or of numbers that were typed."""

import numpy as np

from .accuracy import TYPED, Accuracy
from .cameras import TelecentricCamera
from .covariance import Covariance
from .parameters import parameter_values
from .scene import Scene

__all__ = ["GAUGE_HELD", "rig_covariance", "typed_covariance", "typed_sigmas"]

#: Fixed: the mirror's frame follows the camera in x, y and its turn about z; no height depends on them.
GAUGE_HELD = ("camera.x", "camera.y", "camera.rz")

#: Sources of error: field of Accuracy -> the numbers that it holds for.
_SOURCES: dict[str, tuple[tuple[str, str], ...]] = {
    "camera pose": (("distance", "camera.x camera.y camera.z"), ("angle", "camera.rx camera.ry camera.rz")),
    "camera scale": (("scale", "camera.pitch_u camera.pitch_v"),),
    "focal length": (("focal", "camera.f"),),
    "lens": (("centre", "camera.cx camera.cy"), ("distortion", "camera.k1")),
    "face and index": (("angle", "face.rx face.ry"), ("distance", "face.distance"), ("index", "face.index")),
    "pattern pose": (
        ("distance", "pattern.x pattern.y pattern.z"),
        ("angle", "pattern.rx pattern.ry pattern.rz"),
    ),
    "pattern pitch": (("scale", "pattern.pitch"),),
    "display bow": (("bow", "pattern.b20 pattern.b11 pattern.b02"),),
}
#: Number -> source, field of Accuracy.
_TYPED = {
    name: (source, field)
    for source, parts in _SOURCES.items()
    for field, names in parts
    for name in names.split()
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
    own = np.array([_TYPED[name][0] for name in sigmas])
    variances = np.diag(np.square([*sigmas.values()]))
    sources = tuple(source for source in _SOURCES if source in own)
    parts = np.stack([np.where(own == source, variances, 0.0) for source in sources])
    return Covariance(tuple(sigmas), variances, sources=sources, parts=parts, gauge="typed")


def typed_sigmas(scene: Scene, accuracy: Accuracy | None = None) -> dict[str, float]:
    """Name (see `parameter_values`) -> standard deviation of a number that was typed; finite everywhere.

    Omitted: the gauge (`GAUGE_HELD`), and numbers without an effect (the distance of a telecentric camera,
    higher terms of a lens's distortion).
    """
    known = TYPED if accuracy is None else accuracy
    telecentric = isinstance(scene.camera, TelecentricCamera)
    held = {*GAUGE_HELD, "camera.z"} if telecentric else set(GAUGE_HELD)
    sigmas = {}
    for name, value in parameter_values(scene).items():
        if name in _TYPED and name not in held:
            field = _TYPED[name][1]
            units = {"scale": abs(value), "focal": abs(value), "centre": float(scene.camera.cols)}
            stated = getattr(known, field)
            sigmas[name] = (known.scale if stated is None else stated) * units.get(field, 1.0)
    return sigmas
