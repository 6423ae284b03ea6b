"""A nominal surface, from a height map or a mesh, and its rigid best fit to a measured map.

The measured points move as a rigid body, Q = R(a) (P - c) + c + t, with the minimal sum of squares of the
differences Q_z - N(Q_x, Q_y) to the nominal surface N (Gauss-Newton). Directions with less effect on the
differences than what is left, such as rotation about the axis of a sphere, are fixed.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from optolever.arrays import Floats
from optolever.errors import InputError, damage_of, require_file
from optolever.maps import READABLE, read_grid
from optolever.reconstruct import Diagnostics, Grid, HeightFlag, HeightMap, SlopeMap

from .fit import FOREIGN, FormFit, Numbers, leftovers, placed, slope_noise
from .functionals import noise_covariance

__all__ = [
    "NOMINAL_SUFFIXES", "Nominal", "extended", "fit_nominal", "grid_of", "load_measured", "load_nominal",
    "surface_of",
]  # fmt: skip

NOMINAL_SUFFIXES = (".npz", *READABLE, ".stl", ".ply")
_STEPS, _SETTLED = 30, 1e-6  # of the residual's rms
_WEAK = 1e-6  # of the strongest direction's effect: weaker directions are fixed
_FAR = 0.1  # of half the map's width: a motion so far that changes less than is left is fixed
_MOST = 20_000  # points of the fit
_ORDER = 4  # of the polynomials that may look like motion
_NUDGE = 1e-4  # step of differences over half the map's width
_NAMES = ("shift_x", "shift_y", "shift_z", "turn_x", "turn_y", "turn_z")


@dataclass(frozen=True, slots=True)
class Nominal:
    """z(x, y) in mm, NaN outside its border, and the middle of its area (x, y, z), mm."""

    z: Callable[[Floats, Floats], Floats]
    middle: tuple[float, float, float]


def load_nominal(path: str | Path) -> Nominal:
    """From an .npz of a height map or a grid, a grid of another program (`optolever.maps`), or a mesh (.stl,
    .ply, mm).

    The vertices of a mesh are points of a smooth surface z(x, y). InputError for other files, for a TIFF
    without a scale, and for a mesh if trimesh is not installed.
    """
    file = Path(path)
    require_file(file)
    suffix = file.suffix.lower()
    if suffix not in NOMINAL_SUFFIXES:
        raise InputError(f"{file}: suffix {suffix!r}, must be {' or '.join(NOMINAL_SUFFIXES)}")
    if suffix in (".stl", ".ply"):
        return _of_points(file, _vertices(file))
    grid = grid_of(file)
    return surface_of(HeightMap.load(file).resample() if grid is None else grid)


def fit_nominal(
    height: HeightMap,
    nominal: Nominal,
    name: str = "nominal",
    aperture: NDArray[np.bool_] | None = None,
    slopes: SlopeMap | None = None,
) -> FormFit:
    """The rigid best fit of a map to a nominal surface: translation (mm) and rotation (degrees) of the map
    about its middle, relative to coinciding middles; residual along the nominal's z. aperture (H, W): pixels
    to use; slopes: see `fit_form`.

    sigma by noise: that of the slopes, where it is known, and as much of a motion as is left in one
    polynomial of x and y, since a changed figure looks like motion; infinite of a motion that changes
    less than is left, which stays 0. shift_z hangs on the anchor and has none.

    InputError if less than half of the map lies on the nominal surface.
    """
    x, y, good, middle = placed(height, len(_NAMES), aperture)
    points = np.stack([x[good], y[good], height.z[good]], axis=1)
    centre = np.array([0.0, 0.0, float(points[:, 2].mean())])
    points = points - centre
    half = 0.5 * max(float(np.ptp(points[:, 0])), float(np.ptp(points[:, 1])), 1e-9)

    def left(p: Floats, some: Floats) -> Floats:
        """Differences to the nominal surface; p: translation, and rotation times half the width, mm."""
        moved = Rotation.from_rotvec(p[3:] / half).apply(some) + p[:3] + nominal.middle
        return np.asarray(moved[:, 2] - nominal.z(moved[:, 0], moved[:, 1]))

    step = max(1, len(points) // _MOST)
    used = points[::step]
    p, free = np.zeros(len(_NAMES)), np.eye(len(_NAMES))
    p[2] = -_mean(left(p, used))
    start = p
    for _ in range(_STEPS):
        rest = left(p, used)
        nudges = _NUDGE * half * np.eye(len(p))
        jacobian = np.stack(
            [(left(p + n, used) - left(p - n, used)) / (2 * _NUDGE * half) for n in nudges], axis=1
        )
        known = np.isfinite(rest) & np.isfinite(jacobian).all(axis=1)
        if np.count_nonzero(known) < 0.5 * len(used):
            share = 100 * np.count_nonzero(known) / len(used)
            raise InputError(
                f"{name}: covers {share:.0f} % of the measured map, must be at least 50 %; give a larger one"
            )
        rest, jacobian = rest[known], jacobian[known]
        move = -free @ np.linalg.lstsq(jacobian @ free, rest, rcond=_WEAK)[0]
        p = p + move
        if np.abs(jacobian @ move).max() <= _SETTLED * max(float(np.std(rest)), 1e-9):
            _, s, directions = np.linalg.svd(jacobian, full_matrices=False)
            sure = s > np.maximum(_WEAK * s[0], np.linalg.norm(rest) / (_FAR * half))
            if free.shape[1] <= np.count_nonzero(sure):
                break
            p, free = start, directions[sure].T
    weights, rig = np.zeros((len(points), len(p))), np.zeros(len(p))
    weights[::step][known] = (free @ np.linalg.pinv(jacobian @ free)).T
    noise = np.linalg.norm(weights, axis=0) * _in_one_term(rest, used[known, :2] / half)
    if (own := slope_noise(height, slopes)) is not None:
        noise = np.hypot(noise, np.sqrt(np.diag(noise_covariance(weights, x, y, good, own))))
    if (modes := height.calibration) is not None:
        rig = np.linalg.norm(np.nan_to_num(modes[:, good]).astype(np.float64) @ weights, axis=0)
    residual = np.full(height.z.shape, np.nan)
    residual[good] = left(p, points)
    p[:3] += np.array([nominal.middle[k] - (*middle, centre[2])[k] for k in range(3)])
    fixed = np.sum(free**2, axis=1) < 0.5
    p[fixed], noise[fixed], noise[2] = 0.0, np.inf, np.nan
    scale = np.repeat([1.0, np.degrees(1 / half)], 3)
    found = Numbers(_NAMES, scale * p, scale * noise, scale * rig)
    inside = np.isfinite(residual)
    basis = np.stack([np.ones(int(inside.sum())), x[inside], y[inside]], axis=1)
    left_over = leftovers(basis, residual, height, x, y, inside, slopes)
    return FormFit(name, found, {}, height.x, height.y, residual, middle, *left_over)


def _in_one_term(left: Floats, at: Floats) -> float:
    """Root mean square over polynomials of the places `at` (n, 2), orthonormal over the points, of their
    coefficients in what is left (n,) by a motion, which takes as many as it has numbers."""
    powers = [(i, k - i) for k in range(_ORDER + 1) for i in range(k + 1)]
    terms, _ = np.linalg.qr(np.stack([at[:, 0] ** i * at[:, 1] ** j for i, j in powers], axis=1))
    return float(np.linalg.norm(terms.T @ left) / np.sqrt(len(powers) - len(_NAMES)))


def _mean(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else 0.0


def surface_of(grid: Grid) -> Nominal:
    """The surface of a grid by cubic splines; cells adjacent to unknown points are unknown."""
    known = np.isfinite(grid.z)
    if min(grid.z.shape) < 4 or not known.any():
        raise InputError(f"nominal: {grid.z.shape} points, must be at least (4, 4), some of them known")
    inside, whole = known.astype(np.float64), extended(grid)

    def z(x: Floats, y: Floats) -> Floats:
        at = np.stack([(y - grid.y0) / grid.pitch, (x - grid.x0) / grid.pitch])
        there = scipy.ndimage.map_coordinates(inside, at, order=1, cval=0.0) > 1 - 1e-9
        return np.where(there, whole(x, y), np.nan)

    rows, cols = np.nonzero(known)
    middle = [grid.x0 + 0.5 * grid.pitch * (cols.min() + cols.max())]
    middle += [grid.y0 + 0.5 * grid.pitch * (rows.min() + rows.max()), float(grid.z[known].mean())]
    return Nominal(z, (middle[0], middle[1], middle[2]))


def extended(grid: Grid) -> Callable[[Floats, Floats], Floats]:
    """z(x, y) of a grid by cubic splines; unknown points are as the nearest known one."""
    unknown = ~np.isfinite(grid.z)
    nearest = scipy.ndimage.distance_transform_edt(unknown, return_distances=False, return_indices=True)
    filled = np.asarray(grid.z[tuple(nearest)], np.float64)
    # the last rows go on as straight lines, so that the splines' mirrored ends lie outside
    coefficients = scipy.ndimage.spline_filter(np.pad(filled, 12, "reflect", reflect_type="odd"))

    def z(x: Floats, y: Floats) -> Floats:
        at = np.stack([(y - grid.y0) / grid.pitch, (x - grid.x0) / grid.pitch])
        return np.asarray(scipy.ndimage.map_coordinates(coefficients, at + 12, order=3, prefilter=False))

    return z


def _of_points(file: Path, points: Floats) -> Nominal:
    """Piecewise cubic interpolation on triangles between points (n, 3)."""
    try:
        smooth = scipy.interpolate.CloughTocher2DInterpolator(points[:, :2], points[:, 2])
    except (ValueError, RuntimeError) as error:
        raise InputError(
            f"{file}: its points are no surface z(x, y) ({str(error).splitlines()[0]})"
        ) from error
    low, high = points.min(axis=0), points.max(axis=0)
    x, y = 0.5 * (low + high)[:2]
    return Nominal(lambda a, b: np.asarray(smooth(a, b)), (float(x), float(y), float(points[:, 2].mean())))


def load_measured(path: str | Path) -> HeightMap:
    """A height map's or grid's .npz, or a grid of another program (`optolever.maps`), whose sigma is 0."""
    file = Path(path)
    if (grid := grid_of(file)) is None:
        return HeightMap.load(file)
    x, y = np.meshgrid(grid.x, grid.y)
    flags = np.where(np.isfinite(grid.z), 0, int(HeightFlag.NO_ANCHOR)).astype(np.uint16)
    return HeightMap(x, y, grid.z, grid.sigma, flags, Diagnostics(FOREIGN))


def grid_of(path: str | Path) -> Grid | None:
    """The grid of another program's file or of a Grid's .npz; None of any other."""
    file = Path(path)
    if file.suffix.lower() in READABLE:
        z, pitch, x0, y0 = read_grid(file)
        return Grid(z, np.zeros(z.shape), x0, y0, pitch)
    try:
        with zipfile.ZipFile(file) as archive:
            return Grid.load(file) if "pitch.npy" in archive.namelist() else None
    except (OSError, zipfile.BadZipFile):  # named by the reader
        return None


def _vertices(file: Path) -> Floats:
    """Different points (n, 3) of a mesh."""
    try:
        import trimesh
    except ImportError as error:
        raise InputError(f"{file}: a mesh needs trimesh; pip install 'optolever[mesh]'") from error
    try:
        points = np.asarray(trimesh.load_mesh(file).vertices, np.float64)
    except Exception as error:  # a reader of another project, on any file
        raise InputError(f"{file}: not a readable mesh ({damage_of(error)})") from error
    points = np.unique(points, axis=0)
    if len(points) < 4 or not np.isfinite(points).all():
        raise InputError(f"{file}: {len(points)} points, must be at least 4, all finite")
    return points
