"""The rig of an OpenCSP SOFAST result (HDF5) as a scene: camera, facet, and the screen as a flat pattern.

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
from .pinhole import PinholeCamera
from .record import Float
from .scene import Scene

__all__ = ["SOFAST_SCREEN", "SofastRig", "load_sofast_rig"]

#: Rows and columns of nominal pixels: SOFAST tells places as fractions of the screen, u = 2000 x,
#: v = 1000 (1 - y).
SOFAST_SCREEN = (1000, 2000)

_FACET = "DataSofastCalculation/facet/facet_000/"
_POSE = _FACET + "CalculationDataGeometryFacet/SpatialOrientation/"
_ALIGNMENT = _FACET + "SlopeSolverData/trans_alignment"
_CORNERS = "DataSofastInput/optic_definition/facet_000/DefinitionFacet/v_facet_corners"
_MASK = _FACET + "CalculationImageProcessingFacet/mask_processed"
_CAMERA = ("Camera/intrinsic_mat", "Camera/distortion_coef", "Camera/image_shape_xy")
_ORIENTATION = tuple(
    _POSE + name for name in ("r_cam_optic", "v_cam_optic_cam", "r_cam_screen", "v_cam_screen_cam")
)
_SCREEN = ("DisplayShape/xy_screen_fraction", "DisplayShape/xy_screen_coords")
_MM = 1000.0
_LARGEST = 1e9  # metres and pixels: products of such values are far from overflow
#: Shapes of the fields; None: any extent. Vectors may lie along any axis.
_SHAPES: dict[str, tuple[int | None, ...]] = {
    **dict(zip(_CAMERA, ((3, 3), (5,), (2,)), strict=True)),
    **dict.fromkeys(_ORIENTATION, (3,)),
    **dict.fromkeys(_SCREEN, (2, None)),
    _CORNERS: (3, None),
    _MASK: (None, None),
    _ALIGNMENT: (4, 4),
}


@dataclass(frozen=True, eq=False)
class SofastRig:
    """scene: camera, facet and screen; the screen's cells are 1 mm, u along its x, v along its y.

    mask (H, W): camera pixels that see the facet. fractions (n, 2), points (n, 2): where on the flat screen
    (mm) the fractions (x, y) of the shown image lie; linear between these measured places. datum: the origin
    of SOFAST's optic frame, to which it measured the distance: a known point of the facet, mm.
    """

    scene: Scene
    mask: NDArray[np.bool_]
    fractions: Float
    points: Float
    datum: tuple[float, float, float]

    def pattern_coordinates(self, x: Float, y: Float) -> tuple[Float, Float]:
        """(u, v) on the scene's pattern of fractions (x, y) of the shown image; NaN outside the measured."""
        from scipy.interpolate import LinearNDInterpolator

        place = LinearNDInterpolator(self.fractions, self.points)(np.stack([x, y], axis=-1))
        corner = self.points.min(axis=0)
        return place[..., 0] - corner[0], place[..., 1] - corner[1]


def load_sofast_rig(path: str | Path) -> SofastRig:
    """Read camera, display shape, pose and mask of a SOFAST result. InputError names what is missing, of
    another shape, or no rig.
    """
    fields = load_fields(path, [*_CAMERA, *_ORIENTATION, *_SCREEN, _CORNERS, _MASK], [_ALIGNMENT])
    try:
        _require_shapes(fields)
        return _rig(fields)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _require_shapes(fields: dict[str, NDArray[Any]]) -> None:
    for name, array in fields.items():
        wanted = _SHAPES[name]
        shape = np.squeeze(array).shape if len(wanted) == 1 else array.shape
        fits = len(shape) == len(wanted) and all(
            need in (None, extent) for need, extent in zip(wanted, shape, strict=True)
        )
        if not fits or not array.size:
            text = ", ".join("n" if need is None else str(need) for need in wanted)
            raise InputError(f"{name} has shape {array.shape}, must be ({text})")
        largest = max(float(array.max()), -float(array.min()))
        if largest >= _LARGEST:
            raise InputError(f"{name} has values up to {largest:g}, must be below {_LARGEST:g}")
    shape, points = fields[_SCREEN[0]].shape, fields[_SCREEN[1]].shape
    if shape != points or points[1] < 3:
        raise InputError(f"{_SCREEN[1]} has shape {points}, {_SCREEN[0]} {shape}; must be one (2, n), n >= 3")
    cols, rows = fields[_CAMERA[2]].ravel().tolist()
    if fields[_MASK].shape != (rows, cols):
        raise InputError(f"{_MASK} has shape {fields[_MASK].shape}, {_CAMERA[2]} is ({cols}, {rows})")


def _rig(fields: dict[str, NDArray[Any]]) -> SofastRig:
    fractions, points = (fields[name].T.astype(np.float64) for name in _SCREEN)
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
        pattern=_pattern(screen_origin, screen, _MM * points),
        camera=_camera(fields, origin, to_optic),
    )
    datum = (float(offset[0]), float(offset[1]), 0.0)
    return SofastRig(scene, fields[_MASK].astype(bool), fractions, _MM * points, datum)


def _pattern(origin: Float, axes: Float, points: Float) -> Pattern:
    """The flat screen, axes (3, 3) in columns, as cells of 1 mm from the measured places' corner on."""
    corner = points.min(axis=0)
    cols, rows = (int(np.ceil(extent)) for extent in np.ptp(points, axis=0))
    start = origin + axes[:, :2] @ corner
    return Pattern(start, axes[:, 0], axes[:, 1], 1.0, rows=rows, cols=cols)


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
