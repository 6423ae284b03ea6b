"""The rig of an OpenCSP SOFAST result (HDF5) as a scene: camera, facet, and the screen as a pattern.

SOFAST's conventions: metres; r_A_B is a rotation vector that maps frame A to B, v_A_B_C runs from A to B in
frame C; trans_alignment acts on the optic frame last. Its optic frame has the facet's centre in the middle
and the camera at +z; the mirror frame here is the same, moved so that the facet starts at x = y = 0.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.hdf5 import load_fields

from .mirror import Mirror
from .pattern import Pattern
from .pattern_shape import PointTable
from .pinhole import PinholeCamera
from .record import Float
from .scene import Scene

__all__ = ["SOFAST_SCREEN", "SofastRig", "load_sofast_rig"]

#: Rows and columns of nominal pixels: SOFAST tells places as fractions of the screen, u = 2000 x,
#: v = 1000 (1 - y).
SOFAST_SCREEN = (1000, 2000)

_FACET = "facet_000"
_RESULT = f"DataSofastCalculation/facet/{_FACET}/"
_POSE = _RESULT + "CalculationDataGeometryFacet/SpatialOrientation/"
_ALIGNMENT = _RESULT + "SlopeSolverData/trans_alignment"
_CORNERS = f"DataSofastInput/optic_definition/{_FACET}/DefinitionFacet/v_facet_corners"
_MASK = _RESULT + "CalculationImageProcessingFacet/mask_processed"
_CAMERA = ("Camera/intrinsic_mat", "Camera/distortion_coef", "Camera/image_shape_xy")
_ORIENTATION = tuple(
    _POSE + name for name in ("r_cam_optic", "v_cam_optic_cam", "r_cam_screen", "v_cam_screen_cam")
)
_SCREEN = ("DisplayShape/xy_screen_fraction", "DisplayShape/xy_screen_coords")
#: OpenCSP's screen models and their fields.
_MODELS = {
    "rectangular2D": ("DisplayShape/screen_x", "DisplayShape/screen_y"),
    "distorted2D": _SCREEN,
    "distorted3D": (_SCREEN[0], "DisplayShape/xyz_screen_coords"),
}
_MM = 1000.0
_LARGEST = 1e9  # metres and pixels: products of such values are far from overflow
#: Shapes of the fields; None: any extent. Vectors may lie along any axis.
_SHAPES: dict[str, tuple[int | None, ...]] = {
    **dict(zip(_CAMERA, ((3, 3), (5,), (2,)), strict=True)),
    **dict.fromkeys(_ORIENTATION, (3,)),
    **dict.fromkeys(_SCREEN, (2, None)),
    **dict.fromkeys(_MODELS["rectangular2D"], ()),
    _MODELS["distorted3D"][1]: (3, None),
    _CORNERS: (3, None),
    _MASK: (None, None),
    _ALIGNMENT: (4, 4),
}


@dataclass(frozen=True, eq=False)
class SofastRig:
    """scene: camera, facet and screen; a flat screen's cells are 1 mm, u along its x, v along its y.

    mask (H, W): camera pixels that see the facet. fractions (n, 2), points (n, 3): where on the screen (mm)
    the fractions (x, y) of the shown image lie; linear between these places. datum: the origin of SOFAST's
    optic frame, to which it measured the distance: a known point of the facet, mm.
    """

    scene: Scene
    mask: NDArray[np.bool_]
    fractions: Float
    points: Float
    datum: tuple[float, float, float]

    @property
    def extent(self) -> tuple[float, float]:
        """Of the measured places along x and y, mm."""
        x, y = np.ptp(self.points, axis=0)[:2].tolist()
        return x, y

    def pattern_coordinates(self, x: Float, y: Float) -> tuple[Float, Float]:
        """(u, v) on the scene's pattern of fractions (x, y) of the shown image; NaN outside the measured."""
        from scipy.interpolate import LinearNDInterpolator

        if self.scene.pattern.shape is None:
            places = self.points[:, :2] - self.points[:, :2].min(axis=0)
        else:
            places = _cells(self.fractions, self.points)
        place = LinearNDInterpolator(self.fractions, places)(np.stack([x, y], axis=-1))
        return place[..., 0], place[..., 1]


def load_sofast_rig(path: str | Path, facet: str = _FACET) -> SofastRig:
    """Read camera, display shape, pose and mask of a SOFAST result; facet: of an ensemble, by its group's
    name. InputError names what is missing, of another shape, or no rig.
    """
    named = {name: name.replace(_FACET, facet) for name in _SHAPES}
    screens = {name for names in _MODELS.values() for name in names}
    required = [named[name] for name in _SHAPES if name not in screens | {_ALIGNMENT}]
    found = load_fields(path, required, [*sorted(screens), named[_ALIGNMENT]])
    fields = {name: found[own] for name, own in named.items() if own in found}
    try:
        _require_shapes(fields)
        return _rig(fields)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _require_shapes(fields: dict[str, NDArray[Any]]) -> None:
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
    cols, rows = fields[_CAMERA[2]].ravel().tolist()
    if fields[_MASK].shape != (rows, cols):
        raise InputError(f"{_MASK} has shape {fields[_MASK].shape}, {_CAMERA[2]} is ({cols}, {rows})")


def _rig(fields: dict[str, NDArray[Any]]) -> SofastRig:
    fractions, points = _screen(fields)
    corners = _MM * fields[_CORNERS][:2]
    mirror = Mirror(*(float(extent) for extent in np.ptp(corners, axis=1)))
    offset = np.array([*(-corners.min(axis=1)), 0.0])
    align, shift = _alignment(fields)
    to_optic = align @ _rotation(fields[_ORIENTATION[0]])  # R_MC: camera to mirror frame
    origin = offset + shift - to_optic @ _vector(fields[_ORIENTATION[1]])
    screen = to_optic @ _rotation(fields[_ORIENTATION[2]]).T
    screen_origin = to_optic @ _vector(fields[_ORIENTATION[3]]) + origin
    scene = Scene(
        name="sofast",
        mirror=mirror,
        pattern=_pattern(screen_origin, screen, fractions, points),
        camera=_camera(fields, origin, to_optic),
    )
    datum = (float(offset[0]), float(offset[1]), 0.0)
    return SofastRig(scene, fields[_MASK].astype(bool), fractions, points, datum)


def _screen(fields: dict[str, NDArray[Any]]) -> tuple[Float, Float]:
    """Fractions (n, 2) and their places on the screen (n, 3), mm, of whichever model the file has."""
    models = [
        model
        for model, names in _MODELS.items()
        if any(name in fields for name in names if name != _SCREEN[0])
    ]
    if len(models) != 1 or any(name not in fields for name in _MODELS[models[0]]):
        what = "none of the screen models whole" if len(models) < 2 else "fields of several screen models"
        needs = "; ".join(f"{model}: {', '.join(names)}" for model, names in _MODELS.items())
        raise InputError(f"DisplayShape has {what} ({needs})")
    names = _MODELS[models[0]]
    if models[0] == "rectangular2D":
        for name in names:
            if not fields[name].item() > 0:
                raise InputError(f"{name} = {fields[name].item():g}, must be above 0 m")
        fractions = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
        flat = (fractions - 0.5) * [fields[name].item() for name in names]
        return fractions, _MM * np.column_stack([flat, np.zeros(4)])
    fractions, points = (fields[name].T.astype(np.float64) for name in names)
    if len(fractions) != len(points) or len(points) < 3:
        other = fields[names[0]].shape
        raise InputError(
            f"{names[1]} has shape {fields[names[1]].shape}, {names[0]} {other}; must be n >= 3 places"
        )
    flat = np.zeros((len(points), 3))
    flat[:, : points.shape[1]] = _MM * points
    return fractions, flat


def _cells(fractions: Float, points: Float) -> Float:
    """Cells (n, 2) of fractions on a screen that is not flat: both axes by one factor, so that the triangles
    between measured places are SOFAST's."""
    size = np.ptp(points, axis=0).max()
    cells: Float = size * (fractions - fractions.min(axis=0))
    return cells


def _pattern(origin: Float, axes: Float, fractions: Float, points: Float) -> Pattern:
    """The screen, axes (3, 3) in columns: flat, as cells of 1 mm from the measured places' corner on, or as
    the measured places themselves."""
    corner = np.array([*points[:, :2].min(axis=0), 0.0])
    start, shape = origin + axes @ corner, None
    cells = points[:, :2] - corner[:2]
    if points[:, 2].any():
        cells = _cells(fractions, points)
        shape = PointTable(cells, points - corner - np.pad(cells, ((0, 0), (0, 1))))
    cols, rows = (int(np.ceil(extent)) for extent in np.ptp(cells, axis=0))
    return Pattern(start, axes[:, 0], axes[:, 1], 1.0, rows=rows, cols=cols, shape=shape)


def _camera(fields: dict[str, NDArray[Any]], origin: Float, rotation: Float) -> PinholeCamera:
    matrix, distortion, shape = (fields[name].squeeze() for name in _CAMERA)
    return PinholeCamera(
        origin=origin,
        u_axis=rotation[:, 0],
        v_axis=rotation[:, 1],
        focal=np.array([matrix[0, 0], matrix[1, 1]]),
        centre=matrix[:2, 2],
        rows=int(shape[1]),
        cols=int(shape[0]),
        distortion=distortion,
    )


def _alignment(fields: dict[str, NDArray[Any]]) -> tuple[Float, Float]:
    transform = fields.get(_ALIGNMENT, np.eye(4)).astype(np.float64)
    return transform[:3, :3], _MM * transform[:3, 3]


def _rotation(vector: NDArray[Any]) -> Float:
    return np.asarray(cv2.Rodrigues(vector.astype(np.float64).ravel())[0], dtype=np.float64)


def _vector(value: NDArray[Any]) -> Float:
    return _MM * value.astype(np.float64).ravel()
