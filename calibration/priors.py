"""Priors of a scene's parameters before any capture: free, fixed, or known with a sigma."""

import math
from collections.abc import Mapping
from dataclasses import fields, replace

from optolever.errors import InputError
from optolever.scene import GAUGE_HELD, TYPED, Accuracy, Scene, parameter_values, typed_sigmas

__all__ = ["GAUGE", "default_priors", "is_pose", "plausible", "resolved", "unused_accuracy"]

#: Parameters that are never free: another choice moves the frame, but no height.
GAUGE = (
    "z = 0 is the mirror of the first capture at rest, else of the first flat; x, y and the turn about its "
    "normal are those of the typed camera"
)


def plausible(scene: Scene) -> dict[str, float]:
    """Standard deviations of parameters of any plausible rig, for free parameters."""
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
    """Name -> sigma, finite. In open air every parameter but pitch and k3 is free within `plausible`. Of a
    prism the sigmas are those of typed values (`scene.typed_sigmas`) and of `_lens` for the lens at its face;
    display pitch and bow are fixed. A lens whose accuracy the scene states has that one; so has the display's
    bow."""
    wide, stated = plausible(scene), _stated(scene)
    typed = typed_sigmas(scene, scene.accuracy)
    own = {
        name: typed[name]
        for field, names in _OF_FIELD.items()
        for name in names
        if field in stated and name in typed and typed[name] > 0
    }
    if scene.open_air:
        held = ("pattern.pitch", "camera.k3", *GAUGE_HELD)
        return {name: sigma for name, sigma in wide.items() if name not in held} | own
    sigmas = typed | _lens(scene) | own
    display = {"pattern.pitch", "pattern.b20", "pattern.b11", "pattern.b02"} - {*own}
    return {name: sigmas[name] for name in wide if name in sigmas and name not in display}


#: Field of Accuracy -> numbers that it holds for where the scene states it; elsewhere their default is wider.
_OF_FIELD = {
    "scale": ("camera.f",),
    "focal": ("camera.f",),
    "centre": ("camera.cx", "camera.cy"),
    "distortion": ("camera.k1",),
    "bow": ("pattern.b20", "pattern.b11", "pattern.b02"),
}


def _stated(scene: Scene) -> set[str]:
    """Fields of the scene's accuracy that are not those of a rig set up by hand."""
    known = scene.accuracy or TYPED
    return {each.name for each in fields(Accuracy) if getattr(known, each.name) != getattr(TYPED, each.name)}


def unused_accuracy(scene: Scene) -> list[str]:
    """A line for each number of [accuracy] that is stated, and has no effect on a calibration."""
    later = "reconstruct uses it"
    why = dict.fromkeys(("glass", "centroid"), later) | {"sag": f"rest:ORDER,SIGMA states it; {later}"}
    if scene.open_air:
        free = "the captures determine these numbers; to hold one: calibrate --prior camera.z=0.1"
        why |= {"angle": free, "distance": free}
    known, priors = scene.accuracy or TYPED, default_priors(scene)
    default = {name: replace(known, **{name: getattr(TYPED, name)}) for name in _stated(scene)}
    unused = [n for n, other in default.items() if default_priors(replace(scene, accuracy=other)) == priors]
    none = "the scene has no number of that kind"
    return [f"calibrate does not use {name} of [accuracy]: {why.get(name, none)}" for name in sorted(unused)]


def _lens(scene: Scene) -> dict[str, float]:
    """Priors of an uncalibrated lens: webcams have k1 of -0.3 to 0.1, a principal point within some per cent
    of the image's centre, and a decentering of 0.001."""
    off = max(10.0, 0.02 * max(scene.camera.rows, scene.camera.cols))  # px
    sigmas = {"cx": off, "cy": off, "k1": 0.2, "k2": 0.1, "p1": 1e-3, "p2": 1e-3}
    return {f"camera.{key}": sigma for key, sigma in sigmas.items()}


def is_pose(name: str) -> bool:
    """Whether a parameter is part of a pose in the scene."""
    return name.partition(".")[2] in ("x", "y", "z", "rx", "ry", "rz", "distance")


def resolved(scene: Scene, given: Mapping[str, float] | None) -> dict[str, float]:
    """Default priors, replaced by the given ones; sigma inf: free, 0: fixed. InputError for other values."""
    known, priors = parameter_values(scene), default_priors(scene)
    for name, sigma in (given or {}).items():
        if name not in known:
            raise InputError(
                f"prior {name!r}: the scene has no such number, must be one of {', '.join(known)}"
            )
        if math.isnan(sigma) or sigma < 0:
            raise InputError(f"prior {name} = {sigma}: must be at least 0 (0: held, inf: free)")
        if name in GAUGE_HELD and sigma > 0:
            raise InputError(f"prior {name} = {sigma}: must be 0; {GAUGE}")
        priors[name] = sigma
    wide = plausible(scene)
    return {name: wide[name] if sigma == math.inf else sigma for name, sigma in priors.items() if sigma > 0}
