"""What a scene can measure, before it is built: maps over the camera's pixels, and the numbers they come
to.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optolever.patterns import sequence_from_text
from optolever.reconstruct import null_space
from optolever.scene import Scene, dent

from .prediction import predict
from .sensitivity import Lever
from .slopes import lever_arm, reflected, rest_of, slope_limits
from .view import stride_for

__all__ = ["SensorMaps", "sensor_maps"]

Floats = NDArray[np.float64]
SIDE = 96  # pixels along the shorter side of the camera on which maps are made


@dataclass(frozen=True, slots=True)
class SensorMaps:
    """Maps (H, W) of a scene at rest, NaN where a pixel sees no pattern.

    x, y: point on the mirror, mm; low, high: slopes along x (rad) between which the ray stays on the pattern,
    low_y, high_y: along y; reflection_margin: slope (rad) up to which reflection stays total, below 0
    where it is not even at rest, NaN without a medium; reflectance; path: mirror to pattern, mm; lever:
    cells per mrad; fold: curvature (1/mm) along x from which on the image folds; free_mode: height that
    no image fixes, 1 at its largest; sigma: of the height, mm, under the sequence and noise asked for.
    """

    scene: Scene
    x: Floats
    y: Floats
    low: Floats
    high: Floats
    low_y: Floats
    high_y: Floats
    reflection_margin: Floats
    reflectance: Floats
    path: Floats
    lever: Floats
    fold: Floats
    free_mode: Floats
    sigma: Floats
    sequence: str
    noise: float

    def numbers(self) -> dict[str, float]:
        """Medians over the pixels (worst: the least), the share that sees the pattern; slopes in degrees."""
        on = np.isfinite(self.x)
        seen = np.isfinite(self.low)
        degrees = np.degrees
        return {
            "visible_share": float((seen & on).sum() / max(1, on.sum())),
            "slope_low_deg": float(degrees(_median(self.low))),
            "slope_high_deg": float(degrees(_median(self.high))),
            "slope_worst_deg": float(degrees(_least(np.minimum(self.high, -self.low)))),
            "slope_y_deg": float(degrees(_median(np.minimum(self.high_y, -self.low_y)))),
            "reflection_margin_deg": float(degrees(_median(self.reflection_margin))),
            "reflectance": _median(self.reflectance),
            "path_mm": _median(self.path),
            "lever_cells_per_mrad": _median(self.lever),
            "fold_radius_mm": 1 / _median(self.fold),
            "free_mode_median": _median(self.free_mode),
            "sigma_mm": _median(self.sigma),
            "sigma_rms_mm": math.sqrt(float(np.nanmean(self.sigma**2))) if seen.any() else math.nan,
        }


def sensor_maps(
    scene: Scene, sequence: str = "gray+phase", noise: float = 1.0, side: int = SIDE
) -> SensorMaps:
    """Maps on a camera thinned to about `side` pixels; sigma is that of the full camera.

    InputError if no pixel sees the pattern at rest.
    """
    lever = Lever(scene, dent("flat", scene), stride=stride_for(scene, side))
    thin = lever.view.scene
    rest = rest_of(thin)
    low, high = slope_limits(thin, rest, "x")
    low_y, high_y = slope_limits(thin, rest, "y")
    path, moved = lever_arm(thin, rest)
    cosine = reflected(thin, rest, 0.0, "x")[3]
    seen = np.isfinite(low)
    margin, reflectance = _reflection(thin, cosine, seen)
    sigma, mode = _sigma(lever, sequence, noise), null_space(thin)
    points = [np.where(rest.inside, rest.points[..., k], np.nan) for k in (0, 1)]
    return SensorMaps(
        scene, points[0], points[1], low, high, low_y, high_y, margin, reflectance, path, moved,
        np.where(seen, cosine / (2 * path), np.nan), mode, sigma, sequence, noise,
    )  # fmt: skip


def _reflection(scene: Scene, cosine: Floats, seen: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """(slope up to which reflection is total, reflectance at rest)."""
    if scene.medium is None:
        return np.full(seen.shape, np.nan), np.where(seen, 1.0, np.nan)
    incidence = np.arccos(np.clip(cosine, -1, 1))
    margin = np.where(seen, incidence - scene.medium.critical_angle, np.nan)
    return margin, np.where(seen, scene.medium.reflectance(cosine), np.nan)


def _sigma(lever: Lever, text: str, noise: float) -> Floats:
    """Sigma of the height (mm) on the full camera, on the lever's view."""
    view = lever.view
    sequence = sequence_from_text(text, view.scene.pattern.rows, view.scene.pattern.cols)
    prediction = predict(view, sequence, noise)
    stated = prediction.sigma.mean(axis=0)
    height = lever.solve(view, np.zeros(stated.shape), stated, np.asarray(prediction.good.all(axis=0)))
    return np.where(height.good & view.usable, height.sigma * lever.to_full, np.nan)


def _median(values: Floats) -> float:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else math.nan


def _least(values: Floats) -> float:
    finite = values[np.isfinite(values)]
    return float(finite.min()) if finite.size else math.nan
