"""Which numbers of a scene are free, held or known with a sigma, before anything was captured."""

import math
from collections.abc import Mapping

from optolever.errors import InputError
from optolever.scene import PinholeCamera, Scene, parameter_values

__all__ = ["GAUGE", "MEANING", "default_priors", "is_pose", "plausible", "resolved"]

#: Never free: another choice moves the frame, and no height.
GAUGE = (
    "gauge: the mirror at rest (the first Rest, else the first Flat) is z = 0; the camera keeps its x and y "
    "and its turn about the mirror's normal"
)
_HELD = ("camera.x", "camera.y", "camera.rz")

#: Parameter -> what it is, and what capture tells it.
MEANING = {
    "camera.f": ("the focal length", "tilt the reference more"),
    "camera.cx": ("the lens's centre (columns)", "tilt the reference about the image's rows"),
    "camera.cy": ("the lens's centre (rows)", "tilt the reference about the image's columns"),
    "camera.z": ("the camera's distance", "add poses, or press a ball"),
    "camera.rx": ("the camera's tilt about x", "capture the mirror at rest"),
    "camera.ry": ("the camera's tilt about y", "capture the mirror at rest"),
    "camera.pitch_u": ("the pixels' pitch along columns", "press a ball"),
    "camera.pitch_v": ("the pixels' pitch along rows", "press a ball"),
    "pattern.x": ("the pattern's place along u", "capture the mirror at rest"),
    "pattern.y": ("the pattern's place along v", "capture the mirror at rest"),
    "pattern.z": ("the pattern's distance", "press a ball"),
    "pattern.rx": ("the pattern's tilt about u", "press a ball"),
    "pattern.ry": ("the pattern's tilt about v", "press a ball"),
    "pattern.rz": ("the pattern's turn in its plane", "capture the mirror at rest"),
    "pattern.pitch": ("the pattern's pitch, which is the scale", "measure the display"),
    "pattern.b20": ("the display's bow along u", "add poses"),
    "pattern.b11": ("the display's twist", "add poses"),
    "pattern.b02": ("the display's bow along v", "add poses"),
    "face.rx": ("the face's tilt", "press a ball"),
    "face.ry": ("the face's tilt", "press a ball"),
    "face.distance": ("the face's distance", "harmless: report it"),
    "face.index": ("the index of refraction", "harmless: report it"),
}

_DEGREE = math.pi / 180


def plausible(scene: Scene) -> dict[str, float]:
    """Standard deviations of a number of which nothing is known but that it is one of a rig."""
    values = parameter_values(scene)
    wide = {"x": 1e3, "y": 1e3, "z": 1e3, "rx": 1.0, "ry": 1.0, "rz": 1.0}
    wide |= {"k1": 1.0, "k2": 3.0, "p1": 0.03, "p2": 0.03, "k3": 10.0, "b20": 5.0, "b11": 5.0, "b02": 5.0}
    wide |= {"cx": 0.25 * scene.camera.cols, "cy": 0.25 * scene.camera.rows, "distance": 10.0, "index": 0.05}
    relative = {"f": 0.5, "pitch_u": 0.2, "pitch_v": 0.2, "pitch": 0.2}
    sigmas = {}
    for name, value in values.items():
        key = name.partition(".")[2]
        sigmas[name] = relative[key] * abs(value) if key in relative else wide[key]
    return sigmas


def default_priors(scene: Scene) -> dict[str, float]:
    """Name -> sigma (inf: free). In open air everything but pitch and k3 is free; a prism is known to 1
    degree, 0.5 mm, 1 % and 0.01 of index."""
    values = parameter_values(scene)
    if isinstance(scene.camera, PinholeCamera) and scene.camera.face is None and scene.medium is None:
        held = ("pattern.pitch", "camera.k3", *_HELD)
        return {name: math.inf for name in values if name not in held}
    sigmas = {"rx": _DEGREE, "ry": _DEGREE, "rz": _DEGREE, "x": 0.5, "y": 0.5, "z": 0.5, "distance": 0.5}
    known = {"index": 0.01} | {
        key: 0.01 * abs(values.get(f"camera.{key}", 0.0)) for key in ("f", "pitch_u", "pitch_v")
    }
    chosen = {}
    for name in values:
        key = name.partition(".")[2]
        if key in sigmas | known and name not in _HELD:
            chosen[name] = (sigmas | known)[key]
    if not isinstance(scene.camera, PinholeCamera):
        chosen.pop("camera.z")  # along parallel rays nothing changes, across them it is the gauge's x
    return chosen


def is_pose(name: str) -> bool:
    """Whether a number is a change of the scene's own pose."""
    return name.partition(".")[2] in ("x", "y", "z", "rx", "ry", "rz", "distance")


def resolved(scene: Scene, given: Mapping[str, float] | None) -> dict[str, float]:
    """Default priors with those given in their place; sigma inf: free, 0: held. InputError for others."""
    known, priors = parameter_values(scene), default_priors(scene)
    for name, sigma in (given or {}).items():
        if name not in known:
            raise InputError(
                f"prior {name!r}: the scene has no such number, must be one of {', '.join(known)}"
            )
        if math.isnan(sigma) or sigma < 0:
            raise InputError(f"prior {name} = {sigma}: must be at least 0 (0: held, inf: free)")
        if name in _HELD and sigma > 0:
            raise InputError(f"prior {name} = {sigma}: held by the {GAUGE}")
        priors[name] = sigma
    wide = plausible(scene)
    return {name: wide[name] if sigma == math.inf else sigma for name, sigma in priors.items() if sigma > 0}
