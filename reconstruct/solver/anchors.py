"""Anchors: where the mirror is known, so that the free mode of the equations is settled.

The slopes leave one degree of freedom per connected component (dt ~ E, the integrating factor: at 45 degrees
h = C x, a rotation about the pattern's edge). Nothing in the image fixes it; an anchor does.

The default is the camera-side edge at rest: the line x = L0, z = 0, reached by extrapolation from the pixels
next to it. Where the camera does not see that line, the default is the border of its view, if the mirror
was captured at rest; else the middle of a mirror in open air; of a prism a point, a pixel's height or a
distance must be named.

Known distances at places of the image (`Samples`) become linear rows on the grid (`AnchorRows`), whose robust
mean settles the free constant of every component.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy.ndimage

from optolever.arrays import Floats, Ints, Labels, Mask, Pair
from optolever.errors import InputError
from optolever.scene import Camera, Scene

from ..geometry import RayField, rest_distance, rest_height, sagging_distance
from ..measured import Measured

__all__ = [
    *("Anchor", "AnchorRows", "Anchors", "EdgeAnchor", "PixelAnchor", "PointAnchor"),
    *("EDGE_OR_BORDER", "Samples", "anchor_rows", "anchor_samples", "free_constants"),
]

EDGE_REACH = 4.0  # pixels over which the slope may be extrapolated to the edge
_THERE = 0.05  # pixels: an anchor so near needs no slopes
_STARTS = np.array([-1, 0, -3, -2])  # of a window of four pixels, relative to the pixel; the best first
_COARSE, _LINES = 8, 8  # pixels between rays, lines of them: the first look
_MOST = 1e9  # mm: scenes go no further
_BORDER = 200  # pixels of the border, about
#: The default against a capture at rest.
EDGE_OR_BORDER = "edge or border"


@dataclass(frozen=True, slots=True)
class EdgeAnchor:
    """The camera-side edge x = L0 of the mirror is at rest: at z = 0, or on the scene's `rest_form`, whose
    errors the covariance of the scene holds; sigma: standard deviation of that z in mm."""

    sigma: float = 0.0


@dataclass(frozen=True, slots=True)
class PointAnchor:
    """The mirror passes through (x, y, z), mm in the mirror's frame; sigma: of z."""

    x: float
    y: float
    z: float
    sigma: float = 0.0


@dataclass(frozen=True, slots=True)
class PixelAnchor:
    """The mirror point on the ray of the (fractional) pixel has depth z, give or take sigma, mm."""

    row: float
    col: float
    z: float
    sigma: float = 0.0


#: What settles the free mode of a component.
Anchor = EdgeAnchor | PointAnchor | PixelAnchor
Anchors = Anchor | str | tuple[float, float, float] | Sequence[Anchor | tuple[float, float, float]] | None


class Samples(NamedTuple):
    """Known distances: at pixel (row, col) the mirror is `distance` mm along the ray, give or take sigma mm;
    rest: whether that is the mirror at rest; (M,) each. normal (M, 3): of the plane that holds the known
    point, whatever the rig is; NaN: of the mirror itself.
    """

    row: Floats
    col: Floats
    distance: Floats
    sigma: Floats
    rest: Mask
    normal: Floats

    def on_grid(self, rows: slice, cols: slice) -> "Samples":
        """The same in the pixels of a window."""
        row, col = self.row - rows.start, self.col - cols.start
        return self._replace(row=row, col=col)


def anchor_samples(anchor: Anchors, scene: Scene, rays: RayField, mask: Mask) -> Samples:
    """Anchors as known distances at pixels. 'edge': the camera-side edge at rest; 'middle': the middle at
    rest; 'border': the border of the camera's view at rest; EDGE_OR_BORDER: the latter where no valid
    pixel lies at the edge; None: the edge, or then in open air the middle.

    Raises InputError if an anchor cannot be used with this scene and mask.
    """
    x, y = 0.5 * scene.mirror.length, 0.5 * scene.mirror.width
    if isinstance(anchor, str) and anchor == "middle":
        middle = PointAnchor(x, y, float(rest_height(np.array([x]), np.array([y]), scene)[0]))
        return _samples(middle, scene, rays, mask)._replace(rest=np.ones(1, np.bool_))
    if isinstance(anchor, str) and anchor == "border":
        return _border_samples(scene, rays, mask)
    try:
        parts = [_samples(each, scene, rays, mask) for each in _listed(anchor)]
    except InputError:
        if isinstance(anchor, str) and anchor == EDGE_OR_BORDER:
            return _border_samples(scene, rays, mask)
        if anchor is not None or not scene.open_air:
            raise
        return anchor_samples("middle", scene, rays, mask)
    return Samples(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def _listed(anchor: Anchors) -> Sequence[Anchor]:
    if anchor is None or (isinstance(anchor, str) and anchor in ("edge", EDGE_OR_BORDER)):
        return [EdgeAnchor()]
    if isinstance(anchor, str):
        raise InputError(
            f"anchor = {anchor!r}: unknown, must be 'edge', 'middle', 'border' or known points; without any "
            "the height is free by one mode"
        )
    if isinstance(anchor, Anchor):
        return [anchor]
    anchors: list[Any] = list(anchor) if isinstance(anchor, Iterable) else [anchor]
    if not anchors:
        raise InputError("anchor = []: no anchor; at least one is needed, 'edge' or a known point")
    if all(isinstance(part, int | float | np.number) for part in anchors):
        anchors = [anchors]
    return [part if isinstance(part, Anchor) else _point(part) for part in anchors]


def _point(values: Any) -> PointAnchor:
    try:
        x, y, z = (float(number) for number in values)
    except (TypeError, ValueError):
        raise InputError(f"anchor = {values!r}: a known point has three coordinates x, y, z (mm)") from None
    return PointAnchor(x, y, z)


def _samples(anchor: Anchor, scene: Scene, rays: RayField, mask: Mask) -> Samples:
    for name in anchor.__slots__:
        value, least = getattr(anchor, name), 0 if name == "sigma" else -_MOST
        if not least <= value <= _MOST:
            raise InputError(f"anchor.{name} = {value}: must be finite, from {least:g} to {_MOST:g} mm")
    if isinstance(anchor, EdgeAnchor):
        return _edge_samples(anchor, scene, rays, mask)
    normal = np.full(3, np.nan)
    if isinstance(anchor, PointAnchor):
        row, col, distance = _located(np.array([anchor.x, anchor.y, anchor.z]), scene.camera, rays)
    else:
        row, col, distance = anchor.row, anchor.col, 0.0
    if not all(-0.5 <= at <= size - 0.5 for at, size in zip((row, col), rays.shape, strict=True)):
        point = isinstance(anchor, PointAnchor)
        name = f"anchor point ({anchor.x:g}, {anchor.y:g}, {anchor.z:g}) mm" if point else "anchor"  # type: ignore[union-attr]
        size = " x ".join(map(str, rays.shape))
        raise InputError(
            f"{name}: at pixel ({row:.1f}, {col:.1f}), outside the image of {size}; name one in view"
        )
    origin, direction = scene.camera.rays_at(row, col)
    sigma = anchor.sigma / abs(direction[2])
    if isinstance(anchor, PixelAnchor):
        distance, normal = (anchor.z - origin[2]) / direction[2], np.array([0.0, 0.0, 1.0])
    known = np.array([[row], [col], [distance], [sigma]], dtype=np.float64)
    return Samples(known[0], known[1], known[2], known[3], np.zeros(1, np.bool_), normal[None])


def _edge_samples(anchor: EdgeAnchor, scene: Scene, rays: RayField, mask: Mask) -> Samples:
    """Where the image of the line x = L0, z = 0 crosses the rows (or the columns) next to valid pixels."""
    length, camera = scene.mirror.length, scene.camera
    x = _rest_x(rays.inner_origins, rays.inner_directions)
    some = x[:: max(1, len(x) // _LINES), :: max(1, x.shape[1] // _LINES)]
    with np.errstate(invalid="ignore"):  # rays along the mirror meet it nowhere
        down, along_row = (np.median(np.abs(np.diff(some, axis=k))) for k in (0, 1))
        axis = int(along_row >= down)
        away = np.where(mask & np.isfinite(x), np.abs(x - length), np.inf)
    at = np.argmin(away, axis=axis)
    lines = np.arange(at.size)

    def rays_at(along: Floats) -> Pair:
        place = (lines, along) if axis == 1 else (along, lines)
        origins, directions = (np.moveaxis(np.asarray(part), -1, 0) for part in camera.rays_at(*place))
        return origins, directions

    with np.errstate(divide="ignore", invalid="ignore"):
        step = _rest_x(*rays_at(at + 0.5)) - _rest_x(*rays_at(at - 0.5))
        offset = (length - np.take_along_axis(x, np.expand_dims(at, axis), axis).squeeze(axis)) / step
    near = mask.any(axis=axis) & (np.abs(offset) <= EDGE_REACH + 0.25)
    if not near.any():
        raise InputError(
            f"anchor = 'edge': no valid pixel within {EDGE_REACH:g} pixels of the mirror's camera-side edge "
            f"x = {length:g} mm at rest; name a point on the mirror"
        )
    lines, along, step = lines[near], (at + offset)[near], step[near]
    for _ in range(3):  # the line's exact position: chord steps on the rays themselves
        along = along + (length - _rest_x(*rays_at(along))) / step
    origins, directions = rays_at(along)
    distance = sagging_distance(origins, directions, scene)
    row, col = (lines, along) if axis == 1 else (along, lines)
    # one error common to the edge: the mean over its lines must not reduce it
    sigma = anchor.sigma * np.sqrt(lines.size) / np.abs(directions[2])
    own = np.full((lines.size, 3), np.nan)
    return Samples(row.astype(float), col.astype(float), distance, sigma, np.ones(lines.size, np.bool_), own)


def _border_samples(scene: Scene, rays: RayField, mask: Mask) -> Samples:
    """Pixels of the outer border of the valid ones, at rest."""
    whole = scipy.ndimage.binary_fill_holes(mask)
    border = np.argwhere(mask & whole & ~scipy.ndimage.binary_erosion(whole))
    row, col = border[:: max(1, len(border) // _BORDER)].T
    if not row.size:
        raise InputError("anchor = 'border': no pixel is valid")
    directions = rays.inner_directions[:, row, col]
    distance = sagging_distance(rays.inner_origins[:, row, col], directions, scene)
    known = np.ones(row.size, np.bool_)
    own = np.full((row.size, 3), np.nan)
    return Samples(row.astype(float), col.astype(float), distance, np.zeros(row.size), known, own)


def _rest_x(origins: Floats, directions: Floats) -> Floats:
    x: Floats = origins[0] + rest_distance(origins, directions) * directions[0]
    return x


def _located(point: Floats, camera: Camera, rays: RayField) -> tuple[float, float, float]:
    """Pixel (row, col) whose ray passes through the point, and the distance along it."""
    origins, directions = (
        part[:, ::_COARSE, ::_COARSE] for part in (rays.inner_origins, rays.inner_directions)
    )
    offset = point[:, None, None] - origins
    miss = (offset**2).sum(axis=0) - (offset * directions).sum(axis=0) ** 2
    at = _COARSE * np.array(np.unravel_index(int(np.argmin(miss)), miss.shape), dtype=np.float64)
    for _ in range(20):
        origin, direction = camera.rays_at(*at)
        distance = float((point - origin) @ direction)
        beside = [camera.rays_at(*(at + half)) for half in 0.5 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])]
        there = [origin + distance * direction for origin, direction in beside]
        columns = np.stack([there[0] - there[1], there[2] - there[3]], axis=1)
        shift = np.linalg.lstsq(columns, point - origin - distance * direction, rcond=None)[0]
        at = at + shift
        if np.abs(shift).max() < 1e-12 * max(rays.shape):
            break
    origin, direction = camera.rays_at(*at)
    return float(at[0]), float(at[1]), float((point - origin) @ direction)


class AnchorRows(NamedTuple):
    """Known values of the unknown near valid pixels, M of them.

    The value predicted at an anchor is w[pixel] and, along the row (0: p) and the column (1: q), the integral
    of the cubic through four slopes: `by` of those `at` (2, M, 4). more: excess over the parabola nearest to
    the same slopes; known: w there; reach: pixels travelled; sigma: of the known value, in units of w;
    component: label of the pixel; sample: number of the sample.
    """

    pixel: Ints
    at: Ints
    by: Floats
    more: Floats
    known: Floats
    sigma: Floats
    component: Ints
    sample: Ints

    def predict(self, w: Floats, *slopes: Floats) -> Floats:
        """Value of the unknown at the anchors, (M,); (..., M) of stacks (..., rows, cols)."""
        value: Floats = w.reshape(*w.shape[:-2], -1)[..., self.pixel] + self._along(slopes, self.by)
        return value

    def bend(self, *slopes: Floats) -> Floats:
        """Excess of the cubics over the parabolas, (M,): above the cubic's error on a curve."""
        return self._along(slopes, self.more)

    def spread(self, *variances: Floats) -> Floats:
        """Variance that the way from the pixels adds, of the slopes', (M,)."""
        return self._along(variances, self.by**2)

    def error_variance(self, variances: Pair) -> Floats:
        """Variance of the predicted values less the known ones, (M,), by the slopes' variances."""
        total: Floats = self.sigma**2 + self.spread(*variances) + 0.25 * variances[0].ravel()[self.pixel]
        return total

    def _along(self, fields: Sequence[Floats], weights: Floats) -> Floats:
        values = [
            field.reshape(*field.shape[:-2], -1)[..., at] for field, at in zip(fields, self.at, strict=True)
        ]
        total: Floats = np.einsum("a...mk,amk->...m", np.stack(values), weights)
        return total


def anchor_rows(samples: Samples, data: Measured, labels: Labels) -> AnchorRows:
    """Tie the samples (in this grid's pixels) to the nearest valid pixels, except samples without one in
    reach or with fewer than four slopes on the way.
    """
    row, col, found = _nearest(samples, data.mask)
    away = np.stack([samples.col - col, samples.row - row])
    windows = [_windows(data.mask, row, col, *axis) for axis in ((0, 1), (1, 0))]
    start, whole = (np.stack(part) for part in zip(*windows, strict=True))
    keep = np.flatnonzero(found & (whole | (np.abs(away) < _THERE)).all(axis=0))
    row, col, away, start, whole = row[keep], col[keep], away[:, keep], start[:, keep], whole[:, keep, None]
    pixel = row * data.mask.shape[1] + col
    there = np.arange(4) + start[..., None]
    alone = away[..., None] * (np.arange(4) == 0)  # the pixel's own slope
    cubic, parabola = _integral(start, away, 4), _integral(start, away, 3)
    stride = np.array([1, data.mask.shape[1]])[:, None, None]
    distance = samples.distance[keep]
    return AnchorRows(
        pixel,
        pixel[:, None] + np.where(whole, there * stride, 0),
        np.where(whole, cubic, alone),
        np.where(whole, cubic - parabola, 0.0),
        data.unknown(distance),
        samples.sigma[keep] / (distance if data.rays.logarithmic else 1.0),
        labels[row, col].astype(np.int64),
        keep,
    )


def free_constants(
    rows: AnchorRows, error: Floats, factor: Floats, spread: Floats, count: int
) -> tuple[Floats, Floats]:
    """The multiple of the integrating factor that each component needs, (count + 1,), and every row's share
    (M,) in it.

    error: predicted minus known (M,), spread: its variance; factor: integrating factor at the rows' pixels.
    The mean is weighted and leaves out rows farther than five scaled median deviations from the median.
    """
    constants = np.zeros(count + 1)
    share = np.zeros(error.shape)
    for label in np.unique(rows.component):
        pick = np.flatnonzero(rows.component == label)
        most = factor[pick].max()
        if not most > 0:
            raise InputError(
                "anchor: its error would grow beyond all numbers on the way to the other pixels; some next "
                "to the pattern's edge may be wrong: mask them, or calibrate the scene"
            )
        ratio, weight = error[pick] / factor[pick], (factor[pick] / most) ** 2 / spread[pick]
        middle = np.median(ratio)
        limit = 5 * 1.4826 * np.median(np.abs(ratio - middle)) + 1e-12 * np.abs(middle)
        if pick.size > 4:
            weight = np.where(np.abs(ratio - middle) <= limit, weight, 0.0)
        weight = weight / weight.sum()
        constants[label] = -float(weight @ ratio)
        share[pick] = weight
    return constants, share


def _nearest(samples: Samples, mask: Mask) -> tuple[Ints, Ints, Mask]:
    """The valid pixel nearest to each sample, and whether it is within EDGE_REACH."""
    reach = np.arange(-int(EDGE_REACH), int(EDGE_REACH) + 1)
    row, col = (
        np.clip(np.rint(at).astype(np.int64).clip(0, size - 1)[:, None] + shift.ravel(), 0, size - 1)
        for at, shift, size in zip(
            samples[:2], np.meshgrid(reach, reach, indexing="ij"), mask.shape, strict=True
        )
    )
    away = np.where(mask[row, col], np.hypot(samples.row[:, None] - row, samples.col[:, None] - col), np.inf)
    best = np.arange(len(away)), np.argmin(away, axis=1)
    return row[best], col[best], away[best] <= EDGE_REACH + 0.25


def _windows(mask: Mask, row: Ints, col: Ints, dr: int, dc: int) -> tuple[Ints, Mask]:
    """Start of four valid pixels in a row (dc = 1) or column (dr = 1) around each pixel, and whether there
    are any."""
    steps = _STARTS[:, None] + np.arange(4)
    r, c = row[:, None, None] + dr * steps, col[:, None, None] + dc * steps
    inside = (r >= 0) & (r < mask.shape[0]) & (c >= 0) & (c < mask.shape[1])
    fits = (inside & mask[np.where(inside, r, 0), np.where(inside, c, 0)]).all(axis=2)
    return _STARTS[np.argmax(fits, axis=1)], fits.any(axis=1)


def _integral(start: Ints, away: Floats, terms: int) -> Floats:
    """Weights (2, M, 4) of the integral from 0 to `away` of the cubic (4 terms; 3: the nearest parabola)
    through nodes start .. start + 3.
    """
    order = np.arange(terms)
    moments = away[..., None] ** (order + 1) / (order + 1)
    fits = np.linalg.pinv((np.arange(-3, 1)[:, None] + np.arange(4.0))[..., None] ** order)  # by start + 3
    weights: Floats = np.einsum("amt,amtk->amk", moments, fits[start + 3])
    return weights
