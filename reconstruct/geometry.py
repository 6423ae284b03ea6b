"""The camera's rays as one padded array: the scene's part in the equations of the mirror."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.blocks import over_image
from optolever.errors import InputError
from optolever.scene import Scene

from .arrays import Floats

__all__ = ["PAD", "RayField", "pattern_plane", "ray_field", "rest_distance", "rest_height", "traced_rays"]

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

    def transposed(self) -> "RayField":
        """Rows and columns exchanged."""
        swap = (0, 2, 1)
        return RayField(
            np.ascontiguousarray(self.origins.transpose(swap)),
            np.ascontiguousarray(self.directions.transpose(swap)),
            self.logarithmic,
            parallel=self.parallel,
        )


def ray_field(camera: Any) -> RayField:
    """Rays of a camera's every pixel; the last ones are remembered: streams ask for the same again, on the
    grids of a rest capture and of a rig, too."""
    try:
        return _remembered(camera)
    except TypeError:  # a camera that cannot be hashed
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


def rest_height(x: Floats, y: Floats, scene: Scene) -> Floats:
    """z of the mirror at rest at x, y, mm."""
    form = scene.rest_form
    if form is None or not form.coefficients.any():
        return np.zeros(x.shape)
    return form.height(x, y, scene.mirror)


@lru_cache(maxsize=4)
def _remembered(camera: Any) -> RayField:
    return traced_rays(camera)


def traced_rays(camera: Any) -> RayField:
    """Rays of a camera's every pixel, not remembered."""
    rows = np.arange(-PAD, camera.rows + PAD, dtype=np.float64)
    cols = np.arange(-PAD, camera.cols + PAD, dtype=np.float64)
    origins, directions = (np.empty((3, rows.size, cols.size)) for _ in range(2))
    first = [part[:, None, None] for part in camera.rays_at(0.0, 0.0)]
    shifts, spreads, finite = list[float](), list[float](), list[bool]()

    def block(start: int, stop: int) -> None:
        found = camera.rays_at(rows[start:stop, None], cols)
        image = slice(max(start, PAD), min(stop, rows.size - PAD)), slice(PAD, -PAD)
        for part, out, one, away in zip(found, (origins, directions), first, (shifts, spreads), strict=True):
            out[:, start:stop] = np.moveaxis(part, -1, 0)
            away.append(float(np.abs(out[:, start:stop] - one).max()))
            finite.append(bool(np.isfinite(out[:, *image]).all()))

    over_image(block, (rows.size, cols.size))
    inner = (slice(None), slice(PAD, -PAD), slice(PAD, -PAD))
    if not all(finite):
        raise InputError("scene: the camera has pixels without a finite ray")
    shift, spread = (float(np.max(away)) for away in (shifts, spreads))  # NaN of one is that of all
    seen = directions[inner] if spread != 0 else directions[:, :1, :1]
    return RayField(origins, directions, spread > 0 and shift == 0, _lean(seen), spread == 0)


def _lean(directions: Floats) -> NDArray[np.float32]:
    with np.errstate(divide="ignore", invalid="ignore"):
        lean: NDArray[np.float32] = (directions[:2] / directions[2]).astype(np.float32)
    first = lean[:, :1, :1]
    return first.copy() if bool((lean == first).all()) else lean
