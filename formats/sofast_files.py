"""Files of OpenCSP's SOFAST: fields by their own names, whatever group they are in, their shapes checked.
Results, inputs and measurements are HDF5 (h5py, extra `sofast`); a facet's definition is JSON.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError, require_file
from optolever.memory import require_room

__all__ = ["Fields", "rig_fields", "sofast_fields"]

Fields = dict[str, NDArray[Any]]

_LARGEST = 1e9  # metres and pixels: products of such values are far from overflow
_VECTORS = ("r_cam_optic", "v_cam_optic_cam", "r_cam_screen", "v_cam_screen_cam")
#: Shapes of the fields; None: any extent. Vectors may lie along any axis.
_SHAPES: dict[str, tuple[int | None, ...]] = {
    "intrinsic_mat": (3, 3),
    "distortion_coef": (5,),
    "image_shape_xy": (2,),
    **dict.fromkeys((*_VECTORS, "v_facet_centroid", "v_measure_point_facet"), (3,)),
    **dict.fromkeys(("screen_x", "screen_y", "dist_optic_screen"), ()),
    **dict.fromkeys(("xy_screen_fraction", "xy_screen_coords"), (2, None)),
    **dict.fromkeys(("xyz_screen_coords", "v_facet_corners"), (3, None)),
    **dict.fromkeys(("fringe_periods_x", "fringe_periods_y", "display_values", "camera_values"), (None,)),
    "mask_processed": (None, None),
    "mask_images": (None, None, 2),
    "fringe_images": (None, None, None),
    "trans_alignment": (4, 4),
}
_OLDER = {"optic_screen_dist": "dist_optic_screen", "measure_point": "v_measure_point_facet"}
_CAMERA = ("Camera/intrinsic_mat", "Camera/distortion_coef", "Camera/image_shape_xy")
#: Parts of a rig and their fields: of a result, and of inputs.
_RESULT = {"camera": _CAMERA, "orientation": _VECTORS, "mask of the facet": ("mask_processed",)}
_INPUTS = {
    "camera": _CAMERA,
    "orientation": ("SpatialOrientation/r_cam_screen", "SpatialOrientation/v_cam_screen_cam"),
    "measurement": ("MeasurementSofastFringe/mask_images", "MeasurementSofastFringe/dist_optic_screen"),
}


def sofast_fields(path: str | Path, *names: str, facet: str = "") -> Fields:
    """Fields of an HDF5 file, all of `names` among them; where a field stands twice, or has a place in every
    facet, that of the facet. InputError names the file and the field that is missing or damaged."""
    try:
        import h5py
    except ModuleNotFoundError as error:
        raise InputError(f"{path}: HDF5 needs h5py; pip install 'optolever[sofast]'") from error
    require_file(path)
    found: dict[str, Any] = {}
    facets: set[str] = set()

    def visit(place: str, item: Any) -> None:
        parts = place.split("/")
        own = [part for part in parts if part.startswith("facet_")]
        facets.update(own)
        name = _OLDER.get(parts[-1], parts[-1])
        if name in _SHAPES and (not own or facet in own) and (facet in own or name not in found):
            found[name] = item

    try:
        with h5py.File(path, "r") as file:
            file.visititems(visit)
            if facet and facets and facet not in facets:
                raise InputError(f"no facet {facet!r}, there are {', '.join(sorted(facets))}")
            for name in names:
                if name not in found:
                    raise InputError(f"field {name!r} is missing")
            for name, dataset in found.items():
                if getattr(dataset, "dtype", np.dtype("O")).kind not in "biuf":
                    raise InputError(f"{name} is no dataset of real numbers")
            require_room("its fields", sum(each.size * each.dtype.itemsize for each in found.values()))
            return {name: _checked(name, np.asarray(dataset[()])) for name, dataset in found.items()}
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except (OSError, KeyError, RuntimeError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{path}: not a readable HDF5 file ({error})") from error


def rig_fields(paths: Sequence[Path], facet: str) -> Fields:
    """Fields of a result (r_cam_optic is there), or of inputs (mask_images and dist_optic_screen are).
    InputError names all that is missing."""
    fields: Fields = {}
    for path in paths:
        found = _definition(path) if path.suffix.lower() == ".json" else sofast_fields(path, facet=facet)
        if twice := sorted(set(found) & set(fields)):
            raise InputError(f"{twice[0]} is in {' and '.join(map(str, paths))}; give one of them")
        fields |= found
    parts = _RESULT if "r_cam_optic" in fields or "mask_processed" in fields else _INPUTS
    lacks = {part: [n for n in names if n.rpartition("/")[2] not in fields] for part, names in parts.items()}
    if any(lacks.values()):
        raise InputError(", ".join(f"no {part} ({names[0]})" for part, names in lacks.items() if names))
    cols, rows = fields["image_shape_xy"].ravel().tolist()
    for name in {"mask_processed", "mask_images"} & fields.keys():
        if fields[name].shape[:2] != (rows, cols):
            raise InputError(f"{name} has shape {fields[name].shape}, image_shape_xy is ({cols}, {rows})")
    return fields


def _definition(path: Path) -> Fields:
    """A facet's definition: lists x, y, z of its corners and of its centroid, in metres."""
    keys = {"v_facet_corners": "v_facet_corners", "v_facet_centroid": "v_centroid_facet"}
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        lists = {name: [content[key][axis] for axis in "xyz"] for name, key in keys.items()}
        return {name: _checked(name, np.array(values, np.float64)) for name, values in lists.items()}
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise InputError(f"{path}: no definition of one facet ({type(error).__name__}: {error})") from error


def _checked(name: str, array: NDArray[Any]) -> NDArray[Any]:
    expected = _SHAPES[name]
    shape = array.shape if None in expected or len(expected) > 1 else np.squeeze(array).shape
    pairs = zip(expected, shape, strict=False)
    if len(shape) != len(expected) or any(need not in (None, got) for need, got in pairs) or not array.size:
        text = ", ".join("n" if need is None else str(need) for need in expected)
        raise InputError(f"{name} has shape {array.shape}, must be ({text})")
    if not np.isfinite(array).all() or np.abs(array.astype(np.float64)).max() >= _LARGEST:
        raise InputError(f"{name} has values that are not finite, or {_LARGEST:g} and more")
    return array
