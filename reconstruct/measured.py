"""What a solve works on: the measurement and the rays of one pixel grid, and the mirror's equations there.

The mirror point is P = o + t d, the pattern point X(u, v), e = (X - P)/|X - P|. The normal bisects, n ~ e -
d, and the mirror's tangents are normal to it, n . dP/di = 0; hence with the ray field's derivative along a
pixel axis

    p = dt/di = -n . (o_i + t d_i) / (n . d)

and, with the tangent T = o_i + t d_i + p d, any change of the normal moves it by dp = -(dn . T) / (n . d);
dn/dt = -(d - (d.e) e)/|X - P| gives p_t (plus the change of the tangent itself, -n . d_i / (n . d)),
dn/du = (U - (U.e) e)/|X - P| the error that the decoder's sigma causes.
With the unknown w = log t, the slopes are p/t, their derivative with respect to w is p_t - p/t.
"""

import math
from dataclasses import dataclass

import numpy as np

from optolever.blocks import over_image
from optolever.kernels import exact, inlined, kernel
from optolever.scene import PatternShape

from .arrays import Floats, Mask, Pair
from .geometry import PAD, RayField, rest_distance

__all__ = ["Measured"]

_SWING = 0.05  # noise over the way to the pattern: what noise does to a slope depends on where noise put it
_SURE = 3.0  # standard deviations: beyond them lies noise of a normal distribution but for 0.3 %
_ALONG, _ACROSS = 2, 1  # rows and columns on either side that predict where it lies without noise
#: Share of pixels, at least, in the middles of a discrete code's cells: in noise its decoder returns means
#: of several cells (of up to 88 % of the pixels). Coordinates of other codes are nowhere exactly at a middle.
_MIDDLES = 0.05
#: Rows sampled for that, about.
_ROWS = 64


@dataclass(frozen=True, slots=True)
class Measured:
    """Correspondences on a grid with their rays.

    u, v, sigma_u, sigma_v (rows, cols) pattern pixels, used where mask is true; plane (3, 3): see
    `geometry.pattern_plane`; shape: of the pattern's surface off that plane. With one, a mirror at w looks at
    the place of the plane on the line to the pattern point: slopes depend on the direction alone.
    """

    rays: RayField
    plane: Floats
    u: Floats
    v: Floats
    sigma_u: Floats
    sigma_v: Floats
    mask: Mask
    shape: PatternShape | None = None

    def whole_cells(self, bridged: Mask) -> bool:
        """Whether u and v come from a discrete code: middles of cells, multiples of half a pixel. Their
        errors are those of neighbours, so that differences of neighbours say nothing about them.
        bridged (rows, cols): pixels that were interpolated.
        """
        rows = slice(None, None, max(1, len(self.u) // _ROWS))
        seen = self.mask[rows] & ~bridged[rows]
        values = (part[rows][seen] for part in (self.u, self.v))
        return all(bool(np.mean(2 * x == np.rint(2 * x)) > _MIDDLES) for x in values)

    def slopes(self, w: Floats) -> tuple[Floats, ...]:
        """Slopes p, q (along columns, along rows) of the unknown at w, and their derivatives dp/dw, dq/dw;
        (rows, cols) each, NaN where u or v is."""
        p, q, p_w, q_w = (np.empty(w.shape) for _ in range(4))
        u, v = self._on_plane(w)
        with np.errstate(over="ignore", invalid="ignore"):
            t = self.distance(w)
            arrays = self.rays.origins, self.rays.directions, self.plane, u, v, t, p, q, p_w, q_w
            over_image(lambda start, stop: _slopes(*arrays, start, stop), w.shape)
            if self.rays.logarithmic:
                for slope, change in ((p, p_w), (q, q_w)):
                    slope /= t
                    change -= slope
        return p, q, p_w, q_w

    def variances(self, w: Floats, every: int = 1) -> Pair:
        """Variances of p and q at w that the standard deviations of u and v cause, (rows, cols) each; NaN but
        in every such row.

        Where the noise is large as against the way to the pattern, that way is the one without noise: to the
        mean of neighbours.
        """
        found, (u, v) = (np.full(w.shape, np.nan), np.full(w.shape, np.nan)), self._on_plane(w)
        rays, sigmas, last = self.rays, (self.sigma_u, self.sigma_v), (w, self.rays.logarithmic)

        def take(u: Floats, v: Floats, swing: float) -> None:
            arrays = rays.origins, rays.directions, self.plane, u, v, *sigmas, *last, swing, *found
            if every == 1:
                over_image(lambda start, stop: _variances(*arrays, start, stop), w.shape)
            for row in range(0, len(w), every) if every > 1 else ():
                _variances(*arrays, row, row + 1)

        take(u, v, _SWING)
        noisy = found[0] < 0
        if noisy.any():
            take(_amid(u, noisy), _amid(v, noisy), math.inf)
        return found

    def singular(self, w: Floats) -> Mask:
        """Pixels of the mask to which noise leaves no normal n ~ e - d if the mirror is at w.

        e has no direction where X is at P, and is d where X is on the ray's way on from P: X must be farther
        from that half-line than its noise may move it, and farther from P than a pixel's noisy slopes move P.
        """
        moved, way = np.maximum(*self.variances(w)), self.to_pattern(w)
        if self.rays.logarithmic:
            moved *= np.square(self.distance(w))
        away = np.einsum("kij,kij->ij", way, way)
        ahead = np.maximum(np.einsum("kij,kij->ij", way, self.rays.inner_directions), 0.0)
        pitch = np.linalg.norm(self.plane[1:], axis=1)
        noise = _SURE * np.maximum(pitch[0] * self.sigma_u, pitch[1] * self.sigma_v)
        with np.errstate(invalid="ignore"):
            found: Mask = ~((away - np.square(ahead) > np.square(noise)) & (away > moved))
        return found & self.mask

    def sensitive(self, w: Floats, limit: float) -> Mask:
        """Pixels of the mask where a change of w changes a slope, over one pixel, by at least `limit` times
        itself, as close to the pattern.
        """
        _, _, p_w, q_w = self.slopes(w)
        found: Mask = np.maximum(np.abs(p_w), np.abs(q_w)) >= limit
        return found & self.mask

    def to_pattern(self, w: Floats) -> Floats:
        """X - P, from the mirror points at w to the pattern points, (3, rows, cols) mm."""
        (u, v), way = self._on_plane(w), self._points(w)
        for part, (start, by_u, by_v) in zip(way, self.plane.T, strict=True):
            np.subtract(start + u * by_u + v * by_v, part, out=part)
        return way

    def _points(self, w: Floats) -> Floats:
        """Mirror points (3, rows, cols) at w, mm."""
        points = self.distance(w) * self.rays.inner_directions
        points += self.rays.inner_origins
        return points

    def _on_plane(self, w: Floats) -> Pair:
        """u and v of the projections of the pattern's points from w onto its plane.

        e/h of the way from point to mirror, whose height over the plane is h, e that of the pattern point.
        """
        if self.shape is None:
            return self.u, self.v
        pitch = np.linalg.norm(self.plane[1:], axis=1)
        axes = self.plane[1:] / pitch[:, None]
        offset = self.shape.offset(self.u, self.v)
        local = np.tensordot(
            np.stack([*axes, np.cross(*axes)]), self._points(w) - self.plane[0][:, None, None], 1
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            share = offset[..., 2] / (local[2] - offset[..., 2])
        u, v = (
            (at := own + offset[..., k] / pitch[k]) - share * (local[k] / pitch[k] - at)
            for k, own in enumerate((self.u, self.v))
        )
        return u, v

    def rest(self) -> Floats:
        """The unknown of the mirror at rest: t in mm, or log t."""
        return self.unknown(rest_distance(self.rays.inner_origins, self.rays.inner_directions))

    def unknown(self, distance: Floats) -> Floats:
        """t -> w."""
        return np.log(distance) if self.rays.logarithmic else distance

    def distance(self, w: Floats) -> Floats:
        """w -> t in mm."""
        return np.exp(w) if self.rays.logarithmic else w


@inlined
def _along_cols(a, k, r, c):  # type: ignore[no-untyped-def]
    return (8.0 * (a[k, r, c + 1] - a[k, r, c - 1]) - (a[k, r, c + 2] - a[k, r, c - 2])) / 12.0


@inlined
def _along_rows(a, k, r, c):  # type: ignore[no-untyped-def]
    return (8.0 * (a[k, r + 1, c] - a[k, r - 1, c]) - (a[k, r + 2, c] - a[k, r - 2, c])) / 12.0


@inlined
def _tilt(t, g, o, d, n, m, scale):  # type: ignore[no-untyped-def]
    """Change of t along an axis, and its derivative by t. g, o: change of the ray's direction and origin
    along the axis; m: of the normal n by t; scale = -1 / (n . d).
    """
    ax, ay, az = o[0] + t * g[0], o[1] + t * g[1], o[2] + t * g[2]
    slope = scale * (n[0] * ax + n[1] * ay + n[2] * az)
    tangent = m[0] * (ax + slope * d[0]) + m[1] * (ay + slope * d[1]) + m[2] * (az + slope * d[2])
    return slope, scale * (tangent + (n[0] * g[0] + n[1] * g[1] + n[2] * g[2]))


@kernel
def _slopes(o, d, plane, u, v, t, p, q, p_t, q_t, start, stop):  # type: ignore[no-untyped-def]
    for i in range(start, stop):
        r = PAD + i
        for j in range(u.shape[1]):
            c = PAD + j
            dx, dy, dz = d[0, r, c], d[1, r, c], d[2, r, c]
            ex = plane[0, 0] + u[i, j] * plane[1, 0] + v[i, j] * plane[2, 0] - o[0, r, c] - t[i, j] * dx
            ey = plane[0, 1] + u[i, j] * plane[1, 1] + v[i, j] * plane[2, 1] - o[1, r, c] - t[i, j] * dy
            ez = plane[0, 2] + u[i, j] * plane[1, 2] + v[i, j] * plane[2, 2] - o[2, r, c] - t[i, j] * dz
            inverse = 1.0 / math.sqrt(ex * ex + ey * ey + ez * ez)
            ex, ey, ez = ex * inverse, ey * inverse, ez * inverse
            de = dx * ex + dy * ey + dz * ez
            n = ex - dx, ey - dy, ez - dz
            m = -(dx - de * ex) * inverse, -(dy - de * ey) * inverse, -(dz - de * ez) * inverse
            scale = -1.0 / (n[0] * dx + n[1] * dy + n[2] * dz)
            ray = dx, dy, dz

            g = _along_cols(d, 0, r, c), _along_cols(d, 1, r, c), _along_cols(d, 2, r, c)
            moved = _along_cols(o, 0, r, c), _along_cols(o, 1, r, c), _along_cols(o, 2, r, c)
            slope, change = _tilt(t[i, j], g, moved, ray, n, m, scale)
            p[i, j] = slope
            p_t[i, j] = change

            g = _along_rows(d, 0, r, c), _along_rows(d, 1, r, c), _along_rows(d, 2, r, c)
            moved = _along_rows(o, 0, r, c), _along_rows(o, 1, r, c), _along_rows(o, 2, r, c)
            slope, change = _tilt(t[i, j], g, moved, ray, n, m, scale)
            q[i, j] = slope
            q_t[i, j] = change


def _amid(values: Floats, where: Mask) -> Floats:
    """The values, there replaced by the mean of the pixel and its known neighbours, opposite ones only, so
    that what is linear stays."""
    around = np.pad(values, ((_ALONG, _ALONG), (_ACROSS, _ACROSS)), constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(around, (2 * _ALONG + 1, 2 * _ACROSS + 1))[where]
    means = values.copy()
    means[where] = np.nanmean(0.5 * (windows + windows[:, ::-1, ::-1]), axis=(1, 2))
    return means


@inlined
def _spread(t, g, o, d, e, n, scale, by_u, by_v):  # type: ignore[no-untyped-def]
    """Squared change of the slope along an axis by by_u and by_v, moves of X less their part along e, over
    the way to X. g, o: as in `_tilt`."""
    ax, ay, az = o[0] + t * g[0], o[1] + t * g[1], o[2] + t * g[2]
    s = -scale * (n[0] * ax + n[1] * ay + n[2] * az)
    ax, ay, az = ax + s * d[0], ay + s * d[1], az + s * d[2]
    along = e[0] * ax + e[1] * ay + e[2] * az
    one = by_u[0] * ax + by_u[1] * ay + by_u[2] * az - by_u[3] * along
    other = by_v[0] * ax + by_v[1] * ay + by_v[2] * az - by_v[3] * along
    return one * one + other * other


@exact
def _variances(o, d, plane, u, v, sigma_u, sigma_v, w, log, swing, var_p, var_q, start, stop):  # type: ignore[no-untyped-def]
    """What is not known yet; -1 where noise is more than `swing` of the way to the pattern."""
    for i in range(start, stop):
        r = PAD + i
        for j in range(u.shape[1]):
            if var_p[i, j] >= 0.0:
                continue
            c = PAD + j
            t = math.exp(w[i, j]) if log else w[i, j]
            ray = d[0, r, c], d[1, r, c], d[2, r, c]
            ex = plane[0, 0] + u[i, j] * plane[1, 0] + v[i, j] * plane[2, 0] - o[0, r, c] - t * ray[0]
            ey = plane[0, 1] + u[i, j] * plane[1, 1] + v[i, j] * plane[2, 1] - o[1, r, c] - t * ray[1]
            ez = plane[0, 2] + u[i, j] * plane[1, 2] + v[i, j] * plane[2, 2] - o[2, r, c] - t * ray[2]
            square = ex * ex + ey * ey + ez * ez
            s, k = sigma_u[i, j], sigma_v[i, j]
            u_x, u_y, u_z = s * plane[1, 0], s * plane[1, 1], s * plane[1, 2]
            v_x, v_y, v_z = k * plane[2, 0], k * plane[2, 1], k * plane[2, 2]
            noise = u_x * u_x + u_y * u_y + u_z * u_z + v_x * v_x + v_y * v_y + v_z * v_z
            if noise > swing * swing * square:
                var_p[i, j] = -1.0
                continue
            inverse = 1.0 / math.sqrt(square)
            e = ex * inverse, ey * inverse, ez * inverse
            n = e[0] - ray[0], e[1] - ray[1], e[2] - ray[2]
            scale = 1.0 / (n[0] * ray[0] + n[1] * ray[1] + n[2] * ray[2])
            by_u = u_x, u_y, u_z, u_x * e[0] + u_y * e[1] + u_z * e[2]
            by_v = v_x, v_y, v_z, v_x * e[0] + v_y * e[1] + v_z * e[2]
            # to second order: noise along the way changes what noise across it does
            more = 1.0 + 3.0 * (by_u[3] * by_u[3] + by_v[3] * by_v[3]) / square
            factor = scale * inverse / t if log else scale * inverse
            g = _along_cols(d, 0, r, c), _along_cols(d, 1, r, c), _along_cols(d, 2, r, c)
            moved = _along_cols(o, 0, r, c), _along_cols(o, 1, r, c), _along_cols(o, 2, r, c)
            var_p[i, j] = more * factor * factor * _spread(t, g, moved, ray, e, n, scale, by_u, by_v)
            g = _along_rows(d, 0, r, c), _along_rows(d, 1, r, c), _along_rows(d, 2, r, c)
            moved = _along_rows(o, 0, r, c), _along_rows(o, 1, r, c), _along_rows(o, 2, r, c)
            var_q[i, j] = more * factor * factor * _spread(t, g, moved, ray, e, n, scale, by_u, by_v)
