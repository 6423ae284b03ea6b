"""Files of OpenCSP's SOFAST: fields by their own names, whatever group they are in, their shapes checked.
Results, inputs and measurements are HDF5 (h5py, extra `sofast`); a facet's definition is JSON.

A measurement has fringes in periods per screen and places as fractions of the screen, not in pixels; here a
screen has nominal pixels, `SOFAST_SCREEN`: u = 2000 x, v = 1000 (1 - y) for fractions (x, y).
"""

import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.arrays import require_room
from optolever.errors import InputError, damage_of, require_file
from optolever.patterns import Frame, Sequence
from optolever.projector import Capture

__all__ = ["SOFAST_SCREEN", "Fields", "load_sofast", "load_sofast_response", "rig_fields", "sofast_facets"]

Fields = dict[str, NDArray[Any]]

#: Rows and columns of nominal pixels.
SOFAST_SCREEN = ROWS, COLS = 1000, 2000
_STEPS = 4  # SOFAST shows every fringe at 0, 90, 180 and 270 degrees

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
#: Fields of a rig: of a result, and of inputs.
_COMMON = (
    *("Camera/intrinsic_mat", "Camera/distortion_coef", "Camera/image_shape_xy"),
    *("SpatialOrientation/r_cam_screen", "SpatialOrientation/v_cam_screen_cam"),
)
_RESULT = (*_COMMON, "SpatialOrientation/r_cam_optic", "SpatialOrientation/v_cam_optic_cam", "mask_processed")
_INPUTS = (*_COMMON, "MeasurementSofastFringe/mask_images", "MeasurementSofastFringe/dist_optic_screen")


def load_sofast(path: str | Path) -> Capture:
    """A measurement: black, white, then the fringes along v and along u, frames (2 + N, H, W) uint8."""
    fields = _fields(path, "fringe_images", "mask_images", "fringe_periods_x", "fringe_periods_y")
    x, y, shots = fields["fringe_periods_x"], fields["fringe_periods_y"], fields["mask_images"]
    for name, count in (("mask_images", 2), ("fringe_images", _STEPS * (len(x) + len(y)))):
        stack = fields[name]
        if stack.dtype != np.uint8 or stack.shape != (*shots.shape[:2], count):
            must = f"uint8 (H, W, {count}), mask_images is {shots.shape}"
            raise InputError(f"{path}: {name} is {stack.dtype} {stack.shape}, must be {must}")
    try:
        shown = tuple(
            Frame("phase", axis, period_px=extent / count, shift=2 * math.pi * step / _STEPS)
            for axis, extent, counts in (("v", ROWS, y), ("u", COLS, x))
            for count in counts.astype(np.float64).tolist()
            for step in range(_STEPS)
        )
    except (InputError, ZeroDivisionError) as error:
        raise InputError(f"{path}: fringe_periods_x or fringe_periods_y: {error}") from error
    sequence = Sequence((Frame("black"), Frame("white"), *shown), ROWS, COLS, "sofast", nominal=True)
    frames = np.concatenate([shots, fields["fringe_images"]], axis=2)
    return Capture(np.ascontiguousarray(np.moveaxis(frames, 2, 0)), sequence)


def load_sofast_response(path: str | Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Display levels (n,) and the camera's levels for them (n,): the response to invert."""
    fields = _fields(path, "display_values", "camera_values")
    display, camera = (fields[name].astype(np.float64) for name in ("display_values", "camera_values"))
    if display.shape != camera.shape:
        raise InputError(f"{path}: camera_values has shape {camera.shape}, display_values {display.shape}")
    return display, camera


def rig_fields(paths: list[Path], facet: str) -> Fields:
    """Fields of a result (r_cam_optic is there), or of inputs. InputError names all that is missing."""
    fields: Fields = {}
    for path in paths:
        fields |= _definition(path) if path.suffix.lower() == ".json" else _fields(path, facet=facet)
    needed = _RESULT if "r_cam_optic" in fields or "mask_processed" in fields else _INPUTS
    if missing := [name for name in needed if name.rpartition("/")[2] not in fields]:
        raise InputError(f"no {', no '.join(missing)}")
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
        raise InputError(f"{path}: no definition of one facet ({damage_of(error)})") from error


def _checked(name: str, array: NDArray[Any]) -> NDArray[Any]:
    expected = _SHAPES[name]
    shape = array.shape if None in expected or len(expected) > 1 else np.squeeze(array).shape
    pairs = zip(expected, shape, strict=False)
    if len(shape) != len(expected) or any(need not in (None, got) for need, got in pairs) or not array.size:
        raise InputError(f"{name} has shape {array.shape}, must be {expected} (None: any)")
    if array.dtype.kind not in "biuf" or not (np.abs(array.astype(np.float64)) < _LARGEST).all():
        raise InputError(f"{name} has values that are no finite numbers below {_LARGEST:g}")
    return array


def sofast_facets(path: str | Path) -> list[str]:
    """Names of the facets in a result, sorted."""
    with _reading(path) as file:
        if not (names := sorted(_facets(file))):
            raise InputError("no facet is in it: is it a SOFAST result?")
        return names


def _facets(file: Any) -> set[str]:
    """Names of the groups of single facets."""
    found: dict[str, Any] = {}
    file.visititems(lambda place, item: found.update({place.rpartition("/")[2]: item}))
    return {name for name, item in found.items() if name.startswith("facet_") and hasattr(item, "keys")}


@contextmanager
def _reading(path: str | Path) -> Iterator[Any]:
    """An HDF5 file. InputError names it."""
    try:
        import h5py
    except ModuleNotFoundError as error:
        raise InputError(f"{path}: HDF5 needs h5py; pip install 'optolever[sofast]'") from error
    require_file(path)
    try:
        with h5py.File(path, "r") as file:
            yield file
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except (OSError, KeyError, RuntimeError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{path}: not a readable HDF5 file ({damage_of(error)})") from error


def _fields(path: str | Path, *names: str, facet: str = "") -> Fields:
    """Fields of an HDF5 file, all of `names` among them; where a field stands twice, or has a place in every
    facet, that of the facet. InputError names the file and the field that is missing or damaged."""
    found: dict[str, Any] = {}

    def visit(place: str, item: Any) -> None:
        parts = place.split("/")
        own = [part for part in parts if part.startswith("facet_")]
        name = _OLDER.get(parts[-1], parts[-1])
        if name in _SHAPES and (not own or facet in own) and (facet in own or name not in found):
            found[name] = item

    with _reading(path) as file:
        file.visititems(visit)
        facets = _facets(file)
        if facet and facets and facet not in facets:
            raise InputError(f"no facet {facet!r}, there are {', '.join(sorted(facets))}")
        if missing := [name for name in names if name not in found]:
            raise InputError(f"field {missing[0]!r} is missing")
        require_room("its fields", sum(each.nbytes for each in found.values()))
        return {name: _checked(name, np.asarray(dataset[()])) for name, dataset in found.items()}
