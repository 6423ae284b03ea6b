"""Anchors: where the mirror is known, so that the free mode of the equations is settled.

The slopes leave one degree of freedom per connected component (dt ~ E, the integrating factor: at 45 degrees
h = C x, a rotation about the pattern's edge). Nothing in the image fixes it; an anchor does.

The default is the camera-side edge at rest: the line x = L0, z = 0, reached by extrapolation from the pixels
next to it. It asks that the camera sees up to that line. Where it does not, the default is the middle of a
mirror in open air; of a prism a point, a pixel's height or a distance must be named.

Known distances at places of the image (`Samples`) become linear rows on the grid (`AnchorRows`), whose robust
mean settles the free constant of every component.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from optolever.errors import InputError
from optolever.scene import PinholeCamera, Scene

from ..arrays import Floats, Ints, Labels, Mask
from ..geometry import RayField, rest_distance
from ..measured import Measured

__all__ = [
    "Anchor",
    "AnchorRows",
    "Anchors",
    "DistanceAnchor",
    "EdgeAnchor",
    "PixelAnchor",
    "PointAnchor",
    "Samples",
    "anchor_rows",
    "anchor_samples",
    "free_constants",
]

EDGE_REACH = 4.0  # pixels over which the slope may be extrapolated to the edge
_THERE = 0.05  # pixels: an anchor so near needs no slopes
_STARTS = (-1, 0, -3, -2)  # where a window of four pixels may start, relative to the pixel; the best first

#: Where a mirror may be, mm: scenes go no further.
_MOST = 1e9


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


@dataclass(frozen=True, slots=True)
class DistanceAnchor:
    """The mirror point on the ray of the (fractional) pixel lies `distance`, give or take sigma, along it,
    mm.
    """

    row: float
    col: float
    distance: float
    sigma: float = 0.0


#: What settles the free mode of a component.
Anchor = EdgeAnchor | PointAnchor | PixelAnchor | DistanceAnchor
Anchors = Anchor | str | tuple[float, float, float] | Sequence[Anchor | tuple[float, float, float]] | None


@dataclass(frozen=True, slots=True)
class Samples:
    """Known distances: at pixel (row, col) the mirror is `distance` mm along the ray, give or take sigma mm;
    (M,) each.
    """

    row: Floats
    col: Floats
    distance: Floats
    sigma: Floats

    def window(self, row: int, col: int) -> "Samples":
        """The same in the pixels of a window that starts at (row, col)."""
        return Samples(self.row - row, self.col - col, self.distance, self.sigma)

    def transposed(self) -> "Samples":
        """Rows and columns exchanged."""
        return Samples(self.col, self.row, self.distance, self.sigma)


def anchor_samples(anchor: Anchors, scene: Scene, rays: RayField, mask: Mask) -> Samples:
    """Anchors as known distances at pixels. 'edge': the camera-side edge at rest; 'middle': the middle at
    rest; None: the edge, or the middle in open air where no valid pixel lies at the edge.

    Raises InputError if an anchor cannot be used with this scene and mask.
    """
    try:
        parts = [_samples(one, scene, rays, mask) for one in _listed(anchor, scene)]
    except InputError:
        if anchor is not None or not _in_open_air(scene):
            raise
        parts = [_samples(_middle(scene), scene, rays, mask)]
    return Samples(
        *(
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("row", "col", "distance", "sigma")
        )
    )


def _in_open_air(scene: Scene) -> bool:
    return isinstance(scene.camera, PinholeCamera) and scene.camera.face is None and scene.medium is None


def _middle(scene: Scene) -> PointAnchor:
    """The middle of the mirror at rest."""
    x, y = 0.5 * scene.mirror.length, 0.5 * scene.mirror.width
    form = scene.rest_form
    z = 0.0 if form is None else float(form.height(np.array(x), np.array(y), scene.mirror))
    return PointAnchor(x, y, z)


def _listed(anchor: Anchors, scene: Scene) -> Sequence[Anchor]:
    if isinstance(anchor, str) and anchor == "middle":
        return [_middle(scene)]
    if anchor is None or (isinstance(anchor, str) and anchor == "edge"):
        return [EdgeAnchor()]
    if isinstance(anchor, str) and anchor == "none":
        raise InputError(
            "anchor = 'none': the height is free by one mode, name 'edge', 'middle' or a known point"
        )
    if isinstance(anchor, str):
        raise InputError(f"anchor = {anchor!r}: unknown, the names are 'edge' and 'middle'; else give points")
    if isinstance(anchor, Anchor):
        return [anchor]
    anchors: list[Any] = list(anchor) if isinstance(anchor, Iterable) else [anchor]
    if not anchors:
        raise InputError("anchor = []: no anchor; at least one is needed, 'edge' or a known point")
    if all(isinstance(part, int | float | np.number) for part in anchors):
        return [_point(anchors)]
    return [part if isinstance(part, Anchor) else _point(part) for part in anchors]


def _point(values: Any) -> PointAnchor:
    try:
        x, y, z = (float(number) for number in values)
    except (TypeError, ValueError):
        raise InputError(f"anchor = {values!r}: a known point has three coordinates x, y, z (mm)") from None
    return PointAnchor(x, y, z)


def _samples(anchor: Anchor, scene: Scene, rays: RayField, mask: Mask) -> Samples:
    for name in anchor.__slots__:
        if not abs(getattr(anchor, name)) <= _MOST:
            raise InputError(f"anchor.{name} = {getattr(anchor, name)}: must be finite, at most {_MOST:g} mm")
    for name in ("sigma", "distance"):
        if getattr(anchor, name, 0.0) < 0:
            raise InputError(f"anchor.{name} = {getattr(anchor, name)}: must be at least 0 mm")
    if isinstance(anchor, EdgeAnchor):
        return _edge_samples(anchor, scene, rays, mask)
    if isinstance(anchor, PointAnchor):
        row, col, distance = _locate(np.array([anchor.x, anchor.y, anchor.z]), scene.camera, rays)
    else:
        row, col = anchor.row, anchor.col
        rows, cols = rays.shape
        if not (-0.5 <= row <= rows - 0.5 and -0.5 <= col <= cols - 0.5):
            raise InputError(f"anchor pixel ({row}, {col}): lies outside the image of {rows} x {cols}")
    origin, direction = _ray(scene.camera, row, col)
    sigma = anchor.sigma / abs(direction[2])
    if isinstance(anchor, PixelAnchor):
        distance = float((anchor.z - origin[2]) / direction[2])
    elif isinstance(anchor, DistanceAnchor):
        distance, sigma = anchor.distance, anchor.sigma
    return Samples(*(np.array([value], dtype=np.float64) for value in (row, col, distance, sigma)))


def _edge_samples(anchor: EdgeAnchor, scene: Scene, rays: RayField, mask: Mask) -> Samples:
    """Where the image of the line x = L0, z = 0 crosses the rows (or the columns) next to valid pixels."""
    length = scene.mirror.length
    x = _rest_x(rays.inner_origins, rays.inner_directions)
    with np.errstate(invalid="ignore"):  # rays along the mirror meet it nowhere
        per_row, per_col = (np.gradient(x, axis=axis) for axis in (0, 1))
    axis = int(np.median(np.abs(per_col)) >= np.median(np.abs(per_row)))
    step = per_col if axis == 1 else per_row
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = (length - x) / step  # pixels from here to the line
        away = np.where(mask & (np.abs(offset) <= EDGE_REACH + 0.25), np.abs(offset), np.inf)
    lines = np.flatnonzero(np.isfinite(away.min(axis=axis)))
    if lines.size == 0:
        raise InputError(
            f"anchor = 'edge': no valid pixel within {EDGE_REACH:g} pixels of the mirror's camera-side edge "
            f"x = {length:g} mm at rest; name a point on the mirror"
        )
    at = np.argmin(away, axis=axis)[lines]
    picked = (lines, at) if axis == 1 else (at, lines)
    along, fixed = at + offset[picked], lines.astype(np.float64)
    for _ in range(3):  # the line's exact position: chord steps on the rays themselves
        origins, directions = _rays(scene.camera, fixed, along, axis)
        along = along + (length - _rest_x(origins, directions)) / step[picked]
    origins, directions = _rays(scene.camera, fixed, along, axis)
    row, col = (fixed, along) if axis == 1 else (along, fixed)
    # one error common to the edge: the mean over its lines must not reduce it
    sigma = anchor.sigma * np.sqrt(lines.size) / np.abs(directions[2])
    return Samples(row, col, _to_rest(origins, directions, scene), sigma)


def _to_rest(origins: Floats, directions: Floats, scene: Scene) -> Floats:
    """Distance along rays (3, M) to the mirror at rest."""
    distance: Floats = rest_distance(origins, directions)
    if scene.rest_form is not None:
        for _ in range(3):  # a form of micrometres: each step leaves a slope's part of the last one
            x, y, z = origins + distance * directions
            distance = distance + (scene.rest_form.height(x, y, scene.mirror) - z) / directions[2]
    return distance


def _rays(camera: Any, fixed: Floats, along: Floats, axis: int) -> tuple[Floats, Floats]:
    """Rays (3, M) at positions along an image axis (1: columns) on fixed lines of the other."""
    row, col = (fixed, along) if axis == 1 else (along, fixed)
    origins, directions = (np.moveaxis(np.asarray(part), -1, 0) for part in camera.rays_at(row, col))
    return origins, directions


def _rest_x(origins: Floats, directions: Floats) -> Floats:
    x: Floats = origins[0] + rest_distance(origins, directions) * directions[0]
    return x


def _locate(point: Floats, camera: Any, rays: RayField) -> tuple[float, float, float]:
    """Pixel (row, col) whose ray passes through the point, and the distance along it."""
    offset = point[:, None, None] - rays.inner_origins
    along = np.einsum("kij,kij->ij", offset, rays.inner_directions)
    miss = np.einsum("kij,kij->ij", offset, offset) - along**2
    row, col = (float(index) for index in np.unravel_index(int(np.argmin(miss)), miss.shape))
    for _ in range(20):
        origin, direction = _ray(camera, row, col)
        distance = float((point - origin) @ direction)
        residual = point - origin - distance * direction
        columns = []
        for dr, dc in ((0.5, 0.0), (0.0, 0.5)):
            ahead, behind = _ray(camera, row + dr, col + dc), _ray(camera, row - dr, col - dc)
            columns.append(ahead[0] - behind[0] + distance * (ahead[1] - behind[1]))
        shift = np.linalg.lstsq(np.stack(columns, axis=1), residual, rcond=None)[0]
        row, col = row + float(shift[0]), col + float(shift[1])
        if np.abs(shift).max() < 1e-12 * max(rays.shape):
            break
    rows, cols = rays.shape
    if not (-0.5 <= row <= rows - 0.5 and -0.5 <= col <= cols - 0.5):
        raise InputError(
            f"anchor point ({point[0]:g}, {point[1]:g}, {point[2]:g}) mm: seen at pixel "
            f"({row:.1f}, {col:.1f}), outside the image of {rows} x {cols}"
        )
    origin, direction = _ray(camera, row, col)
    return row, col, float((point - origin) @ direction)


def _ray(camera: Any, row: float, col: float) -> tuple[Floats, Floats]:
    origin, direction = camera.rays_at(row, col)
    return np.asarray(origin), np.asarray(direction)


@dataclass(frozen=True, slots=True)
class AnchorRows:
    """Known values of the unknown near valid pixels, M of them.

    The value predicted at an anchor is w[pixel] + p[at_p] . by_p + q[at_q] . by_q: from the nearest valid
    pixel along the row, then along the column, by the cubic through four slopes. more_p: excess of the cubic
    over the parabola nearest to the same slopes; known: w there; reach: pixels travelled; sigma: of the known
    value, in units of w; component: label of the pixel.
    """

    pixel: Ints
    at_p: Ints
    by_p: Floats
    more_p: Floats
    at_q: Ints
    by_q: Floats
    known: Floats
    sigma: Floats
    reach: Floats
    component: Ints

    def predict(self, w: Floats, p: Floats, q: Floats) -> Floats:
        """Value of the unknown at the anchors, (M,)."""
        along_row = np.einsum("mk,mk->m", p.ravel()[self.at_p], self.by_p)
        along_col = np.einsum("mk,mk->m", q.ravel()[self.at_q], self.by_q)
        value: Floats = w.ravel()[self.pixel] + along_row + along_col
        return value

    def bend(self, p: Floats) -> Floats:
        """Excess of the cubic along the row over the parabola, (M,): above the cubic's error on a curve."""
        added: Floats = np.einsum("mk,mk->m", p.ravel()[self.at_p], self.more_p)
        return added

    def spread(self, var_p: Floats, var_q: Floats) -> Floats:
        """Variance that the way from the pixels adds, of the slopes', (M,)."""
        along_row = np.einsum("mk,mk->m", var_p.ravel()[self.at_p], self.by_p**2)
        along_col = np.einsum("mk,mk->m", var_q.ravel()[self.at_q], self.by_q**2)
        added: Floats = along_row + along_col
        return added


def anchor_rows(samples: Samples, data: Measured, labels: Labels) -> AnchorRows:
    """Tie the samples (in this grid's pixels) to the nearest valid pixels, except samples without one in
    reach or with fewer than four slopes on the way.
    """
    mask = data.mask
    row, col, found = _nearest(samples, mask)
    keep = np.flatnonzero(found)
    row, col = row[keep], col[keep]
    delta_row, delta_col = samples.row[keep] - row, samples.col[keep] - col
    start_p, whole_p = _windows(mask, row, col, 0, 1)
    start_q, whole_q = _windows(mask, row, col, 1, 0)
    told = (whole_p | (np.abs(delta_col) < _THERE)) & (whole_q | (np.abs(delta_row) < _THERE))
    keep, row, col = keep[told], row[told], col[told]
    delta_row, delta_col = delta_row[told], delta_col[told]
    start_p, start_q, whole_p, whole_q = start_p[told], start_q[told], whole_p[told], whole_q[told]
    by_p = np.where(whole_p[:, None], _integral(start_p, delta_col), _own(start_p, delta_col))
    by_q = np.where(whole_q[:, None], _integral(start_q, delta_row), _own(start_q, delta_row))
    pixel = row * mask.shape[1] + col
    index = np.arange(4)
    at_p = np.where(whole_p[:, None], pixel[:, None] + start_p[:, None] + index, pixel[:, None])
    more_p = np.where(whole_p[:, None], by_p - _integral(start_p, delta_col, 3), 0.0)
    rows_q = np.where(whole_q[:, None], row[:, None] + start_q[:, None] + index, row[:, None])
    at_q = rows_q * mask.shape[1] + col[:, None]
    distance = samples.distance[keep]
    unit = 1.0 / distance if data.rays.logarithmic else np.ones(distance.shape)
    return AnchorRows(
        pixel=pixel,
        at_p=at_p,
        by_p=by_p,
        more_p=more_p,
        at_q=at_q,
        by_q=by_q,
        known=data.unknown(distance),
        sigma=samples.sigma[keep] * unit,
        reach=np.hypot(delta_row, delta_col),
        component=labels[row, col].astype(np.int64),
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
    """The valid pixel nearest to each sample within EDGE_REACH."""
    rows, cols = mask.shape
    row0 = np.clip(np.rint(samples.row), 0, rows - 1).astype(np.int64)
    col0 = np.clip(np.rint(samples.col), 0, cols - 1).astype(np.int64)
    row, col, best = row0.copy(), col0.copy(), np.full(row0.shape, np.inf)
    reach = int(EDGE_REACH)
    for dr in range(-reach, reach + 1):
        for dc in range(-reach, reach + 1):
            r, c = np.clip(row0 + dr, 0, rows - 1), np.clip(col0 + dc, 0, cols - 1)
            away = np.where(mask[r, c], np.hypot(samples.row - r, samples.col - c), np.inf)
            closer = away < best
            row, col, best = np.where(closer, r, row), np.where(closer, c, col), np.minimum(away, best)
    return row, col, best <= EDGE_REACH + 0.25


def _windows(mask: Mask, row: Ints, col: Ints, dr: int, dc: int) -> tuple[Ints, Mask]:
    """Start of four valid pixels in a row (dc = 1) or column (dr = 1) around each pixel,
    and whether there are any.
    """
    start = np.zeros(row.shape, dtype=np.int64)
    whole = np.zeros(row.shape, dtype=np.bool_)
    for candidate in _STARTS:
        fits = np.ones(row.shape, dtype=np.bool_)
        for k in range(candidate, candidate + 4):
            r, c = row + k * dr, col + k * dc
            inside = (r >= 0) & (r < mask.shape[0]) & (c >= 0) & (c < mask.shape[1])
            fits &= inside & mask[np.where(inside, r, 0), np.where(inside, c, 0)]
        start = np.where(fits & ~whole, candidate, start)
        whole |= fits
    return start, whole


def _integral(start: Ints, delta: Floats, terms: int = 4) -> Floats:
    """Weights (M, 4) of the integral from 0 to delta of the cubic (the nearest parabola: terms 3) through
    nodes start .. start + 3.
    """
    moments = delta[:, None] ** np.arange(1, terms + 1) / np.arange(1, terms + 1)
    out = np.empty((len(start), 4))
    for candidate in np.unique(start):
        powers = (candidate + np.arange(4.0))[:, None] ** np.arange(terms)
        pick = start == candidate
        out[pick] = moments[pick] @ np.linalg.pinv(powers)
    return out


def _own(start: Ints, delta: Floats) -> Floats:
    """Weights for a constant slope, that of the pixel."""
    out = np.zeros((*start.shape, 4))
    out[:, 0] = delta
    return out
