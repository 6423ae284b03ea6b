"""Scenes from TOML: strict, every error names the file, the field, the value and the limit."""

import math
from collections.abc import Callable
from dataclasses import MISSING, fields, replace
from datetime import date
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from optolever import InputError
from optolever.toml import read_toml

from .accuracy import TYPED, Accuracy
from .covariance import Covariance
from .dents import dent_from_text
from .face import Face
from .layer import Layer
from .medium import Medium
from .mirror import Mirror
from .parameters import parameter_values
from .pattern import Pattern, prism_pattern
from .pattern_shape import Bow, PatternShape, PointTable
from .pinhole import PinholeCamera
from .pose import look_at, rotation_from_vector
from .record import Float, finite, integer, number, positive, vector
from .rest_form import RestForm
from .scene import Camera, Scene
from .sensor import Display, Sensor
from .telecentric import TelecentricCamera, prism_camera
from .writing import FOREIGN

__all__ = ["load", "preset_names"]

_TOP = "name, dent, exact, mirror, pattern, camera, medium, display, sensor, layer, accuracy, calibration, "
#: Keys that others call so, and ours.
_MEANT = {
    "n": "index",
    "ior": "index",
    "refractive_index": "index",
    "f": "focal_px",
    "f_px": "focal_px",
    "f_mm": "focal_mm",
    "focal_length": "focal_mm",
    "focal_length_mm": "focal_mm",
    "pixel_size_mm": "pixel_pitch_mm",
    "pitch_mm": "pixel_pitch_mm",
    "resolution": "size",
    "target": "look_at_mm",
    "tilt_deg": "angle_deg",
}
#: mm between cells of a display: those of microdisplays are 0.0025 mm apart.
_LEAST_PITCH = 1e-3
_PRESETS = Path(__file__).parent / "presets"
T = TypeVar("T")


def preset_names() -> tuple[str, ...]:
    """Names of the scenes that come with the package."""
    return tuple(sorted(path.stem for path in _PRESETS.glob("*.toml")))


def load(preset_or_path: str | Path, *, exact: bool = False) -> Scene:
    """The preset of that name, or the scene in that TOML file; InputError if there is none, or a bad one.

    exact: take the numbers as exact, as in simulations; else their errors are those of the file's
    calibration, or of typed numbers (`Accuracy`).

    >>> load("prism48").mirror
    Mirror(length=60.0, width=45.0)
    """
    path = Path(preset_or_path)
    if str(preset_or_path) in preset_names():
        path = _PRESETS / f"{preset_or_path}.toml"
    elif not path.exists():
        raise InputError(
            f"scene {str(path)!r}: no such file, and no preset (presets: {', '.join(preset_names())})"
        )
    content = read_toml(path)
    try:
        scene = _scene(_Table("", content), path)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return replace(scene, accuracy=None, covariance=None) if exact else scene


class _Table:
    """A TOML table that hands out its values once each, and rejects keys that remain."""

    def __init__(self, name: str, content: dict[str, Any]) -> None:
        self.name = name
        self._left = dict(content)

    def __contains__(self, key: str) -> bool:
        return key in self._left

    def field(self, key: str) -> str:
        return f"{self.name}.{key}" if self.name else key

    def take(self, key: str, check: Callable[[str, Any], T]) -> T:
        if key not in self._left:
            raise InputError(f"{self.field(key)} is missing, must be given")
        return check(self.field(key), self._left.pop(key))

    def get(self, key: str, check: Callable[[str, Any], T], default: T) -> T:
        return self.take(key, check) if key in self else default

    def known(self, names: str) -> None:
        """InputError if there is a key of another name; it suggests a similar one, if any."""
        known = names.split(", ")
        for key in self._left:
            if key not in known:
                meant = _MEANT.get(key) if _MEANT.get(key) in known else _resembling(key, known)
                must = self.field(meant) if meant else f"one of {names}"
                raise InputError(f"{self.field(key)} is unknown, must be {must}")

    def done(self, why: str = "") -> None:
        """InputError if a key remains."""
        for key in self._left:
            raise InputError(f"{self.field(key)}: {why}; leave it out")


def _resembling(key: str, known: list[str]) -> str | None:
    """The known key that begins so (a unit is missing), or is spelled most like it."""
    longer = [name for name in known if name.startswith(f"{key}_")]
    return next(iter(longer or get_close_matches(key, known, 1)), None)


def _text(name: str, value: Any) -> str:
    if not isinstance(value, str) or not value:
        raise InputError(f"{name} = {value!r}: must be a text that is not empty")
    return value


def _table(name: str, value: Any) -> _Table:
    if not isinstance(value, dict):
        raise InputError(f"{name} = {value!r}: must be a table")
    return _Table(name, value)


def _angle(name: str, value: Any) -> float:
    """An angle in degrees between 0 and 90, in rad."""
    return math.radians(positive(name, value, below=90))


def _size(name: str, value: Any) -> tuple[int, int]:
    """[cols, rows]."""
    if not isinstance(value, list) or len(value) != 2:
        raise InputError(f"{name} = {value!r}: must be [columns, rows]")
    return integer(name, value[0]), integer(name, value[1])


def _pair(name: str, value: Any) -> Float:
    """Two numbers greater than 0."""
    pair = vector(name, value, 2)
    for component in pair:
        positive(name, float(component))
    return pair


def _pair_or_one(name: str, value: Any) -> Float:
    return _pair(name, value) if isinstance(value, list) else _pair(name, [value, value])


def _distortion(name: str, value: Any) -> Float:
    return vector(name, value, 5)


def _non_negative(name: str, value: Any) -> float:
    return positive(name, value, zero=True)


def _scene(top: _Table, path: Path) -> Scene:
    top.known(_TOP + ", ".join(FOREIGN))
    name = top.get("name", _text, path.stem)
    dent = top.take("dent", _text) if "dent" in top else None
    mirror = _mirror(top.take("mirror", _table))
    pattern = _pattern(top.take("pattern", _table))
    medium = _record(top.take("medium", _table), Medium) if "medium" in top else None
    camera = _camera(top.take("camera", _table), mirror, medium)
    display = _record(top.take("display", _table), Display) if "display" in top else None
    sensor = _record(top.take("sensor", _table), Sensor) if "sensor" in top else None
    layer = _record(top.take("layer", _table), Layer) if "layer" in top else None
    calibrated = _calibration(top.take("calibration", _table), path) if "calibration" in top else (None, None)
    covariance, form = calibrated
    accuracy = _accuracy(top)
    for section in FOREIGN:
        top.get(section, _table, top)
    scene = Scene(
        name, mirror, pattern, camera, medium, display, sensor, dent, covariance, accuracy, form, layer
    )
    if covariance is not None:
        _require_known(scene, covariance)
    if dent is not None:
        dent_from_text(dent, scene)
    return scene


def _accuracy(top: _Table) -> Accuracy | None:
    """[accuracy], or None where `exact = true`."""
    exact = top.get("exact", _boolean, False)
    if "accuracy" not in top:
        return None if exact else TYPED
    if exact:
        raise InputError("exact = true: excludes [accuracy]; leave one of both out")
    table = top.take("accuracy", _table)
    table.known(", ".join(TYPED.table()))
    values = {
        field.name: table.take(Accuracy.key(field.name), _non_negative)
        for field in fields(Accuracy)
        if Accuracy.key(field.name) in table
    }
    if "angle" in values:
        values["angle"] = math.radians(values["angle"])
    return Accuracy(**values)


def _boolean(name: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise InputError(f"{name} = {value!r}: must be true or false")
    return value


def _calibration(table: _Table, path: Path) -> tuple[Covariance, RestForm | None]:
    """[calibration]: the covariance's file, next to the scene's, and the form of the mirror at rest."""
    table.known("covariance, date, rest_form_mm")
    name = table.take("covariance", _text)
    form = table.take("rest_form_mm", _form) if "rest_form_mm" in table else None
    day = table.get("date", _day, "")
    return replace(Covariance.load(path.parent / name), date=day), form


def _day(name: str, value: Any) -> str:
    """A date of TOML as text."""
    if type(value) is not date:
        raise InputError(f"{name} = {value!r}: must be a date, such as 2026-11-28")
    return value.isoformat()


def _form(name: str, value: Any) -> RestForm:
    if not isinstance(value, list):
        raise InputError(f"{name} = {value!r}: must be a list of numbers (mm)")
    return RestForm(np.array([number(name, each) for each in value]))


def _require_known(scene: Scene, covariance: Covariance) -> None:
    known = parameter_values(scene)
    for name in covariance.names:
        if name not in known:
            raise InputError(f"calibration: the scene has no number {name!r}")


def _mirror(table: _Table) -> Mirror:
    table.known("size_mm")
    length, width = table.take("size_mm", _pair)
    return Mirror(float(length), float(width))


def _record(table: _Table, kind: type[T]) -> T:
    """A table whose keys are a record's fields: the record checks their values."""
    defaults = {field.name: field.default for field in fields(kind)}  # type: ignore[arg-type]
    table.known(", ".join(defaults))
    given = [name for name, default in defaults.items() if name in table or default is MISSING]
    return kind(**{name: table.take(name, lambda _, value: value) for name in given})


def _pattern(table: _Table) -> Pattern:
    surface, pose = "size, pitch_mm, blur_px, bow, table", "origin_mm, u_axis, v_axis, rotation_deg"
    table.known(f"{surface}, angle_deg, offset_mm, {pose}")
    cols, rows = table.take("size", _size)
    pitch, tall = table.take("pitch_mm", _pair_or_one)
    if min(pitch, tall) < _LEAST_PITCH:
        raise InputError(
            f"pattern.pitch_mm = {min(pitch, tall):g}: must be at least {_LEAST_PITCH:g} mm; lengths are in "
            "millimetres, multiply metres by 1000"
        )
    aspect = tall / pitch
    blur_px = table.get("blur_px", _non_negative, 0.0)
    shape = _shape(table, rows, cols)
    if "angle_deg" in table:
        angle = table.take("angle_deg", _angle)
        along, across = table.get("offset_mm", _offset, np.zeros(2))
        table.done("angle_deg excludes an explicit pose")
        flat = prism_pattern(angle, rows, cols, pitch, blur_px, aspect)
        origin = flat.origin + along * flat.u_axis + across * flat.v_axis
        return replace(flat, origin=origin, shape=shape)
    if "origin_mm" not in table:
        raise InputError(
            "pattern.origin_mm is missing, must be given with axes; on a prism: angle_deg in their place"
        )
    origin = table.take("origin_mm", vector)
    u_axis, v_axis = _axes(table)
    table.done("belongs to angle_deg; an explicit pose excludes it")
    return Pattern(origin, u_axis, v_axis, pitch, rows, cols, blur_px, shape, aspect)


def _offset(name: str, value: Any) -> Float:
    """Along the face from the mirror's edge, and across (mm); one number: along it."""
    return vector(name, value if isinstance(value, list) else [value, 0.0], 2)


def _shape(table: _Table, rows: int, cols: int) -> PatternShape | None:
    """[pattern.bow] or [pattern.table]; None: flat."""
    if "bow" in table:
        bow, flat = table.take("bow", _table), Bow.of_pattern(rows, cols)
        bow.known("b20, b11, b02, centre_px, half_px")
        b20, b11, b02 = (bow.get(name, number, 0.0) for name in ("b20", "b11", "b02"))
        centre, half = bow.get("centre_px", _centre, flat.centre), bow.get("half_px", _pair, flat.half)
        return Bow(b20, b11, b02, centre, half)
    if "table" in table:
        points = table.take("table", _table)
        points.known("places_px, offsets_mm")
        places, offsets = (points.take(name, _rows) for name in ("places_px", "offsets_mm"))
        return PointTable(places, offsets)
    return None


def _rows(name: str, value: Any) -> Float:
    """A list of lists of numbers, all of one length."""
    try:
        return np.array(value, dtype=np.float64)
    except (ValueError, TypeError) as error:
        raise InputError(f"{name}: must be a list of lists of numbers, all of one length") from error


def _axes(table: _Table) -> tuple[Float, Float]:
    """Axes u, v, given as such or by a rotation vector in degrees (it turns the mirror's axes into them)."""
    if "rotation_deg" in table:
        rotation = rotation_from_vector(np.radians(table.take("rotation_deg", vector)))
        return rotation[:, 0], rotation[:, 1]
    return table.take("u_axis", vector), table.take("v_axis", vector)


def _camera(table: _Table, mirror: Mirror, medium: Medium | None) -> Camera:
    kind = table.get("kind", _text, "telecentric")
    if kind not in ("telecentric", "pinhole"):
        raise InputError(f"camera.kind = {kind!r}: must be 'telecentric' or 'pinhole'")
    for key in _PINHOLE.split(", "):
        if kind == "telecentric" and key in table:
            raise InputError(f"camera.{key}: is of kind = 'pinhole', camera.kind is 'telecentric' (default)")
    table.known(f"kind, size, face, {_TELECENTRIC if kind == 'telecentric' else _PINHOLE}, {_POSE}")
    cols, rows = table.take("size", _size)
    face = _face(table.take("face", _table), mirror, medium) if "face" in table else None
    build = _telecentric if kind == "telecentric" else _pinhole
    return build(table, rows, cols, face, mirror)


_TELECENTRIC = "pitch_mm, angle_deg, origin_mm"
_PINHOLE = "focal_px, focal_mm, pixel_pitch_mm, centre_px, distortion"
_POSE = "position_mm, look_at_mm, row_axis, u_axis, v_axis, rotation_deg"


def _telecentric(table: _Table, rows: int, cols: int, face: Face | None, mirror: Mirror) -> Camera:
    pitch = table.take("pitch_mm", _pair_or_one)
    if "angle_deg" in table:
        angle = table.take("angle_deg", _angle)
        table.done("angle_deg excludes an explicit pose")
        return prism_camera(mirror.length, angle, rows, cols, pitch, face)
    if "position_mm" in table or "look_at_mm" in table:
        position = table.take("position_mm", vector)
        u_axis, v_axis = _direction(table, position)
        half = 0.5 * pitch * np.array([cols - 1, rows - 1])
        origin = position - half[0] * u_axis - half[1] * v_axis
    else:
        origin = table.take("origin_mm", vector)
        u_axis, v_axis = _axes(table)
    table.done("position_mm with look_at_mm, or origin_mm with axes, say it all")
    return TelecentricCamera(origin, u_axis, v_axis, pitch, rows, cols, face)


def _pinhole(table: _Table, rows: int, cols: int, face: Face | None, mirror: Mirror) -> Camera:
    focal = _focal(table)
    centre = table.get("centre_px", _centre, np.array([0.5 * (cols - 1), 0.5 * (rows - 1)]))
    distortion = table.get("distortion", _distortion, np.zeros(5))
    position = table.take("position_mm", vector)
    u_axis, v_axis = _direction(table, position)
    table.done("look_at_mm with row_axis, or axes, say it all")
    return PinholeCamera(position, u_axis, v_axis, focal, centre, rows, cols, distortion, face)


def _focal(table: _Table) -> Float:
    """Focal length in pixels (column, row): given so, or in mm with the pitch of the sensor's pixels."""
    if "focal_mm" not in table and "pixel_pitch_mm" not in table:
        return table.take("focal_px", _pair_or_one)
    focal, pitch = table.take("focal_mm", positive), table.take("pixel_pitch_mm", _pair_or_one)
    if "focal_px" in table:
        raise InputError("camera.focal_px: excludes focal_mm with pixel_pitch_mm; leave one of both out")
    return np.asarray(focal / pitch)


def _direction(table: _Table, position: Float) -> tuple[Float, Float]:
    """Axes u, v of a camera at a position: by its target, or given."""
    if "look_at_mm" not in table:
        if not any(key in table for key in ("u_axis", "v_axis", "rotation_deg")):
            raise InputError(
                "camera.look_at_mm is missing, must be given (or u_axis and v_axis, or rotation_deg)"
            )
        return _axes(table)
    target = table.take("look_at_mm", vector)
    row_axis = table.get("row_axis", vector, np.array([0.0, 1.0, 0.0]))
    return look_at("camera", position, target, row_axis)


def _centre(name: str, value: Any) -> Float:
    return vector(name, value, 2)


def _face(table: _Table, mirror: Mirror, medium: Medium | None) -> Face:
    """[camera.face]: by a point and its normal, or by its angle with the mirror at the edge x = L0."""
    table.known("angle_deg, point_mm, normal, index, outside")
    if "angle_deg" in table:
        angle = table.take("angle_deg", _angle)
        point, normal = np.array([mirror.length, 0, 0]), np.array([math.sin(angle), 0, math.cos(angle)])
    else:
        point, normal = table.take("point_mm", vector), table.take("normal", vector)
    index = table.take("index", positive) if medium is None else table.get("index", positive, medium.index)
    outside = table.get("outside", positive, 1.0)
    table.done("angle_deg excludes it")
    return Face(point, normal, finite("camera.face.index", index), outside)
