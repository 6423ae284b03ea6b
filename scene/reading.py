"""Scenes from TOML: strict, every error names the file, the field, the value and the limit."""

import math
import tomllib
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from optolever import InputError

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
    elif not path.is_file():
        raise InputError(
            f"scene {str(path)!r}: no such file, and no preset (presets: {', '.join(preset_names())})"
        )
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, OSError) as error:
        raise InputError(f"{path}: not readable as TOML: {error}") from error
    try:
        scene = _scene(_Table("", content), path)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return replace(scene, accuracy=None, covariance=None) if exact else scene


class _Table:
    """A TOML table that hands out its values once each, and complains about what nobody asked for."""

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

    def done(self, known: str) -> None:
        for key in self._left:
            raise InputError(f"{self.field(key)} is unknown, must be one of {known}")


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
    name = top.get("name", _text, path.stem)
    dent = top.take("dent", _text) if "dent" in top else None
    mirror = _mirror(top.take("mirror", _table))
    pattern = _pattern(top.take("pattern", _table))
    medium = _medium(top.take("medium", _table)) if "medium" in top else None
    camera = _camera(top.take("camera", _table), mirror, medium)
    display = _display(top.take("display", _table)) if "display" in top else None
    sensor = _sensor(top.take("sensor", _table)) if "sensor" in top else None
    layer = _layer(top.take("layer", _table)) if "layer" in top else None
    calibrated = _calibration(top.take("calibration", _table), path) if "calibration" in top else (None, None)
    covariance, form = calibrated
    accuracy = _accuracy(top)
    for section in FOREIGN:
        top.get(section, _table, top)
    top.done(
        "name, dent, exact, mirror, pattern, camera, medium, display, sensor, layer, accuracy, calibration, "
        + ", ".join(FOREIGN)
    )
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
    values = {
        field.name: table.take(Accuracy.key(field.name), _non_negative)
        for field in fields(Accuracy)
        if Accuracy.key(field.name) in table
    }
    table.done(", ".join(TYPED.table()))
    if "angle" in values:
        values["angle"] = math.radians(values["angle"])
    return Accuracy(**values)


def _boolean(name: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise InputError(f"{name} = {value!r}: must be true or false")
    return value


def _calibration(table: _Table, path: Path) -> tuple[Covariance, RestForm | None]:
    """[calibration]: the covariance's file, beside the scene's, and the form of the mirror at rest."""
    name = table.take("covariance", _text)
    form = table.take("rest_form_mm", _form) if "rest_form_mm" in table else None
    table.done("covariance, rest_form_mm")
    return Covariance.load(path.parent / name), form


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
    length, width = table.take("size_mm", _pair)
    table.done("size_mm")
    return Mirror(float(length), float(width))


def _medium(table: _Table) -> Medium:
    index = table.take("index", positive)
    outside = table.get("outside", positive, 1.0)
    table.done("index, outside")
    return Medium(index, outside)


def _display(table: _Table) -> Display:
    gamma, black = table.get("gamma", positive, 1.0), table.get("black", _non_negative, 0.0)
    table.done("gamma, black")
    return Display(gamma, black)


def _sensor(table: _Table) -> Sensor:
    default = Sensor()
    names = tuple(Sensor.__dataclass_fields__)
    values = {name: table.get(name, lambda _, value: value, getattr(default, name)) for name in names}
    table.done(", ".join(names))
    return Sensor(**values)


def _layer(table: _Table) -> Layer:
    modulus = table.take("youngs_modulus_mpa", positive)
    poisson = table.get("poisson", number, 0.5)
    thickness = table.take("thickness_mm", positive) if "thickness_mm" in table else None
    table.done("youngs_modulus_mpa, poisson, thickness_mm")
    return Layer(modulus, poisson, thickness)


def _pattern(table: _Table) -> Pattern:
    cols, rows = table.take("size", _size)
    pitch = table.take("pitch_mm", positive)
    blur_px = table.get("blur_px", _non_negative, 0.0)
    shape = _shape(table, rows, cols)
    if "angle_deg" in table:
        angle = table.take("angle_deg", _angle)
        table.done("size, pitch_mm, blur_px, bow, table, angle_deg (which excludes an explicit pose)")
        return replace(prism_pattern(angle, rows, cols, pitch, blur_px), shape=shape)
    origin = table.take("origin_mm", vector)
    u_axis, v_axis = _axes(table)
    table.done("size, pitch_mm, blur_px, bow, table, angle_deg, origin_mm, u_axis, v_axis, rotation_deg")
    return Pattern(origin, u_axis, v_axis, pitch, rows, cols, blur_px, shape)


def _shape(table: _Table, rows: int, cols: int) -> PatternShape | None:
    """[pattern.bow] or [pattern.table]; None: flat."""
    if "bow" in table:
        bow, flat = table.take("bow", _table), Bow.of_pattern(rows, cols)
        b20, b11, b02 = (bow.get(name, number, 0.0) for name in ("b20", "b11", "b02"))
        centre, half = bow.get("centre_px", _centre, flat.centre), bow.get("half_px", _pair, flat.half)
        bow.done("b20, b11, b02, centre_px, half_px")
        return Bow(b20, b11, b02, centre, half)
    if "table" in table:
        points = table.take("table", _table)
        places, offsets = (points.take(name, _rows) for name in ("places_px", "offsets_mm"))
        points.done("places_px, offsets_mm")
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
    cols, rows = table.take("size", _size)
    face = _face(table.take("face", _table), medium) if "face" in table else None
    build = _telecentric if kind == "telecentric" else _pinhole
    return build(table, rows, cols, face, mirror)


def _telecentric(table: _Table, rows: int, cols: int, face: Face | None, mirror: Mirror) -> Camera:
    pitch = table.take("pitch_mm", _pair_or_one)
    if "angle_deg" in table:
        angle = table.take("angle_deg", _angle)
        table.done("kind, size, pitch_mm, face, angle_deg (which excludes an explicit pose)")
        return prism_camera(mirror.length, angle, rows, cols, pitch, face)
    origin = table.take("origin_mm", vector)
    u_axis, v_axis = _axes(table)
    table.done("kind, size, pitch_mm, face, angle_deg, origin_mm, u_axis, v_axis, rotation_deg")
    return TelecentricCamera(origin, u_axis, v_axis, pitch, rows, cols, face)


def _pinhole(table: _Table, rows: int, cols: int, face: Face | None, mirror: Mirror) -> Camera:
    focal = table.take("focal_px", _pair_or_one)
    centre = table.get("centre_px", _centre, np.array([0.5 * (cols - 1), 0.5 * (rows - 1)]))
    distortion = table.get("distortion", _distortion, np.zeros(5))
    position = table.take("position_mm", vector)
    if "look_at_mm" in table:
        target = table.take("look_at_mm", vector)
        row_axis = table.get("row_axis", vector, np.array([0.0, 1.0, 0.0]))
        u_axis, v_axis = look_at("camera", position, target, row_axis)
    else:
        u_axis, v_axis = _axes(table)
    intrinsic = "kind, size, focal_px, centre_px, distortion, face"
    table.done(f"{intrinsic}, position_mm, look_at_mm, row_axis, u_axis, v_axis, rotation_deg")
    return PinholeCamera(position, u_axis, v_axis, focal, centre, rows, cols, distortion, face)


def _centre(name: str, value: Any) -> Float:
    return vector(name, value, 2)


def _face(table: _Table, medium: Medium | None) -> Face:
    point, normal = table.take("point_mm", vector), table.take("normal", vector)
    index = table.take("index", positive) if medium is None else table.get("index", positive, medium.index)
    outside = table.get("outside", positive, 1.0)
    table.done("point_mm, normal, index, outside")
    return Face(point, normal, finite("camera.face.index", index), outside)
