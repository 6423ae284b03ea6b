"""Files of OpenCSP's SOFAST: fields of a result, or gathered from its inputs, with their shapes checked.

Results and inputs are HDF5; a facet's definition is JSON. Fields go by their full names in the file.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError

from .hdf5 import load_fields, names_in

__all__ = [
    "ALIGNMENT",
    "CAMERA",
    "CENTROID",
    "CORNERS",
    "DISTANCE",
    "FACET",
    "FRACTIONS",
    "MASK",
    "MODELS",
    "POINT",
    "POSE",
    "SHOTS",
    "Fields",
    "sofast_fields",
]

Fields = dict[str, NDArray[Any]]

FACET = "facet_000"
_FACETS = "DataSofastCalculation/facet"
_RESULT = f"{_FACETS}/{FACET}/"
_DEFINITION = f"DataSofastInput/optic_definition/{FACET}/DefinitionFacet/"
_MEASURED = "MeasurementSofastFringe/"
CAMERA = ("Camera/intrinsic_mat", "Camera/distortion_coef", "Camera/image_shape_xy")
POSE = tuple(
    f"{_RESULT}CalculationDataGeometryFacet/SpatialOrientation/{name}"
    for name in ("r_cam_optic", "v_cam_optic_cam", "r_cam_screen", "v_cam_screen_cam")
)
_ORIENTATION = ("SpatialOrientation/r_cam_screen", "SpatialOrientation/v_cam_screen_cam")
ALIGNMENT = _RESULT + "SlopeSolverData/trans_alignment"
CORNERS, CENTROID = _DEFINITION + "v_facet_corners", _DEFINITION + "v_facet_centroid"
MASK = _RESULT + "CalculationImageProcessingFacet/mask_processed"
SHOTS, DISTANCE, POINT = (
    _MEASURED + name for name in ("mask_images", "dist_optic_screen", "v_measure_point_facet")
)
FRACTIONS = "DisplayShape/xy_screen_fraction"
#: OpenCSP's screen models and their fields.
MODELS = {
    "rectangular2D": ("DisplayShape/screen_x", "DisplayShape/screen_y"),
    "distorted2D": (FRACTIONS, "DisplayShape/xy_screen_coords"),
    "distorted3D": (FRACTIONS, "DisplayShape/xyz_screen_coords"),
}
_LARGEST = 1e9  # metres and pixels: products of such values are far from overflow
#: Shapes of the fields; None: any extent. Vectors may lie along any axis.
_SHAPES: dict[str, tuple[int | None, ...]] = {
    **dict(zip(CAMERA, ((3, 3), (5,), (2,)), strict=True)),
    **dict.fromkeys((*POSE, *_ORIENTATION, CENTROID, POINT), (3,)),
    **dict.fromkeys(MODELS["distorted2D"], (2, None)),
    **dict.fromkeys((*MODELS["rectangular2D"], DISTANCE), ()),
    MODELS["distorted3D"][1]: (3, None),
    CORNERS: (3, None),
    MASK: (None, None),
    SHOTS: (None, None, 2),
    ALIGNMENT: (4, 4),
}
#: Parts of a rig and their fields: of a result, and of inputs.
_PARTS = {
    True: {"camera": CAMERA, "orientation": POSE, "mask of the facet": (MASK,)},
    False: {"camera": CAMERA, "orientation": _ORIENTATION, "measurement": (SHOTS, DISTANCE)},
}
#: Older names of fields.
_OLDER = {
    DISTANCE: _MEASURED + "optic_screen_dist",
    POINT: _MEASURED + "measure_point",
    CORNERS: f"DataSofastInput/optic_definition/{FACET}/v_facet_corners",
}


def sofast_fields(paths: Sequence[Path], facet: str) -> Fields:
    """Fields by their names for facet_000: of a result (POSE is complete), or of inputs (POSE has the
    screen's place, SHOTS and DISTANCE are there). InputError names the file, or all that is missing."""
    fields: Fields = {}
    for path in paths:
        found = _of_json(path) if path.suffix.lower() == ".json" else _of_hdf5(path, facet)
        if twice := sorted(set(found) & set(fields)):
            raise InputError(f"{path}: {twice[0]} is in {' and '.join(map(str, paths))}; give one of them")
        fields |= found
    told = ", ".join(map(str, paths))
    result = any(name in fields for name in (*POSE, MASK))
    missing = [
        f"no {part} ({next(name for name in names if name not in fields).replace(FACET, facet)})"
        for part, names in _PARTS[result].items()
        if any(name not in fields for name in names)
    ]
    if missing:
        raise InputError(f"{told}: {', '.join(missing)}{'' if result else _facets(paths, facet)}")
    try:
        _require_shapes(fields)
    except InputError as error:
        raise InputError(f"{told}: {error}") from error
    return fields if result else fields | {POSE[2 + k]: fields[name] for k, name in enumerate(_ORIENTATION)}


def _of_hdf5(path: Path, facet: str) -> Fields:
    names = {name: name.replace(FACET, facet) for name in _SHAPES}
    older = {name: other.replace(FACET, facet) for name, other in _OLDER.items()}
    found = load_fields(path, (), [*names.values(), *older.values()])
    return {name: found[own] for both in (older, names) for name, own in both.items() if own in found}


def _of_json(path: Path) -> Fields:
    """A facet's definition: lists x, y, z of its corners and of its centroid, in metres."""
    keys = {"v_facet_corners": CORNERS, "v_centroid_facet": CENTROID}
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if "v_facet_locations" in content:
            raise InputError(f"{path}: defines an ensemble; poses of its facets are in SOFAST's result alone")
        found = {
            name: np.array([content[key][axis] for axis in "xyz"], np.float64) for key, name in keys.items()
        }
    except (OSError, UnicodeDecodeError, ValueError, TypeError, KeyError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: no definition of a facet ({type(error).__name__}: {error})") from error
    for name, array in found.items():
        if array.ndim != 2 or not np.isfinite(array).all():
            raise InputError(f"{path}: {name.rpartition('/')[2]} must be lists x, y, z of finite numbers")
    return found


def _facets(paths: Sequence[Path], facet: str) -> str:
    """Which facets a result has instead, or which fields of this one that are not read."""
    for path in paths:
        others = [] if path.suffix.lower() == ".json" else names_in(path, _FACETS)
        if facet in others:
            found, needed = ", ".join(names_in(path, f"{_FACETS}/{facet}")), POSE[0].removeprefix(_RESULT)
            return (
                f"; facet {facet!r} has {found or 'no field'}, must have {needed}: a result of another "
                "version of OpenCSP; give SOFAST's inputs instead, or compute it anew"
            )
        if others:
            return f"; no facet {facet!r}, there are {', '.join(others)}"
    return ""


def _require_shapes(fields: Fields) -> None:
    for name, array in fields.items():
        wanted = _SHAPES[name]
        shape = np.squeeze(array).shape if len(wanted) < 2 else array.shape
        fits = len(shape) == len(wanted) and all(
            need in (None, extent) for need, extent in zip(wanted, shape, strict=True)
        )
        if not fits or not array.size:
            text = ", ".join("n" if need is None else str(need) for need in wanted)
            raise InputError(f"{name} has shape {array.shape}, must be ({text})")
        largest = max(float(array.max()), -float(array.min()))
        if largest >= _LARGEST:
            raise InputError(f"{name} has values up to {largest:g}, must be below {_LARGEST:g}")
    cols, rows = fields[CAMERA[2]].ravel().tolist()
    for name in (MASK, SHOTS):
        if name in fields and fields[name].shape[:2] != (rows, cols):
            raise InputError(f"{name} has shape {fields[name].shape}, {CAMERA[2]} is ({cols}, {rows})")
