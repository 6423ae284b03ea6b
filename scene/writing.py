"""Scenes to TOML: explicit poses in full precision, so that a scene read back is equal."""

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from optolever import InputError
from optolever.toml import read_toml

from .face import Face
from .mirror import Mirror
from .pattern import Pattern
from .pattern_shape import Bow
from .pinhole import PinholeCamera

__all__ = ["FOREIGN", "foreign_sections", "scene_table"]

Table = dict[str, Any]

#: Sections of a rig's file of other parts; skipped here, kept on writing.
FOREIGN = ("rest", "response", "profile", "devices", "sync")


def foreign_sections(path: Path) -> Table:
    """Those of a file that is there; none if it is no TOML."""
    try:
        content = read_toml(path)
    except (InputError, OSError):
        return {}
    return {name: content[name] for name in FOREIGN if name in content}


def _pitch(pattern: Pattern) -> float | list[float]:
    """Of square cells one number."""
    return pattern.pitch if pattern.aspect == 1 else [pattern.pitch, pattern.pitch * pattern.aspect]


def scene_table(
    name: str, mirror: Mirror, pattern: Pattern, camera: Any, dent: str | None, others: Mapping[str, Any]
) -> Table:
    """A scene's parts as plain TOML types; others: records by section, None: omitted."""
    table: Table = {
        "name": name,
        "mirror": {"size_mm": [mirror.length, mirror.width]},
        "pattern": {
            "size": [pattern.cols, pattern.rows],
            "pitch_mm": _pitch(pattern),
            "blur_px": pattern.blur_px,
            "origin_mm": pattern.origin.tolist(),
            **_axes(pattern),
        },
        "camera": _camera(camera),
    }
    if pattern.shape is not None:
        shape = "bow" if isinstance(pattern.shape, Bow) else "table"
        table["pattern"][shape] = pattern.shape.table()
    if dent is not None:
        table = {"name": name, "dent": dent, **table}
    for section, record in others.items():
        if record is not None:
            values = {field.name: getattr(record, field.name) for field in fields(record)}
            table[section] = {key: value for key, value in values.items() if value is not None}
    return table


def _camera(camera: Any) -> Table:
    table: Table = {"size": [camera.cols, camera.rows], **_axes(camera)}
    if isinstance(camera, PinholeCamera):
        table |= {"kind": "pinhole", "position_mm": camera.origin.tolist()}
        table |= {"focal_px": camera.focal.tolist(), "centre_px": camera.centre.tolist()}
        table |= {"distortion": camera.distortion.tolist()}
    else:
        table |= {
            "kind": "telecentric",
            "origin_mm": camera.origin.tolist(),
            "pitch_mm": camera.pitch.tolist(),
        }
    if camera.face is not None:
        table["face"] = _face(camera.face)
    return table


def _axes(posed: Any) -> dict[str, list[float]]:
    axes: dict[str, list[float]] = {
        "u_axis": np.asarray(posed.u_axis).tolist(),
        "v_axis": np.asarray(posed.v_axis).tolist(),
    }
    return axes


def _face(face: Face) -> Table:
    return {
        "point_mm": face.point.tolist(),
        "normal": face.normal.tolist(),
        "index": face.index,
        "outside": face.outside,
    }
