"""Several maps of one mirror: mean, differences, and by rotations of the mirror what is the rig's.

A map of a mirror that was turned by a about its middle is rig(r) + mirror(R(-a) r). Mean maps in the frames
of the mirror and of the rig separate both parts. What no turn changes counts as the mirror's (N-position
test, C. J. Evans and R. N. Kestner, Appl. Opt. 35 (1996) 1015).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from optolever.arrays import Floats
from optolever.errors import InputError
from optolever.reconstruct import Grid, HeightFlag, HeightMap, natural_pitch

from .fit import FormFit
from .nominal import extended, surface_of

__all__ = ["RunComparison", "compare_runs", "in_common"]

_ROUNDS = 20  # of the alternating means, for turns that are not evenly spaced


@dataclass(frozen=True, slots=True, eq=False)
class RunComparison:
    """Maps on a regular grid (rows, cols), mm, NaN where a run is unknown: x, y from the middle; mirror (the
    mean where it was not turned); rig (zero then); left (K, rows, cols): what both do not explain of a run;
    noise: rms noise of the mirror's map, NaN if unknown.
    """

    x: Floats
    y: Floats
    mirror: Floats
    rig: Floats
    left: Floats
    noise: float

    def export(self, path: str | Path) -> None:
        """Write the mirror's map, as `HeightMap.export` does; to an .npz also rig and left."""
        unknown = np.isnan(self.mirror)
        sigma = np.where(unknown, np.nan, self.noise)
        flags = np.where(unknown, int(HeightFlag.NO_ANCHOR), 0).astype(np.uint16)
        HeightMap(self.x, self.y, self.mirror, sigma, flags).export(path, rig=self.rig, left=self.left)

    @staticmethod
    def rms(z: Floats) -> float:
        """Rms of a map about its mean, mm."""
        return float(np.nanstd(z))


def in_common(heights: Sequence[HeightMap]) -> list[HeightMap]:
    """The maps, each flagged wherever one of them is, so that forms of them are of one area. InputError
    where their sizes differ, or their pixels see other places (of the median pixel by more than its size)."""
    first = heights[0]
    for k, height in enumerate(heights[1:], 2):
        if height.z.shape != first.z.shape:
            sizes = " and ".join(" x ".join(map(str, each.z.shape)) for each in (first, height))
            raise InputError(f"maps 1 and {k}: have {sizes} pixels, must be of one rig and one mirror")
        both = first.good & height.good
        apart = np.hypot(height.x - first.x, height.y - first.y)[both]
        if not both.any() or np.median(apart) > natural_pitch(first.x, first.y, first.good):
            far = (
                f"see places {np.median(apart):.3g} mm apart"
                if both.any()
                else "have no good pixel in common"
            )
            raise InputError(f"maps 1 and {k}: their pixels {far}, must be of one rig and one mirror")
    flags = np.bitwise_or.reduce([height.flags for height in heights])
    return [replace(height, flags=flags) for height in heights]


def compare_runs(fits: Sequence[FormFit], turns: Sequence[float] | None = None) -> RunComparison:
    """Residuals of two runs or more, turns: of the mirror in each, rad, from x to y (None: none was turned).

    InputError for another number of turns, or runs that have no point in common.
    """
    if len(fits) < 2:
        raise InputError(f"runs: {len(fits)} maps, must be at least 2")
    if turns is not None and len(turns) != len(fits):
        raise InputError(f"rotations: {len(turns)} angles, must be {len(fits)}, one for each map")
    turned = [0.0] * len(fits) if turns is None else list(turns)
    grids = [fit.grid() for fit in fits]
    pitch = max(grid.pitch for grid in grids)
    reach = [min(float(np.nanmax(np.abs(part - at)[np.isfinite(fit.residual)])) for fit, part, at in
             ((fit, (fit.x, fit.y)[axis], fit.middle[axis]) for fit in fits)) for axis in (0, 1)]  # fmt: skip
    if turns is not None:
        reach = [min(reach)] * 2
    x, y = np.meshgrid(*(pitch * np.arange(-int(each / pitch), int(each / pitch) + 1) for each in reach))
    surfaces = [surface_of(grid).z for grid in grids]

    def run(k: int, u: Floats, v: Floats) -> Floats:
        return surfaces[k](u + fits[k].middle[0], v + fits[k].middle[1])

    seen = np.stack([run(k, x, y) for k in range(len(fits))])
    own = np.stack([run(k, *_turned(x, y, angle)) for k, angle in enumerate(turned)])
    if turns is not None:
        seen, own = _closed(seen, own, x, y, pitch, turned)
    rig, mirror = np.zeros_like(x), own.mean(axis=0)
    if not np.isfinite(mirror).any():
        raise InputError("runs: the maps have no point in common, they must be of one mirror")

    def at(z: Floats, sign: int, within: bool = False) -> Floats:
        """z at the points of each turn, or NaN where not within its known ones."""
        grid = Grid(z, np.zeros_like(z), float(x[0, 0]), float(y[0, 0]), pitch)
        surface = surface_of(grid).z if within else extended(grid)
        return np.stack([surface(*_turned(x, y, sign * angle)) if angle else z for angle in turned])

    for _ in range(0 if turns is None else _ROUNDS):
        rig = np.mean(seen - at(mirror, -1), axis=0)
        mirror = np.mean(own - at(rig, 1), axis=0)
    left = seen - rig - at(mirror, -1, within=True)
    known = np.isfinite(mirror) & np.isfinite(rig)
    mirror, rig = np.where(known, mirror, np.nan), np.where(known, rig, np.nan)
    noise = float(
        np.sqrt(sum(np.mean(fit.noise[np.isfinite(fit.residual)] ** 2) for fit in fits)) / len(fits)
    )
    return RunComparison(x, y, mirror, rig, left, noise)


def _turned(x: Floats, y: Floats, angle: float) -> tuple[Floats, Floats]:
    c, s = np.cos(angle), np.sin(angle)
    return c * x - s * y, s * x + c * y


def _closed(
    seen: Floats, own: Floats, x: Floats, y: Floats, pitch: float, turned: Sequence[float]
) -> tuple[Floats, Floats]:
    """Both (K, rows, cols), NaN where a run is unknown, or a turned point lies more than a point beyond."""
    rig, mirror = (np.asarray(np.isfinite(part).all(axis=0)) for part in (seen, own))

    def near(known: NDArray[np.bool_], angle: float) -> NDArray[np.bool_]:
        u, v = _turned(x, y, angle)
        wide = scipy.ndimage.binary_dilation(known, np.ones((3, 3)))
        at = (v - y[0, 0]) / pitch, (u - x[0, 0]) / pitch
        return np.asarray(scipy.ndimage.map_coordinates(wide, at, order=0, cval=False))

    while True:
        before = np.count_nonzero(rig) + np.count_nonzero(mirror)
        for angle in turned:
            mirror &= near(rig, angle)
        for angle in turned:
            rig &= near(mirror, -angle)
        if np.count_nonzero(rig) + np.count_nonzero(mirror) == before:
            return np.where(rig, seen, np.nan), np.where(mirror, own, np.nan)
