"""The rig of an OpenCSP SOFAST result, or of its inputs, as a scene: camera, facet, the screen as a pattern.

SOFAST's conventions: metres; r_A_B is a rotation vector that maps frame A to B, v_A_B_C runs from A to B in
frame C; trans_alignment acts on the optic frame last. Its optic frame has the facet's centre in the middle
and the camera at +z; the mirror frame here is the same, moved so that the facet starts at x = y = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator

from optolever.arrays import Floats
from optolever.decode import Correspondence, Flag
from optolever.errors import InputError
from optolever.scene import Mirror, Pattern, PinholeCamera, PointTable, Scene

from .sofast_files import COLS, ROWS, Fields, rig_fields

__all__ = ["SofastRig", "load_sofast_rig", "on_rig"]

_MM = 1000.0
_TURNS = 10  # the pose settles: the normal turns by the offset over the distance, squared at every turn


@dataclass(frozen=True, eq=False)
class SofastRig:
    """A rig of SOFAST as a scene. scene: camera, facet and screen; a flat screen's cells are 1 mm, u along
    its x, v along its y.

    mask (H, W): camera pixels that see the facet. fractions (n, 2), cells (n, 2): places on the pattern of
    fractions (x, y) of the displayed image; linear between them. datum: the origin of SOFAST's optic
    frame, to which it measured the distance: a known point of the facet, mm.
    """

    scene: Scene
    mask: NDArray[np.bool_]
    fractions: Floats
    cells: Floats
    datum: tuple[float, float, float]

    def pattern_coordinates(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """(u, v) on the scene's pattern of fractions (x, y) of the image; NaN outside `fractions`."""
        place = LinearNDInterpolator(self.fractions, self.cells)(np.stack([x, y], axis=-1))
        return place[..., 0], place[..., 1]


def load_sofast_rig(path: str | Path | Sequence[str | Path], facet: str = "facet_000") -> SofastRig:
    """The rig of a SOFAST result (facet: of an ensemble, by its group's name) or, of several files, of its
    inputs: camera, display shape, orientation, measurement (HDF5), and the facet's definition (JSON) if there
    is one. InputError names missing fields, and fields of another shape.

    Inputs do not contain the mirror's pose. It is taken as SOFAST starts: the middle of the lit pixels is
    at the measured distance from the screen and reflects the screen's centre; columns run along x. Heights
    refer to that plane. Where nobody defined the facet, its borders are those of the lit pixels on it.
    """
    paths = [Path(path)] if isinstance(path, str | Path) else [Path(each) for each in path]
    try:
        fields = rig_fields(paths, facet)
        return _rig(fields if "r_cam_optic" in fields else fields | _expected(fields))
    except InputError as error:
        named = str(error).startswith(tuple(map(str, paths)))
        raise error if named else InputError(f"{', '.join(map(str, paths))}: {error}") from error


def on_rig(correspondence: Correspondence, rig: SofastRig) -> Correspondence:
    """The correspondence in cells of the rig's pattern (1 mm) instead of the screen's nominal pixels.

    Pixels that do not see the facet, or that see an unmeasured part of the screen, are INVALID.
    """
    shape = correspondence.u.shape
    if shape != rig.mask.shape:
        raise InputError(f"correspondence: shape {shape}, the SOFAST rig's camera has {rig.mask.shape}")
    width, height = np.ptp(rig.cells, axis=0).tolist()
    u, v = rig.pattern_coordinates(correspondence.u / COLS, 1.0 - correspondence.v / ROWS)
    seen = rig.mask & np.isfinite(u) & np.isfinite(v)
    return replace(
        correspondence,
        u=np.where(seen, u, np.nan),
        v=np.where(seen, v, np.nan),
        sigma_u=correspondence.sigma_u * (width / COLS),
        sigma_v=correspondence.sigma_v * (height / ROWS),
        flags=(correspondence.flags | np.where(seen, 0, int(Flag.INVALID))).astype(np.uint16),
    )


def _rig(fields: Fields) -> SofastRig:
    fractions, points = _screen(fields)
    transform = fields.get("trans_alignment", np.eye(4)).astype(np.float64)
    to_optic = transform[:3, :3] @ _rotation(fields["r_cam_optic"])  # R_MC: camera to mirror frame
    camera = _vector(fields, "v_cam_optic_cam")
    centre = _MM * transform[:3, 3] - to_optic @ camera  # of the camera, in the optic frame
    defined = "v_facet_corners" in fields
    corners = _MM * fields["v_facet_corners"][:2] if defined else _lit_box(fields, centre, to_optic)
    offset = np.array([*(-corners.min(axis=1)), 0.0])
    screen = to_optic @ _rotation(fields["r_cam_screen"]).T
    origin = offset + centre
    start = to_optic @ _vector(fields, "v_cam_screen_cam") + origin
    pattern, cells = _pattern(start, screen, fractions, points)
    mirror = Mirror(*np.ptp(corners, axis=1).tolist())
    scene = Scene("sofast", mirror, pattern, _camera(fields, origin, to_optic))
    x, y, z = (offset + _vector(fields, "v_measure_point_facet")).tolist()
    return SofastRig(scene, fields["mask_processed"].astype(bool), fractions, cells, (x, y, z))


def _lit_box(fields: Fields, centre: Floats, to_optic: Floats) -> Floats:
    """Least and largest x, y (2, 2), mm, where the lit pixels look on the optic's plane."""
    row, col = (part.astype(np.float64) for part in np.nonzero(fields["mask_processed"]))
    if not row.size:
        raise InputError("mask_processed is empty: no pixel sees the mirror")
    o, d = _camera(fields, centre, to_optic).rays_at(row, col)
    feet = (o - (o[:, 2:] / d[:, 2:]) * d)[:, :2]
    return np.stack([feet.min(axis=0), feet.max(axis=0)], axis=-1)


def _expected(fields: Fields) -> Fields:
    """Mask and pose of the optic, from inputs alone."""
    mask = _lit(fields["mask_images"])
    row, col = (float(part.mean()) for part in np.nonzero(mask))
    ray = _camera(fields, np.zeros(3), np.eye(3)).rays_at(row, col)[1]
    screen, distance = _vector(fields, "v_cam_screen_cam"), _MM * float(fields["dist_optic_screen"].item())
    centroid = _vector(fields, "v_facet_centroid")
    aside, turn = np.zeros(3), np.eye(3)  # from the mirror's middle to the point whose distance is known
    for _ in range(_TURNS):
        to_screen = screen - aside
        root = (ray @ to_screen) ** 2 - to_screen @ to_screen + distance**2
        if not (root >= 0 and ray @ to_screen + np.sqrt(root) > 0):
            raise InputError(f"dist_optic_screen = {distance / _MM:g}: no point in view is so far off")
        middle = (ray @ to_screen + np.sqrt(root)) * ray
        normal = _unit(_unit(-middle) + _unit(screen - middle))
        x_axis = _unit(np.array([1.0, 0.0, 0.0]) - normal[0] * normal)
        turn = np.stack([x_axis, np.cross(normal, x_axis), normal])
        aside = turn.T @ (_vector(fields, "v_measure_point_facet") - centroid)
    place = (middle - turn.T @ centroid) / _MM
    return {"mask_processed": mask, "r_cam_optic": np.ravel(cv2.Rodrigues(turn)[0]), "v_cam_optic_cam": place}


def _lit(images: NDArray[Any]) -> NDArray[np.bool_]:
    """Where white less black lies above Otsu's threshold, the largest connected part."""
    change = images[:, :, 1].astype(np.float64) - images[:, :, 0]
    levels = np.clip(change * 255 / max(float(change.max()), 1e-9), 0, 255).astype(np.uint8)
    lit = cv2.threshold(levels, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)[1]
    _, labels, boxes, _ = cv2.connectedComponentsWithStats(lit)
    if len(boxes) < 2:
        raise InputError("mask_images: white is nowhere brighter than black")
    return np.asarray(labels == 1 + int(np.argmax(boxes[1:, cv2.CC_STAT_AREA])))


def _screen(fields: Fields) -> tuple[Floats, Floats]:
    """Fractions (n, 2) and their places on the screen (n, 3), mm, of the file's display model."""
    if {"screen_x", "screen_y"} <= fields.keys():
        fractions = np.array([[0.0, 1.0, 0.0, 1.0], [0.0, 0.0, 1.0, 1.0]])
        size = np.array([[fields["screen_x"].item()], [fields["screen_y"].item()]])
        points = (fractions - 0.5) * size
    elif "xy_screen_fraction" in fields and ("xy_screen_coords" in fields or "xyz_screen_coords" in fields):
        fractions = fields["xy_screen_fraction"].astype(np.float64)
        points = next(fields[name] for name in ("xyz_screen_coords", "xy_screen_coords") if name in fields)
    else:
        raise InputError("DisplayShape has none of the screen models: screen_x, screen_y, or fractions")
    if fractions.shape[1] != points.shape[1] or points.shape[1] < 3:
        raise InputError(f"DisplayShape: {fractions.shape} fractions, {points.shape}: must be n >= 3 places")
    return fractions.T, _MM * np.pad(points.T.astype(np.float64), ((0, 0), (0, 3 - len(points))))


def _pattern(origin: Floats, axes: Floats, fractions: Floats, points: Floats) -> tuple[Pattern, Floats]:
    """The screen, axes (3, 3) in columns, and the cells (n, 2) of the measured places: flat, 1 mm from their
    corner on; else both fractions by one factor, so that the triangles between places are SOFAST's."""
    corner = np.array([*points[:, :2].min(axis=0), 0.0])
    cells, shape = points[:, :2] - corner[:2], None
    if points[:, 2].any():
        cells = np.ptp(points, axis=0).max() * (fractions - fractions.min(axis=0))
        shape = PointTable(cells, points - corner - np.pad(cells, ((0, 0), (0, 1))))
    cols, rows = (int(np.ceil(extent)) for extent in np.ptp(cells, axis=0))
    start = origin + axes @ corner
    return Pattern(start, axes[:, 0], axes[:, 1], 1.0, rows=rows, cols=cols, shape=shape), cells


def _camera(fields: Fields, origin: Floats, rotation: Floats) -> PinholeCamera:
    matrix, distortion, (cols, rows) = (
        fields[name].squeeze() for name in ("intrinsic_mat", "distortion_coef", "image_shape_xy")
    )
    focal, centre = np.diag(matrix)[:2], matrix[:2, 2]
    axes = rotation[:, 0], rotation[:, 1]
    return PinholeCamera(origin, *axes, focal, centre, int(rows), int(cols), distortion)


def _unit(vector: Floats) -> Floats:
    return np.asarray(vector / np.linalg.norm(vector))


def _rotation(vector: NDArray[Any]) -> Floats:
    return np.asarray(cv2.Rodrigues(vector.astype(np.float64).ravel())[0], dtype=np.float64)


def _vector(fields: Fields, name: str) -> Floats:
    """A field in mm; 0 where there is none."""
    return _MM * fields.get(name, np.zeros(3)).astype(np.float64).ravel()
