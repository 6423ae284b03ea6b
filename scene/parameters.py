"""The numbers of a scene that a calibration adjusts, by name; a scene with other ones; their covariance.

Intrinsic numbers (focal length, pitches, bow, index) and the form of the mirror at rest are values; poses are
changes relative to the scene's: the camera's and the face's in the mirror's axes, the pattern's in its axes
about its middle. mm, rad.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from optolever import InputError

from .cameras import Camera, Face, PinholeCamera, TelecentricCamera
from .covariance import TYPED, Accuracy, Covariance
from .fields import Float, changed, positive
from .mirror import RestForm
from .pattern import Bow, Pattern
from .pose import rotate, rotation_from_vector
from .scene import Scene

__all__ = [
    *("GAUGE_HELD", "adjusted", "parameter_changes", "parameter_values", "rig_covariance"),
    *("shifted", "typed_covariance", "typed_sigmas", "without_rest_form"),
]

_LENS = ("k1", "k2", "p1", "p2", "k3")
_BOW = ("b20", "b11", "b02")
_INTRINSIC = {f"camera.{name}" for name in ("f", "cx", "cy", *_LENS, "pitch_u", "pitch_v")}
_MOST = 1e9  # mm: scenes go no further
_POSE = ("x", "y", "z", "rx", "ry", "rz")
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


def parameter_values(scene: Scene) -> dict[str, float]:
    """All names that `adjusted` takes for this scene, with the scene's values."""
    camera, pattern = scene.camera, scene.pattern
    values = {f"camera.{name}": 0.0 for name in _POSE}
    if isinstance(camera, PinholeCamera):
        values |= {"camera.f": camera.focal[0], "camera.cx": camera.centre[0], "camera.cy": camera.centre[1]}
        values |= {f"camera.{name}": value for name, value in zip(_LENS, camera.distortion, strict=True)}
    else:
        values |= {"camera.pitch_u": camera.pitch[0], "camera.pitch_v": camera.pitch[1]}
    if camera.face is not None:
        values |= {"face.rx": 0.0, "face.ry": 0.0, "face.distance": 0.0, "face.index": camera.face.index}
    values |= {f"pattern.{name}": 0.0 for name in _POSE} | {"pattern.pitch": pattern.pitch}
    if pattern.shape is None or isinstance(pattern.shape, Bow):
        values |= {
            f"pattern.{name}": 0.0 if pattern.shape is None else getattr(pattern.shape, name) for name in _BOW
        }
    if scene.rest_form is not None:
        values |= {f"rest.{name}": value for name, value in scene.rest_form.values.items()}
    return {name: float(value) for name, value in values.items()}


def adjusted(scene: Scene, values: Mapping[str, float], known: Mapping[str, float] | None = None) -> Scene:
    """The scene with these numbers; InputError for names that it does not have. known: its
    `parameter_values`, if they are at hand. Parts whose numbers stay are the same ones.

    >>> rig = load("prism48")
    >>> moved = adjusted(rig, {"pattern.z": 0.5})  # mm, along the pattern's normal
    >>> round(float((moved.pattern.origin - rig.pattern.origin) @ rig.pattern.normal), 6)
    0.5
    """
    known = parameter_values(scene) if known is None else known
    for name, value in values.items():
        if name not in known:
            raise InputError(f"parameter {name!r}: the scene has none, must be one of {', '.join(known)}")
        if not abs(value) <= _MOST:
            raise InputError(f"parameter {name!r} = {value}: must be finite, at most {_MOST:g}")
    found = shifted(scene, values, known)
    if any(values[name] != known[name] for name in _INTRINSIC & values.keys()):
        return changed(found, camera=replace(found.camera))  # whose lens folds nowhere
    return found


def shifted(scene: Scene, values: Mapping[str, float], known: Mapping[str, float]) -> Scene:
    """`adjusted` by small steps, as of derivatives, without its checks."""
    moved = {name for name, value in values.items() if value != known[name]}
    every = {**known, **values}
    camera, pattern, form = scene.camera, scene.pattern, scene.rest_form
    if form is not None and any(name.startswith("rest.") for name in moved):
        form = RestForm(np.array([every[f"rest.{name}"] for name in form.values]))
    if any(name.startswith(("camera.", "face.")) for name in moved):
        camera = _camera(camera, every)
    if any(name.startswith("pattern.") for name in moved):
        pattern = _pattern(pattern, every)
    return changed(scene, camera=camera, pattern=pattern, rest_form=form)


def without_rest_form(scene: Scene) -> Scene:
    """The scene whose heights are those above the mirror at rest: without its form, and without the form's
    part of the covariance."""
    known = scene.covariance
    if scene.rest_form is None or known is None:
        return replace(scene, rest_form=None)
    kept = [k for k, name in enumerate(known.names) if not name.startswith("rest.")]
    some = np.ix_(kept, kept)
    parts = None if known.parts is None else known.parts[:, kept][:, :, kept]
    names = tuple(known.names[k] for k in kept)
    covariance = replace(known, names=names, matrix=known.matrix[some], parts=parts)
    return replace(scene, rest_form=None, covariance=covariance)


def parameter_changes(scene: Scene, other: Scene) -> dict[str, float]:
    """Changes with which `adjusted` turns this scene into the other; both have the same parts."""
    from scipy.spatial.transform import Rotation  # which takes a fifth of a second to load

    values = parameter_values(other)
    one, two = scene.camera, other.camera
    turn = two.rotation @ one.rotation.T
    poses = {"camera": (two.origin - one.origin, Rotation.from_matrix(turn).as_rotvec())}
    axes, (middle, moved) = scene.pattern.rotation.T, (_middle(each.pattern) for each in (scene, other))
    turn = axes @ other.pattern.rotation
    poses["pattern"] = axes @ (moved - middle), Rotation.from_matrix(turn).as_rotvec()
    for part, pose in poses.items():
        values |= {f"{part}.{n}": float(v) for n, v in zip(_POSE, np.concatenate(pose), strict=True)}
    if one.face is not None and two.face is not None:
        away = (two.face.point - one.face.point) @ two.face.normal / (one.face.normal @ two.face.normal)
        sine = np.cross(one.face.normal, two.face.normal)
        size = float(np.linalg.norm(sine))
        about = sine * (np.arcsin(size) / size if size else 1.0)
        first, second = _tilt_axes(one.face)
        tilts = {"face.rx": about @ first, "face.ry": about @ second, "face.distance": away}
        values |= {name: float(value) for name, value in tilts.items()}
    return values


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


def _turn(values: Mapping[str, float], part: str) -> tuple[Float, Float]:
    """Shift (3,) and rotation vector (3,) of a part."""
    pose = np.array([values[f"{part}.{name}"] for name in _POSE])
    return pose[:3], pose[3:]


def _camera(camera: Camera, values: Mapping[str, float]) -> Camera:
    shift, turn = _turn(values, "camera")
    rotation = rotation_from_vector(turn)
    posed: dict[str, Any] = {
        "origin": camera.origin + shift,
        "u_axis": rotate(rotation, camera.u_axis),
        "v_axis": rotate(rotation, camera.v_axis),
        "face": None if camera.face is None else _face(camera.face, values),
    }
    if isinstance(camera, PinholeCamera):
        posed["focal"] = camera.focal * (values["camera.f"] / camera.focal[0])
        posed["centre"] = np.array([values["camera.cx"], values["camera.cy"]])
        posed["distortion"] = np.array([values[f"camera.{name}"] for name in _LENS])
    else:
        posed["pitch"] = np.array([values["camera.pitch_u"], values["camera.pitch_v"]])
    return changed(camera, **posed)


def _face(face: Face, values: Mapping[str, float]) -> Face:
    """Turned about its point in two axes of its plane (the mirror's y, and across it), moved along its
    normal."""
    first, second = _tilt_axes(face)
    rotation = rotation_from_vector(values["face.rx"] * first + values["face.ry"] * second)
    return changed(
        face,
        point=face.point + values["face.distance"] * face.normal,
        normal=rotate(rotation, face.normal),
        index=positive("face.index", values["face.index"]),
    )


def _tilt_axes(face: Face) -> tuple[Float, Float]:
    first = np.cross([0.0, 1.0, 0.0], face.normal)
    first = first / np.linalg.norm(first) if np.linalg.norm(first) > 1e-9 else np.array([1.0, 0.0, 0.0])
    return first, np.cross(face.normal, first)


def _half(pattern: Pattern) -> Float:
    return 0.5 * np.array([pattern.cols - 1, pattern.rows - 1])


def _middle(pattern: Pattern) -> Float:
    cols, rows = pattern.pitch * _half(pattern) * [1.0, pattern.aspect]
    middle: Float = pattern.origin + cols * pattern.u_axis + rows * pattern.v_axis
    return middle


@lru_cache(maxsize=4)
def _flat(rows: int, cols: int) -> Bow:
    return Bow.of_pattern(rows, cols)


def _pattern(pattern: Pattern, values: Mapping[str, float]) -> Pattern:
    (shift, turn), half, middle = _turn(values, "pattern"), _half(pattern), _middle(pattern)
    pitch = values["pattern.pitch"]
    if pitch != pattern.pitch:
        pitch = positive("pattern.pitch", pitch)
    shape = pattern.shape
    if "pattern.b20" in values:
        bow = {name: values[f"pattern.{name}"] for name in _BOW}
        if isinstance(shape, Bow) or any(bow.values()):
            shape = changed(shape if isinstance(shape, Bow) else _flat(pattern.rows, pattern.cols), **bow)
    axes = pattern.rotation.T
    rotation = rotation_from_vector(turn @ axes)
    u_axis, v_axis = rotate(rotation, pattern.u_axis), rotate(rotation, pattern.v_axis)
    origin = middle + shift @ axes - pitch * (half[0] * u_axis + half[1] * pattern.aspect * v_axis)
    return changed(pattern, origin=origin, u_axis=u_axis, v_axis=v_axis, pitch=pitch, shape=shape)
