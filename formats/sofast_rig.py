"""The rig of an OpenCSP SOFAST result, or of its inputs, as a scene: camera, facet, the screen as a pattern.

SOFAST's conventions: metres; r_A_B is a rotation vector that maps frame A to B, v_A_B_C runs from A to B in
frame C; trans_alignment acts on the optic frame last. Its optic frame has the facet's centre in the middle
and the camera at +z; the mirror frame here is the same, moved so that the facet starts at x = y = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.scene import Mirror, Pattern, PinholeCamera, PointTable, Scene

from .sofast_files import (
    ALIGNMENT,
    CAMERA,
    CENTROID,
    CORNERS,
    DISTANCE,
    FACET,
    FRACTIONS,
    MASK,
    MODELS,
    POINT,
    POSE,
    SHOTS,
    Fields,
    sofast_fields,
)

Float = NDArray[np.float64]

__all__ = ["SOFAST_SCREEN", "SofastRig", "load_sofast_rig"]

#: Rows and columns of nominal pixels: SOFAST gives places as fractions of the screen, u = 2000 x,
#: v = 1000 (1 - y).
SOFAST_SCREEN = (1000, 2000)

_MM = 1000.0
_TURNS = 10  # the pose settles: the normal turns by the offset over the distance, squared at every turn


@dataclass(frozen=True, eq=False)
class SofastRig:
    """scene: camera, facet and screen; a flat screen's cells are 1 mm, u along its x, v along its y.

    mask (H, W): camera pixels that see the facet. fractions (n, 2), points (n, 3): places on the screen
    (mm) of fractions (x, y) of the displayed image; linear between them. datum: the origin of SOFAST's optic
    frame, to which it measured the distance: a known point of the facet, mm.
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
        """(u, v) on the scene's pattern of fractions (x, y) of the image; NaN outside `fractions`."""
        from scipy.interpolate import LinearNDInterpolator

        if self.scene.pattern.shape is None:
            places = self.points[:, :2] - self.points[:, :2].min(axis=0)
        else:
            places = _cells(self.fractions, self.points)
        place = LinearNDInterpolator(self.fractions, places)(np.stack([x, y], axis=-1))
        return place[..., 0], place[..., 1]


def load_sofast_rig(path: str | Path | Sequence[str | Path], facet: str = FACET) -> SofastRig:
    """Read camera, display shape, pose and mask of a SOFAST result (facet: of an ensemble, by its group's
    name) or, where several files are given, of SOFAST's inputs: camera, display shape, orientation and
    measurement (HDF5), and the facet's definition (JSON) if there is one. InputError names missing fields
    or parts, and fields of another shape.

    Inputs do not contain the mirror's pose. It is taken as SOFAST starts: the middle of the lit pixels is
    at the measured distance from the screen and reflects the screen's centre; columns run along x. Heights
    refer to that plane. Where nobody defined the facet, its borders are those of the lit pixels on it.
    """
    paths = [Path(path)] if isinstance(path, str | Path) else [Path(each) for each in path]
    fields = sofast_fields(paths, facet)
    try:
        return _rig(fields if POSE[0] in fields else fields | _expected(fields))
    except InputError as error:
        raise InputError(f"{', '.join(map(str, paths))}: {error}") from error


def _rig(fields: Fields) -> SofastRig:
    fractions, points = _screen(fields)
    align, shift = _alignment(fields)
    to_optic = align @ _rotation(fields[POSE[0]])  # R_MC: camera to mirror frame
    centre = shift - to_optic @ _vector(fields[POSE[1]])  # of the camera, in the optic frame
    corners = _MM * fields[CORNERS][:2] if CORNERS in fields else _lit_box(fields, centre, to_optic)
    mirror = Mirror(*(float(extent) for extent in np.ptp(corners, axis=1)))
    offset = np.array([*(-corners.min(axis=1)), 0.0])
    origin = offset + centre
    screen = to_optic @ _rotation(fields[POSE[2]]).T
    screen_origin = to_optic @ _vector(fields[POSE[3]]) + origin
    scene = Scene(
        name="sofast",
        mirror=mirror,
        pattern=_pattern(screen_origin, screen, fractions, points),
        camera=_camera(fields, origin, to_optic),
    )
    x, y, z = (offset + _vector(fields.get(POINT, np.zeros(3)))).tolist()
    return SofastRig(scene, fields[MASK].astype(bool), fractions, points, (x, y, z))


def _lit_box(fields: Fields, centre: Float, to_optic: Float) -> Float:
    """Least and largest x, y (2, 2), mm, where the lit pixels look on the optic's plane."""
    row, col = (part.astype(np.float64) for part in np.nonzero(fields[MASK]))
    if not row.size:
        raise InputError(f"{MASK} is empty: no pixel sees the mirror")
    o, d = _camera(fields, centre, to_optic).rays_at(row, col)
    feet = (o - (o[:, 2:] / d[:, 2:]) * d)[:, :2]
    return np.stack([feet.min(axis=0), feet.max(axis=0)], axis=-1)


def _expected(fields: Fields) -> Fields:
    """Mask and pose of the optic, from inputs alone."""
    mask = _lit(fields[SHOTS])
    row, col = (float(part.mean()) for part in np.nonzero(mask))
    ray = _camera(fields, np.zeros(3), np.eye(3)).rays_at(row, col)[1]
    screen, distance = _vector(fields[POSE[3]]), _MM * float(fields[DISTANCE].item())
    centroid = _vector(fields.get(CENTROID, np.zeros(3)))
    aside, turn = np.zeros(3), np.eye(3)  # from the mirror's middle to the point whose distance is known
    for _ in range(_TURNS):
        to_screen = screen - aside
        root = (ray @ to_screen) ** 2 - to_screen @ to_screen + distance**2
        if not (root >= 0 and ray @ to_screen + np.sqrt(root) > 0):
            raise InputError(f"{DISTANCE} = {distance / _MM:g}: no point in view is so far from the screen")
        middle = (ray @ to_screen + np.sqrt(root)) * ray
        normal = _unit(_unit(-middle) + _unit(screen - middle))
        x_axis = _unit(np.array([1.0, 0.0, 0.0]) - normal[0] * normal)
        turn = np.stack([x_axis, np.cross(normal, x_axis), normal])
        aside = turn.T @ (_vector(fields.get(POINT, np.zeros(3))) - centroid)
    rotation = np.ravel(cv2.Rodrigues(turn)[0])
    return {MASK: mask, POSE[0]: rotation, POSE[1]: (middle - turn.T @ centroid) / _MM}


def _lit(images: NDArray[Any]) -> NDArray[np.bool_]:
    """Where white less black lies above Otsu's threshold, the largest connected part."""
    change = images[:, :, 1].astype(np.float64) - images[:, :, 0]
    levels = np.clip(change * 255 / max(float(change.max()), 1e-9), 0, 255).astype(np.uint8)
    lit = cv2.threshold(levels, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)[1]
    _, labels, boxes, _ = cv2.connectedComponentsWithStats(lit)
    if len(boxes) < 2:
        raise InputError(f"{SHOTS}: white is nowhere brighter than black")
    return np.asarray(labels == 1 + int(np.argmax(boxes[1:, cv2.CC_STAT_AREA])))


def _screen(fields: Fields) -> tuple[Float, Float]:
    """Fractions (n, 2) and their places on the screen (n, 3), mm, of the file's display model."""
    models = [model for model, names in MODELS.items() if any(n in fields for n in names if n != FRACTIONS)]
    if len(models) != 1 or any(name not in fields for name in MODELS[models[0]]):
        what = "none of the screen models whole" if len(models) < 2 else "fields of several screen models"
        needs = "; ".join(f"{model}: {', '.join(names)}" for model, names in MODELS.items())
        raise InputError(f"DisplayShape has {what} ({needs})")
    names = MODELS[models[0]]
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


def _camera(fields: Fields, origin: Float, rotation: Float) -> PinholeCamera:
    matrix, distortion, shape = (fields[name].squeeze() for name in CAMERA)
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


def _alignment(fields: Fields) -> tuple[Float, Float]:
    transform = fields.get(ALIGNMENT, np.eye(4)).astype(np.float64)
    return transform[:3, :3], _MM * transform[:3, 3]


def _unit(vector: Float) -> Float:
    length: Float = vector / np.linalg.norm(vector)
    return length


def _rotation(vector: NDArray[Any]) -> Float:
    return np.asarray(cv2.Rodrigues(vector.astype(np.float64).ravel())[0], dtype=np.float64)


def _vector(value: NDArray[Any]) -> Float:
    return _MM * value.astype(np.float64).ravel()
