"""SlopeMap: the surface's slopes by the law of reflection, without differencing heights.

The normal bisects the ray back to the camera and the one to the pattern: n ~ (X - P)/|X - P| - d; the slopes
are -n_x/n_z and -n_y/n_z. Their noise is that of u and v; the height's error dt moves n by
dt ((d.e) e - d)/|X - P|, e the unit vector along X - P.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from optolever.arrays import Floats, Mask
from optolever.decode import Correspondence
from optolever.errors import InputError
from optolever.files import save_arrays
from optolever.records import Axes, Comparable, plot_maps, span
from optolever.scene import Scene
from optolever.schema import load_record, require_shapes

from ..geometry import pattern_plane, ray_field
from ..heightmap import HeightMap, Modes, expanded, filled, sum_of_squares
from ..rig.calibration import rest_corrected
from .resampling import gradients

__all__ = ["SlopeMap", "slope_map", "with_slope_noise"]

_ARRAYS = ("x", "y", "slope_x", "slope_y", "sigma_x", "sigma_y", "flags")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SlopeMap(Comparable):
    """dz/dx and dz/dy on the camera's pixels, (H, W) each; x, y in mm, slopes and their sigmas mm per mm.

    flags: those of the height map; NaN where the height is. modes: (r, 2, rows, cols) on every
    `modes_step`-th pixel, linear between: change of both slopes by one standard deviation of each error of
    the rig, apart from the sigmas. None: the height map has no modes.
    """

    x: Annotated[Floats, "H W"]
    y: Annotated[Floats, "H W"]
    slope_x: Annotated[Floats, "H W"]
    slope_y: Annotated[Floats, "H W"]
    sigma_x: Annotated[Floats, "H W"]
    sigma_y: Annotated[Floats, "H W"]
    flags: Annotated[NDArray[np.uint16], "H W"]
    modes: Annotated[Modes, "r 2 rows cols"] | None = None
    modes_step: int = 1

    def __post_init__(self) -> None:
        require_shapes(self)

    def __repr__(self) -> str:
        good = self.good
        rows, cols = good.shape
        return "\n".join(
            [f"SlopeMap: {rows} x {cols} pixels, {100 * good.mean():.4g} % good"]
            + [
                f"  slope_{name} {span(slope, good)}, sigma {span(sigma, good)} mm per mm"
                for name, slope, sigma in (
                    ("x", self.slope_x, self.sigma_x),
                    ("y", self.slope_y, self.sigma_y),
                )
            ]
        )

    def plot(self, axes: Any = None) -> Axes:
        """Draw both slopes of the good pixels with matplotlib; the axes."""
        maps = {"slope_x [mm/mm]": self.slope_x, "slope_y [mm/mm]": self.slope_y}
        return plot_maps({title: np.where(self.good, one, np.nan) for title, one in maps.items()}, axes)

    @property
    def good(self) -> Mask:
        """True where no flag is set."""
        return np.asarray(self.flags == 0)

    @property
    def total_sigma(self) -> tuple[Floats, Floats]:
        """Standard deviations of slope_x and slope_y: noise and rig."""
        if self.modes is None:
            return self.sigma_x, self.sigma_y
        rig = [np.sqrt(sum_of_squares(self.modes[:, k], self.modes_step, self.x.shape)) for k in (0, 1)]
        return np.hypot(self.sigma_x, rig[0]), np.hypot(self.sigma_y, rig[1])

    @property
    def calibration(self) -> Modes | None:
        """The modes on all pixels, (r, 2, H, W); made anew at every call."""
        if self.modes is None:
            return None
        known = np.isfinite(self.slope_x)
        return np.stack([expanded(self.modes[:, k], self.modes_step, known) for k in (0, 1)], axis=1)

    def save(self, path: str | Path) -> None:
        """Write an .npz with the fields' names."""
        save_arrays(path, {name: getattr(self, name) for name in (*_ARRAYS, "modes", "modes_step")})

    @classmethod
    def load(cls, path: str | Path) -> SlopeMap:
        """Read what save() wrote; InputError names the file and the field."""
        found = load_record(cls, path)
        if any((sigma[found.good] <= 0).any() for sigma in (found.sigma_x, found.sigma_y)):
            raise InputError(f"{path}: sigma_x, sigma_y must be above 0 at pixels without a flag")
        return found


def slope_map(
    height: HeightMap, correspondence: Correspondence, scene: Scene, rest: Correspondence | None = None
) -> SlopeMap:
    """Slopes at the mirror points of a height map, from the correspondence that it was reconstructed from.

    rest: as in `reconstruct`. A map less a rest capture needs the same here: without it the slopes are
    absolute, with the rig's deviation. InputError if the shapes do not agree.
    """
    if correspondence.u.shape != height.z.shape:
        raise InputError(f"correspondence: shape {correspondence.u.shape}, the height map {height.z.shape}")
    if height.z.shape != (scene.camera.rows, scene.camera.cols):
        raise InputError(
            f"height map: shape {height.z.shape}, the scene's camera has "
            f"{scene.camera.rows} x {scene.camera.cols} pixels"
        )
    if rest is not None:
        correspondence = rest_corrected(correspondence, rest, scene)
    plane, d = pattern_plane(scene), ray_field(scene.camera).inner_directions
    point = (height.x, height.y, height.z)
    known = np.isfinite(height.z)
    u, v = (np.where(known, part, np.nan).astype(np.float64) for part in (correspondence.u, correspondence.v))
    if scene.pattern.shape is None:
        away = [plane[0, k] + u * plane[1, k] + v * plane[2, k] - point[k] for k in range(3)]
    else:
        away = [part - point[k] for k, part in enumerate(np.moveaxis(scene.pattern.point(u, v), -1, 0))]
    inverse = 1.0 / np.sqrt(away[0] ** 2 + away[1] ** 2 + away[2] ** 2)
    e = [part * inverse for part in away]
    n = [e[k] - d[k] for k in range(3)]
    slopes = [-n[k] / n[2] for k in (0, 1)]
    with np.errstate(divide="ignore"):
        along = height.sigma / np.abs(d[2])
    variances = [np.zeros(u.shape), np.zeros(u.shape)]
    for direction, sigma in (
        (plane[1], correspondence.sigma_u),
        (plane[2], correspondence.sigma_v),
        (d, along),
    ):
        for k, change in enumerate(_moved(direction, e, n, slopes)):
            with np.errstate(invalid="ignore"):  # 0 times the infinite sigma of a method that states none
                term = (change * inverse * sigma) ** 2
            variances[k] += np.where(np.isposinf(sigma), np.inf, term)
    fields: dict[str, Any] = {
        "slope_x": slopes[0],
        "slope_y": slopes[1],
        "sigma_x": np.sqrt(variances[0]),
        "sigma_y": np.sqrt(variances[1]),
    }
    fields = {name: np.where(known, field, np.nan) for name, field in fields.items()}
    of_rig: dict[str, Any] = {"modes": _mode_slopes(height), "modes_step": height.modes_step}
    return SlopeMap(height.x, height.y, flags=height.flags, **of_rig, **fields)


def with_slope_noise(height: HeightMap, slopes: SlopeMap) -> HeightMap:
    """The map with the median slope noise of its good pixels, for programs that read it without slopes."""
    if not height.good.any():
        return height
    noise = (float(np.median(each[height.good])) for each in (slopes.sigma_x, slopes.sigma_y))
    along_x, along_y = noise
    return replace(height, diagnostics=replace(height.diagnostics, slope_sigma=(along_x, along_y)))


def _mode_slopes(height: HeightMap) -> Modes | None:
    """Slopes (r, 2, rows, cols) of the modes over x and y, on their own grid; without neighbours along an
    axis those of the nearest place."""
    if height.modes is None:
        return None
    few = np.s_[:: height.modes_step, :: height.modes_step]
    x, y, known = height.x[few], height.y[few], np.isfinite(height.z[few])
    return np.stack([filled(gradients(x, y, mode.astype(np.float64), known)) for mode in height.modes])


def _moved(direction: Floats, e: list[Floats], n: list[Floats], slopes: list[Floats]) -> list[Floats]:
    """Change of both slopes while the pattern point moves along a direction (3, ...), times |X - P|."""
    with_e = direction[0] * e[0] + direction[1] * e[1] + direction[2] * e[2]
    dn = [direction[k] - with_e * e[k] for k in range(3)]
    return [-(dn[k] + slopes[k] * dn[2]) / n[2] for k in (0, 1)]
