"""Measuring range and sensitivity of a scene: maps over the camera's pixels by reflection at the mirror at
rest (no tracing of a dent), and their medians.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from optolever.arrays import Floats, Mask
from optolever.live import COMPRESSED, RESOLVED, fringe_period
from optolever.patterns import sequence_from_text
from optolever.reconstruct import null_space
from optolever.scene import Scene, dent

from .sensitivity import Lever
from .view import predict, stride_for

WIDEST = np.radians(45.0)  # largest slope angle
SCAN, BISECTIONS = 181, 40
BALLS = (2.0, 4.0, 5.0)  # mm: radii of example contacts
FOLDED = 1 - COMPRESSED  # by which a curvature may shrink a cell's image before `live` loses its height
SMOOTHED = 2.0  # pattern pixels, rms, over which `live` smooths curvature: fitted to pressed balls
SIDE = 96  # pixels along the shorter side of the camera on which maps are made


@dataclass(frozen=True, slots=True)
class Rest:
    """The mirror at rest per camera pixel: points (H, W, 3) mm on z = 0, directions of the rays (unit),
    inside: whether the point is on the mirror."""

    scene: Scene
    points: Floats
    directions: Floats
    inside: Mask

    @classmethod
    def of(cls, scene: Scene) -> "Rest":
        origins, directions = scene.camera.rays()
        with np.errstate(divide="ignore", invalid="ignore"):
            points = origins - (origins[..., 2:] / directions[..., 2:]) * directions
        x, y, mirror = points[..., 0], points[..., 1], scene.mirror
        inside = (x >= 0) & (x <= mirror.length) & (y >= 0) & (y <= mirror.width) & (directions[..., 2] < 0)
        return cls(scene, points, directions, inside)

    def reflected(self, angle: Floats | float, along: str) -> tuple[Floats, Floats, Floats, Floats]:
        """(u, v, path in mm, cosine of incidence), (H, W), where the slope along x or y is tan(angle).

        u, v: NaN where the ray does not reach the pattern's plane ahead of it.
        """
        turn = np.broadcast_to(np.asarray(angle, np.float64), self.inside.shape)
        normal = np.zeros(self.points.shape)
        normal[..., "xy".index(along)] = -np.sin(turn)
        normal[..., 2] = np.cos(turn)
        cosine = -(self.directions * normal).sum(axis=-1)
        out = self.directions + 2 * cosine[..., None] * normal
        pattern = self.scene.pattern
        with np.errstate(divide="ignore", invalid="ignore"):
            path = ((pattern.origin - self.points) @ pattern.normal) / (out @ pattern.normal)
            u, v = pattern.coordinates(self.points + path[..., None] * out)
        ahead = (path > 0) & (cosine > 0)
        return np.where(ahead, u, np.nan), np.where(ahead, v, np.nan), path, cosine

    def lands(self, angle: Floats | float, along: str) -> Mask:
        """Whether that ray hits the pattern (H, W)."""
        u, v, _, _ = self.reflected(angle, along)
        pattern = self.scene.pattern
        with np.errstate(invalid="ignore"):
            on = (u >= -0.5) & (u <= pattern.cols - 0.5) & (v >= -0.5) & (v <= pattern.rows - 0.5)
        return np.asarray(on & self.inside)

    def slope_limits(self, along: str) -> tuple[Floats, Floats]:
        """Smallest and largest slope angle along x or y (rad, (H, W)) at which the ray hits the pattern.

        From rest outwards until it first misses; NaN where it misses at rest. In a telecentric 45-degree
        prism along x: from -atan((L0 - x) / x) / 2 (the apex) to 22.5 degrees (along the mirror to the
        pattern's edge).
        """
        visible, limits = self.lands(0.0, along), []
        angles = np.linspace(0, WIDEST, SCAN)
        for sign in (-1.0, 1.0):
            on = np.stack([self.lands(sign * angle, along) for angle in angles])
            last = np.where(on.all(axis=0), SCAN, np.argmin(on, axis=0)) - 1
            good, bad = angles[last], angles[np.minimum(last + 1, SCAN - 1)]
            for _ in range(BISECTIONS):
                middle = 0.5 * (good + bad)
                lands = self.lands(sign * middle, along)
                good, bad = np.where(lands, middle, good), np.where(lands, bad, middle)
            limits.append(np.where(visible, sign * good, np.nan))
        return limits[0], limits[1]

    def lever(self) -> Floats:
        """Displacement on the pattern, cells per mrad of slope along x (H, W)."""
        step = 1e-5
        (u0, v0), (u1, v1) = (self.reflected(sign * step, "x")[:2] for sign in (-1.0, 1.0))
        return np.asarray(np.hypot(u1 - u0, v1 - v0) / (2 * step) * 1e-3)


@dataclass(frozen=True, slots=True)
class SensorMaps:
    """Maps (H, W) of a scene at rest, NaN where a pixel views no pattern.

    x: point on the mirror, mm; low, high: limits of the slope along x (rad) with the ray on the pattern,
    low_y, high_y: along y; margin: slope (rad) up to which reflection stays total, below 0 where it is not
    total at rest, NaN without a medium; reflectance; path: mirror to pattern, mm; lever: cells per mrad;
    fold_radius: of curvature (mm) along x below which the image folds; free_mode: the undetermined height
    mode, maximum 1; sigma: of the height, mm, for the given sequence and noise; balls: depth (mm) of a
    ball's contact in the middle, by its radius (mm), up to which `live` has a height in every cell;
    smallest: radius (mm) of the contacts whose depth `live` resolves, of narrower ones it is a lower bound.
    """

    x: Floats
    low: Floats
    high: Floats
    low_y: Floats
    high_y: Floats
    margin: Floats
    reflectance: Floats
    path: Floats
    lever: Floats
    fold_radius: Floats
    free_mode: Floats
    sigma: Floats
    balls: dict[float, float]
    smallest: float

    def numbers(self) -> dict[str, float]:
        """Medians over the pixels (worst: the minimum), share with the pattern in view; slopes in degrees."""
        on, visible, degrees = np.isfinite(self.x), np.isfinite(self.low), np.degrees
        return {
            "visible_share": float((visible & on).sum() / max(1, on.sum())),
            "slope_low_deg": float(degrees(_median(self.low))),
            "slope_high_deg": float(degrees(_median(self.high))),
            "slope_worst_deg": float(degrees(_median(np.minimum(self.high, -self.low), 0.0))),
            "slope_y_deg": float(degrees(_median(np.minimum(self.high_y, -self.low_y)))),
            "reflection_margin_deg": float(degrees(_median(self.margin))),
            "reflectance": _median(self.reflectance),
            "path_mm": _median(self.path),
            "lever_cells_per_mrad": _median(self.lever),
            "fold_radius_mm": _median(self.fold_radius),
            "free_mode_median": _median(self.free_mode),
            "sigma_mm": _median(self.sigma),
            "sigma_rms_mm": math.sqrt(float(np.nanmean(self.sigma**2))) if visible.any() else math.nan,
            **{f"ball_{radius:g}mm_depth_mm": depth for radius, depth in self.balls.items()},
            "smallest_contact_radius_mm": self.smallest,
        }


def sensor_maps(scene: Scene, sequence: str = "gray+phase", noise: float = 1.0) -> SensorMaps:
    """Maps on a camera thinned to about SIDE pixels; sigma is that of the full camera.

    InputError if no pixel sees the pattern at rest.
    """
    lever = Lever(scene, dent("flat", scene), stride=stride_for(scene, SIDE))
    thin = lever.view.scene
    rest = Rest.of(thin)
    (low, high), (low_y, high_y) = (rest.slope_limits(along) for along in "xy")
    visible = np.isfinite(low)
    _, _, path, cosine = (np.where(visible, part, np.nan) for part in rest.reflected(0.0, "x"))
    margin, reflectance = np.full(low.shape, np.nan), np.where(visible, 1.0, np.nan)
    if thin.medium is not None:
        margin = np.arccos(np.clip(cosine, -1, 1)) - thin.medium.critical_angle
        reflectance = thin.medium.reflectance(cosine)
    x = np.where(rest.inside, rest.points[..., 0], np.nan)
    fold_radius = 2 * path / cosine
    cell = _cell_on_mirror(rest)
    balls = {radius: _ball_depth(rest, fold_radius, radius, cell) for radius in BALLS}
    return SensorMaps(
        x, low, high, low_y, high_y, margin, reflectance, path, rest.lever(),
        fold_radius, null_space(thin), _sigma(lever, sequence, noise), balls,
        RESOLVED * fringe_period(scene) / 2 * cell,
    )  # fmt: skip


def _cell_on_mirror(rest: Rest) -> float:
    """A cell of the pattern as seen in the mirror, mm, along its longer side."""
    u, v, _, _ = rest.reflected(0.0, "x")
    slopes = (_median(np.hypot(*np.gradient(part))) for part in (u, v))
    (x_row, x_col), (y_row, y_col) = (np.gradient(rest.points[..., k]) for k in (0, 1))
    return math.sqrt(_median(np.abs(x_col * y_row - x_row * y_col))) / min(slopes)


def _ball_depth(rest: Rest, fold_radius: Floats, radius: float, cell: float) -> float:
    """Depth at which the largest curvature along x, smoothed over so many mm of a cell, is FOLDED of that
    which folds the image."""
    x, smoothed = rest.points[..., 0], SMOOTHED * cell
    peak, mirror = 1e-3, rest.scene.mirror
    line, step = np.linspace(0, mirror.length, 4001, retstep=True)
    ball = dent("ball", rest.scene, peak=peak, radius=radius**2 / peak)
    bent = gaussian_filter1d(
        ball.height(line, np.full_like(line, mirror.width / 2)), smoothed / step, order=2
    )
    known = np.isfinite(fold_radius)
    order = np.argsort(x[known])
    shrunk = bent / step**2 * np.interp(line, x[known][order], fold_radius[known][order])
    return FOLDED * peak / float(shrunk.max())


def _sigma(lever: Lever, text: str, noise: float) -> Floats:
    """Sigma of the height (mm) on the full camera, on the lever's view."""
    view = lever.view
    sequence = sequence_from_text(text, view.scene.pattern.rows, view.scene.pattern.cols)
    prediction = predict(view, sequence, noise)
    stated = prediction.sigma.mean(axis=0)
    height = lever.solve(view, np.zeros(stated.shape), stated, np.asarray(prediction.good.all(axis=0)))
    return np.where(height.good & view.usable, height.sigma * lever.to_full, np.nan)


def _median(values: Floats, share: float = 0.5) -> float:
    """Median, or another quantile, of the finite values."""
    finite = values[np.isfinite(values)]
    return float(np.quantile(finite, share)) if finite.size else math.nan
