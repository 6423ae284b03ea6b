"""The camera's rays as one padded array, and where the mirror at rest reflects them: the scene's part in the
equations of the mirror."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from optolever.arrays import Floats
from optolever.blocks import Work, over_rows
from optolever.errors import InputError
from optolever.scene import Camera, Scene

__all__ = [
    *("PAD", "RayField", "flat_mirror", "pattern_plane", "ray_field", "rest_distance", "rest_height"),
    *("sagging_distance", "traced_rays"),
]

_BLOCK = 1 << 14  # pixels at once: what they need stays in the cache
_FORM_STEPS = 4  # each leaves the form's slope times the ray's, some thousandths
PAD = 2  # pixels beyond the image on every side: the reach of a 4th-order central difference


@dataclass(frozen=True, slots=True)
class RayField:
    """Rays of a pixel grid, padded by PAD pixels on every side.

    origins, directions: (3, rows + 2 PAD, cols + 2 PAD) mm and unit vectors, mirror frame.
    logarithmic: solve for log t instead of t. True where the rays diverge from one centre: there the
    distance scales with the field, and its slope over the distance is free of that scale.
    lean: of a full image, dx/dz and dy/dz along the rays, (2, rows, cols), or (2, 1, 1) if all are parallel;
    parallel: whether they are.
    """

    origins: Floats
    directions: Floats
    logarithmic: bool
    lean: NDArray[np.float32] | None = None
    parallel: bool = False

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the grid without its padding."""
        return self.origins.shape[1] - 2 * PAD, self.origins.shape[2] - 2 * PAD

    @property
    def inner_origins(self) -> Floats:
        """Origins without the padding, (3, rows, cols) mm."""
        return self.origins[:, PAD:-PAD, PAD:-PAD]

    @property
    def inner_directions(self) -> Floats:
        """Directions without the padding, (3, rows, cols)."""
        return self.directions[:, PAD:-PAD, PAD:-PAD]

    def cropped(self, rows: slice, cols: slice) -> "RayField":
        """The rays of a window (plain slices with start and stop, step one)."""
        if (rows.stop - rows.start, cols.stop - cols.start) == self.shape:
            return self
        window = (slice(None), slice(rows.start, rows.stop + 2 * PAD), slice(cols.start, cols.stop + 2 * PAD))
        return RayField(
            np.ascontiguousarray(self.origins[window]),
            np.ascontiguousarray(self.directions[window]),
            self.logarithmic,
            parallel=self.parallel,
        )


@lru_cache(maxsize=4)
def ray_field(camera: Camera) -> RayField:
    """Rays of a camera's every pixel; the last ones are remembered: streams ask for the same again, on the
    grids of a rest capture and of a rig, too."""
    return traced_rays(camera)


def pattern_plane(scene: Scene) -> Floats:
    """Pattern plane as a (3, 3) array: origin, step of u, step of v, mm; X(u,
    v) = row 0 + u row 1 + v row 2.
    """
    pattern = scene.pattern
    return np.vstack([np.asarray(pattern.origin, dtype=np.float64), pattern.steps])


def rest_distance(origins: Floats, directions: Floats) -> Floats:
    """Distance along the ray to the mirror at rest, z = 0, mm; arrays (3, ...) -> (...)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        distance: Floats = -origins[2] / directions[2]
    return distance


def sagging_distance(origins: Floats, directions: Floats, scene: Scene) -> Floats:
    """`rest_distance` to the mirror's form at rest."""
    distance = rest_distance(origins, directions)
    for _ in range(_FORM_STEPS if scene.rest_form is not None else 0):
        x, y, _ = origins + distance * directions
        distance = (rest_height(x, y, scene) - origins[2]) / directions[2]
    return distance


def rest_height(x: Floats, y: Floats, scene: Scene) -> Floats:
    """z of the mirror at rest at x, y, mm."""
    form = scene.rest_form
    if form is None or not form.coefficients.any():
        return np.zeros(x.shape)
    return form.height(x, y, scene.mirror)


def traced_rays(camera: Camera) -> RayField:
    """Rays of a camera's every pixel, not remembered."""
    rows = np.arange(-PAD, camera.rows + PAD, dtype=np.float64)
    cols = np.arange(-PAD, camera.cols + PAD, dtype=np.float64)
    origins, directions = (np.empty((3, rows.size, cols.size)) for _ in range(2))
    finite = list[bool]()

    def block(start: int, stop: int) -> None:
        found = camera.rays_at(rows[start:stop, None], cols)
        image = slice(max(start, PAD), min(stop, rows.size - PAD)), slice(PAD, -PAD)
        for part, out in zip(found, (origins, directions), strict=True):
            out[:, start:stop] = np.moveaxis(part, -1, 0)
            finite.append(bool(np.isfinite(out[:, *image]).all()))

    _by_rows(block, rows.size, cols.size)
    inner = (slice(None), slice(PAD, -PAD), slice(PAD, -PAD))
    if not all(finite):
        raise InputError("scene: the camera has pixels without a finite ray")
    # NaN of a ray beyond the image is that of all
    shift, spread = (float(np.ptp(part, axis=(1, 2)).max()) for part in (origins, directions))
    seen = directions[inner] if spread != 0 else directions[:, :1, :1]
    return RayField(origins, directions, spread > 0 and shift == 0, _lean(seen), spread == 0)


def _lean(directions: Floats) -> NDArray[np.float32]:
    with np.errstate(divide="ignore", invalid="ignore"):
        lean: NDArray[np.float32] = (directions[:2] / directions[2]).astype(np.float32)
    first = lean[:, :1, :1]
    return first.copy() if bool((lean == first).all()) else lean


def flat_mirror(scene: Scene, rays: RayField | None = None) -> Floats:
    """Place on the pattern's surface of every pixel by the mirror at rest, u and v (2, H, W); NaN where there
    is none. rays: of the scene's camera, if they are known.

    Neither mirror nor pattern nor medium end: a scene that is a little wrong has its edges elsewhere, and the
    capture at rest shows where they are.
    """
    rays = ray_field(scene.camera) if rays is None else rays
    (rows, cols), found = rays.shape, np.empty((2, *rays.shape))

    def block(start: int, stop: int) -> None:
        some = slice(None), slice(start, stop)
        found[some] = _reflected(scene, rays.inner_origins[some], rays.inner_directions[some])

    _by_rows(block, rows, cols)
    return found


def _by_rows(work: Work, rows: int, cols: int) -> None:
    """On all cores; few pixels on the calling thread."""
    if rows * cols <= _BLOCK:
        work(0, rows)
    else:
        over_rows(work, rows, max(1, _BLOCK // cols))


def _reflected(scene: Scene, o: Floats, d: Floats) -> Floats:
    """`flat_mirror` of rays (3, n, W)."""
    away, ahead = sagging_distance(o, d, scene), rest_distance(o, d) > 0
    out = d * np.array([1.0, 1.0, -1.0])[:, None, None]
    if scene.rest_form is not None and scene.rest_form.coefficients.any():
        x, y, _ = o + away * d
        hx, hy = scene.rest_form.slopes(x, y, scene.mirror)
        normal = np.stack([-hx, -hy, np.ones_like(hx)])
        out = d - 2 * (d * normal).sum(axis=0) / (normal * normal).sum(axis=0) * normal
    u, v, way = scene.pattern.landing((o + away * d).reshape(3, -1), out.reshape(3, -1))
    with np.errstate(invalid="ignore"):
        seen = (way.reshape(away.shape) > 0) & ahead
    return np.where(seen, np.stack([u, v]).reshape(2, *away.shape), np.nan)
