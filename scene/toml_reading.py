"""A rig's TOML: strict, every error names the file, the field, the value and the limit. Sections of other
parts (`scene.FOREIGN`) are skipped on reading and kept on writing.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import MISSING, replace
from datetime import date
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from optolever import InputError
from optolever.files import atomic_file, latest
from optolever.schema import checked
from optolever.toml import read_toml, toml_text

from .cameras import Camera, Face, PinholeCamera, TelecentricCamera, prism_camera
from .covariance import TYPED, Accuracy, Covariance
from .dents import dent_from_text
from .fields import Float, Record, declared, number, pair, positive, text, vector
from .mirror import Layer, Medium, Mirror, RestForm
from .parameters import parameter_values
from .pattern import Bow, Pattern, PointTable, prism_pattern
from .pose import look_at, rotation_from_vector
from .scene import FOREIGN, Scene
from .sensor import Display, Sensor

__all__ = ["load", "preset_names", "rig_table", "write_sections"]

#: Keys that others call so, and ours.
_MEANT = {
    **dict.fromkeys(("n", "ior", "refractive_index"), "index"),
    **dict.fromkeys(("f", "f_px"), "focal_px"),
    **dict.fromkeys(("f_mm", "focal_length", "focal_length_mm"), "focal_mm"),
    **dict.fromkeys(("pixel_size_mm", "pitch_mm"), "pixel_pitch_mm"),
    "resolution": "size",
    "target": "look_at_mm",
    "tilt_deg": "angle_deg",
}
#: Keys that may stand in place of one.
_INSTEAD = {
    "mirror": "; optolever rig new writes a scene",
    "origin_mm": " with axes (or, on a prism's face, angle_deg)",
    "u_axis": " (or rotation_deg, of a camera look_at_mm, on a prism's face angle_deg)",
}
_PINHOLE = ("focal_px", "focal_mm", "pixel_pitch_mm", "centre_px", "distortion")
#: mm between cells of a display: those of microdisplays are 0.0025 mm apart.
_LEAST_PITCH = 1e-3
_LARGEST = 1e4  # mm, of a display: walls that mirrors of power plants are measured by
_PRESETS = Path(__file__).parent / "presets"
_angle = partial(positive, below=90)
T = TypeVar("T")
R = TypeVar("R", bound=Record)


def preset_names() -> tuple[str, ...]:
    """Names of the scenes that come with the package."""
    return tuple(sorted(path.stem for path in _PRESETS.glob("*.toml")))


@checked(preset_or_path=(str, Path))
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
    elif not latest(path).exists():
        raise InputError(
            f"scene {str(path)!r}: no such file, and no preset (presets: {', '.join(preset_names())})"
        )
    content = read_toml(path)
    try:
        scene = _scene(_Table("", content), path)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return replace(scene, accuracy=None, covariance=None) if exact else scene


def rig_table(file: str | Path) -> dict[str, Any]:
    """All tables of a rig's TOML. InputError if the file is no scene."""
    load(file)
    return read_toml(file)


def write_sections(file: str | Path, sections: Mapping[str, Mapping[str, Any]]) -> None:
    """Replace sections of a rig's TOML by name; all others stay. InputError if the file is no scene."""
    table = rig_table(file) | {name: dict(section) for name, section in sections.items()}
    with atomic_file(Path(file)) as temporary:
        temporary.write_text(toml_text(table), encoding="utf-8")


class _Table:
    """A TOML table that rejects keys which are unknown, or not asked for."""

    def __init__(self, name: str, content: Any) -> None:
        if not isinstance(content, dict):
            raise InputError(f"{name} = {content!r}: must be a table")
        self.name, self._content, self._used = name, content, set[str]()

    def __contains__(self, key: str) -> bool:
        return key in self._content

    def field(self, key: str) -> str:
        return f"{self.name}.{key}" if self.name else key

    def take(self, key: str, check: Callable[[str, Any], T], default: Any = MISSING) -> T:
        """The checked value; the default, or InputError, where there is none."""
        if key in self._content:
            self._used.add(key)
            return check(self.field(key), self._content[key])
        if default is MISSING:
            raise InputError(f"{self.field(key)} is missing, must be given{_INSTEAD.get(key, '')}")
        return default  # type: ignore[no-any-return]

    def part(self, key: str) -> "_Table":
        return self.take(key, _Table)

    def known(self, *names: str, of: type[Record] | None = None) -> None:
        """InputError if there is a key of another name; it suggests a similar one, if any."""
        every = [*dict.fromkeys((*(each.key for each in (declared(of) if of else ())), *names))]
        for key in self._content:
            if key not in every:
                meant = _MEANT.get(key) if _MEANT.get(key) in every else _resembling(key, every)
                must = self.field(meant) if meant else f"one of {', '.join(every)}"
                raise InputError(f"{self.field(key)} is unknown, must be {must}")

    def record(self, kind: type[R], fixed: Mapping[str, Any] | None = None, **defaults: Any) -> R:
        """A record by its fields' keys, but for those that are fixed; InputError if another key remains."""
        values = dict(fixed or {})
        for each in declared(kind):
            if each.name not in values:
                value = self._value(kind, each.key, each.place, defaults.get(each.name, each.default))
                degrees = each.key.endswith("_deg") and each.key in self
                values[each.name] = (
                    math.radians(each.check(self.field(each.key), value)) if degrees else value
                )
        for key in self._content:
            if key not in self._used:
                raise InputError(f"{self.field(key)}: excluded by other keys of [{self.name}]; leave it out")
        return kind(**values)

    def _value(self, kind: type[Record], key: str, place: int | None, default: Any) -> Any:
        value = self.take(key, lambda _, value: value, default)
        if place is None or key not in self:
            return value
        names = {each.place: each.name for each in declared(kind) if each.key == key}
        if not isinstance(value, list) or len(value) != len(names):
            order = ", ".join(names[k] for k in range(len(names)))
            raise InputError(f"{self.field(key)} = {value!r}: must be [{order}]")
        return value[place]


def _resembling(key: str, known: list[str]) -> str | None:
    """The known key that begins so (a unit is missing), or is spelled most like it."""
    longer = [name for name in known if name.startswith(f"{key}_")]
    return next(iter(longer or get_close_matches(key, known, 1)), None)


def _scene(top: _Table, path: Path) -> Scene:
    plain = {kind.section: kind for kind in (Display, Sensor, Layer)}
    parts = ("exact", "mirror", "pattern", "camera", "medium", *plain, "accuracy", "calibration")
    top.known(*parts, *FOREIGN, of=Scene)
    mirror, medium = _plain(top, Mirror), _plain(top, Medium) if "medium" in top else None
    covariance, form = _calibration(top.part("calibration"), path) if "calibration" in top else (None, None)
    others: dict[str, Any] = {name: _plain(top, kind) for name, kind in plain.items() if name in top}
    scene = Scene(
        top.take("name", text, path.stem),
        mirror,
        _pattern(top.part("pattern")),
        _camera(top.part("camera"), mirror, medium),
        medium,
        dent=top.take("dent", text, None),
        covariance=covariance,
        accuracy=_accuracy(top),
        rest_form=form,
        **others,
    )
    for name in () if covariance is None else covariance.names:
        if name not in parameter_values(scene):
            raise InputError(f"calibration: the scene has no number {name!r}")
    if scene.dent is not None:
        dent_from_text(scene.dent, scene)
    return scene


def _plain(top: _Table, kind: type[R]) -> R:
    """The section of a record whose keys are its fields'."""
    table = top.part(kind.section)
    table.known(of=kind)
    return table.record(kind)


def _accuracy(top: _Table) -> Accuracy | None:
    """[accuracy], or None where `exact = true`."""
    exact = top.take("exact", _boolean, False)
    if exact and "accuracy" in top:
        raise InputError("exact = true: excludes [accuracy]; leave one of both out")
    return _plain(top, Accuracy) if "accuracy" in top else None if exact else TYPED


def _boolean(name: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise InputError(f"{name} = {value!r}: must be true or false")
    return value


def _calibration(table: _Table, path: Path) -> tuple[Covariance, RestForm | None]:
    """[calibration]: the covariance's file, next to the scene's, and the form of the mirror at rest."""
    table.known("covariance", "date", "rest_form_mm")
    covariance = Covariance.load(path.parent / table.take("covariance", text))
    return replace(covariance, date=table.take("date", _day, "")), table.take("rest_form_mm", _form, None)


def _day(name: str, value: Any) -> str:
    """A date of TOML as text."""
    if type(value) is not date:
        raise InputError(f"{name} = {value!r}: must be a date, such as 2026-11-28")
    return value.isoformat()


def _form(name: str, value: Any) -> RestForm:
    if not isinstance(value, list):
        raise InputError(f"{name} = {value!r}: must be a list of numbers (mm)")
    return RestForm(np.array([number(name, each) for each in value]))


def _pattern(table: _Table) -> Pattern:
    table.known("bow", "table", "angle_deg", "offset_mm", "rotation_deg", of=Pattern)
    pitch, tall = table.take("pitch_mm", pair).tolist()
    if min(pitch, tall) < _LEAST_PITCH:
        raise InputError(
            f"pattern.pitch_mm = {min(pitch, tall):g}: must be at least {_LEAST_PITCH:g} mm; lengths are in "
            "millimetres, multiply metres by 1000"
        )
    bow, points = (table.part(name) if name in table else None for name in ("bow", "table"))
    fixed: dict[str, Any] = {"pitch": pitch, "aspect": tall / pitch}
    if "angle_deg" in table:
        flat = prism_pattern(math.radians(table.take("angle_deg", _angle)), 1, 1, pitch, aspect=tall / pitch)
        along, across = table.take("offset_mm", _offset, np.zeros(2))
        origin = flat.origin + along * flat.u_axis + across * flat.v_axis
        fixed |= {"origin": origin, "u_axis": flat.u_axis, "v_axis": flat.v_axis}
    pattern = table.record(Pattern, fixed | _rotation(table))
    if (size := max(pattern.cols * pitch, pattern.rows * tall)) > _LARGEST:
        wrong = f"pattern.pitch_mm = {pitch:g}: makes the display {1e-3 * size:.3g} m large"
        raise InputError(f"{wrong}, must be at most {1e-3 * _LARGEST:g} m; divide micrometres by 1000")
    if bow is not None:
        bow.known(of=Bow)
        return replace(pattern, shape=bow.record(Bow, **vars(Bow.of_pattern(pattern.rows, pattern.cols))))
    if points is not None:
        points.known(of=PointTable)
        return replace(pattern, shape=points.record(PointTable))
    return pattern


def _offset(name: str, value: Any) -> Float:
    """Along the face from the mirror's edge, and across (mm); one number: along it."""
    return vector(name, value if isinstance(value, list) else [value, 0.0], 2)


def _rotation(table: _Table) -> dict[str, Float]:
    """Axes u, v by a rotation vector in degrees that turns the mirror's axes into them, if given so."""
    if "rotation_deg" not in table or "angle_deg" in table:
        return {}
    rotation = rotation_from_vector(np.radians(table.take("rotation_deg", vector)))
    return {"u_axis": rotation[:, 0], "v_axis": rotation[:, 1]}


def _camera(table: _Table, mirror: Mirror, medium: Medium | None) -> Camera:
    name = table.take("kind", text, "telecentric")
    if name not in ("telecentric", "pinhole"):
        raise InputError(f"camera.kind = {name!r}: must be 'telecentric' or 'pinhole'")
    kind: type[Camera] = PinholeCamera if name == "pinhole" else TelecentricCamera
    for key in _PINHOLE:
        if kind is TelecentricCamera and key in table:
            raise InputError(f"camera.{key}: is of kind = 'pinhole', camera.kind is 'telecentric' (default)")
    others = _PINHOLE if kind is PinholeCamera else ("angle_deg",)
    table.known("kind", "face", *others, "position_mm", "look_at_mm", "row_axis", "rotation_deg", of=kind)
    fixed: dict[str, Any] = _rotation(table)
    if "face" in table:
        fixed["face"] = _face(table.part("face"), mirror, medium)
    if "look_at_mm" in table and "angle_deg" not in table:
        position, target = table.take("position_mm", vector), table.take("look_at_mm", vector)
        row_axis = table.take("row_axis", vector, np.array([0.0, 1.0, 0.0]))
        fixed["u_axis"], fixed["v_axis"] = look_at("camera", position, target, row_axis)
    if kind is PinholeCamera:
        if "focal_mm" in table or "pixel_pitch_mm" in table:
            fixed["focal"] = table.take("focal_mm", positive) / table.take("pixel_pitch_mm", pair)
        centre = 0.5 * (table.take("size", partial(vector, size=2)) - 1)
        return table.record(PinholeCamera, fixed, centre=centre)
    if "angle_deg" in table:
        angle, pitch = math.radians(table.take("angle_deg", _angle)), table.take("pitch_mm", pair)
        prism = prism_camera(mirror.length, angle, 1, 1, pitch)
        fixed |= {"origin": prism.origin, "u_axis": prism.u_axis, "v_axis": prism.v_axis}
    if "position_mm" not in table or "angle_deg" in table:
        return table.record(TelecentricCamera, fixed)
    fixed["origin"] = table.take("position_mm", vector)  # of the image's middle
    camera = table.record(TelecentricCamera, fixed)
    half = 0.5 * camera.pitch * np.array([camera.cols - 1, camera.rows - 1])
    return replace(camera, origin=camera.origin - half[0] * camera.u_axis - half[1] * camera.v_axis)


def _face(table: _Table, mirror: Mirror, medium: Medium | None) -> Face:
    """[camera.face]: by a point and its normal, or by its angle with the mirror at the edge x = L0."""
    table.known("angle_deg", of=Face)
    fixed: dict[str, Any] = {}
    if "angle_deg" in table:
        angle = math.radians(table.take("angle_deg", _angle))
        fixed = {"point": [mirror.length, 0, 0], "normal": [math.sin(angle), 0, math.cos(angle)]}
    return table.record(Face, fixed, **({} if medium is None else {"index": medium.index}))
