"""The same scene with another angle, index, distance, camera or pattern: what each is worth."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

from optolever.errors import InputError
from optolever.scene import (
    Medium,
    Pattern,
    Scene,
    TelecentricCamera,
    prism_camera,
    prism_pattern,
    resize,
)

from .sensor_maps import sensor_maps

__all__ = ["SWEEPS", "sweep_sensor", "varied"]

SWEEPS = ("angle", "index", "distance", "camera", "pattern")


def sweep_sensor(
    scene: Scene, name: str, values: list[float], sequence: str = "gray+phase", noise: float = 1.0
) -> Iterator[dict[str, float | str]]:
    """A row of numbers (see SensorMaps.numbers) per value; 'why' where a value makes no sensor."""
    for value in values:
        row: dict[str, float | str] = {"sweep": name, "value": value}
        numbers: dict[str, float | str]
        try:
            numbers = {**sensor_maps(varied(scene, name, value), sequence, noise).numbers()}
        except InputError as error:
            numbers = {"why": str(error)}
        yield row | numbers


def varied(scene: Scene, name: str, value: float) -> Scene:
    """The scene with one thing changed.

    angle: of both faces of a prism, degrees; its faces keep meeting at the apex, camera and pattern keep
    covering mirror and face. index: of the medium. distance: by which the pattern is moved away from the
    mirror, mm. camera, pattern: factor on the number of pixels (cells) along each side, the field stays.
    InputError names what cannot be.
    """
    if name not in _CHANGES:
        raise InputError(f"sweep: {name!r}, must be one of {', '.join(SWEEPS)}")
    if not math.isfinite(value):
        raise InputError(f"sweep: {name} is {value}, must be finite")
    return _CHANGES[name](scene, value)


def _angle(scene: Scene, value: float) -> Scene:
    camera, pattern = scene.camera, scene.pattern
    if not isinstance(camera, TelecentricCamera) or abs(pattern.v_axis[1]) < 1 - 1e-9:
        raise InputError(f"sweep: angle asks for a prism, scene {scene.name!r} is none")
    if not 5 <= value <= 85:
        raise InputError(f"sweep: angle is {value:g}, must be in 5..85 degrees")
    angle, length = math.radians(value), scene.mirror.length
    cols = max(1, math.ceil(0.5 * length / math.cos(angle) / pattern.pitch - 1e-6))
    pitch = camera.pitch.copy()
    pitch[0] = length * math.cos(angle) / camera.cols
    return replace(
        scene,
        camera=prism_camera(length, angle, camera.rows, camera.cols, pitch, camera.face),
        pattern=prism_pattern(angle, pattern.rows, cols, pattern.pitch, pattern.blur_px),
    )


def _index(scene: Scene, value: float) -> Scene:
    outside = 1.0 if scene.medium is None else scene.medium.outside
    return replace(scene, medium=Medium(value, outside))


def _distance(scene: Scene, value: float) -> Scene:
    pattern = scene.pattern
    corners = pattern.point(0.5 * (pattern.cols - 1), 0.5 * (pattern.rows - 1))
    middle = (0.5 * scene.mirror.length, 0.5 * scene.mirror.width, 0.0)
    side = float((corners - middle) @ pattern.normal)
    away = pattern.normal * math.copysign(1.0, side)
    return replace(scene, pattern=replace(pattern, origin=pattern.origin + value * away))


def _camera(scene: Scene, value: float) -> Scene:
    if value <= 0:
        raise InputError(f"sweep: camera is {value:g}, must be above 0")
    rows, cols = (max(8, round(value * n)) for n in (scene.camera.rows, scene.camera.cols))
    return replace(resize(scene, rows, cols), pattern=scene.pattern)


def _pattern(scene: Scene, value: float) -> Scene:
    if value <= 0:
        raise InputError(f"sweep: pattern is {value:g}, must be above 0")
    old = scene.pattern
    pitch = old.pitch / value
    shift = 0.5 * (pitch - old.pitch) * (old.u_axis + old.v_axis)
    rows, cols = (max(1, math.ceil(n * value - 1e-6)) for n in (old.rows, old.cols))
    finer = Pattern(old.origin + shift, old.u_axis, old.v_axis, pitch, rows, cols, old.blur_px * value)
    return replace(scene, pattern=finer)


_CHANGES: dict[str, Callable[[Scene, float], Scene]] = {
    "angle": _angle,
    "index": _index,
    "distance": _distance,
    "camera": _camera,
    "pattern": _pattern,
}
