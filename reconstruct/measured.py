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
from dataclasses import dataclass, replace

import numpy as np

from optolever.blocks import over_image
from optolever.kernels import exact, inlined, kernel
from optolever.scene import PatternShape

from .arrays import Floats, Mask
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

    def shifted(self, du: Floats, dv: Floats) -> "Measured":
        """With u and v moved, pattern pixels."""
        return replace(self, u=self.u + du, v=self.v + dv)

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

    def variances(self, w: Floats) -> tuple[Floats, Floats]:
        """Variances of p and q at w that the standard deviations of u and v cause, (rows, cols) each."""
        out = np.empty(w.shape), np.empty(w.shape)
        arrays = self._at(w)
        over_image(lambda start, stop: _variances(*arrays, *out, start, stop), w.shape)
        return out

    def singular(self, w: Floats) -> Mask:
        """Pixels of the mask to which noise leaves no normal n ~ e - d if the mirror is at w.

        e has no direction where X is at P, and is d where X is on the ray's way on from P: X must be farther
        from that half-line than its noise may move it, and farther from P than a pixel's noisy slopes move P.
        """
        found = np.empty(w.shape, dtype=np.bool_)
        arrays = *self._at(w), *self.variances(w), found
        over_image(lambda start, stop: _no_normal(*arrays, start, stop), w.shape)
        return found & self.mask

    def sensitive(self, w: Floats, limit: float) -> Mask:
        """Pixels of the mask where a change of w changes a slope, over one pixel, by at least `limit` times
        itself, as close to the pattern.
        """
        _, _, p_w, q_w = self.slopes(w)
        found: Mask = np.maximum(np.abs(p_w), np.abs(q_w)) >= limit
        return found & self.mask

    def clearance(self, w: Floats) -> Floats:
        """Distance from the mirror point at w to the pattern point, mm; NaN where u or v is."""
        away: Floats = np.linalg.norm(self.to_pattern(w), axis=0)
        return away

    def to_pattern(self, w: Floats) -> Floats:
        """From the mirror points at w to the pattern points, (3, rows, cols) mm."""
        u, v = self._on_plane(w)
        seen = self.plane[0] + u[..., None] * self.plane[1] + v[..., None] * self.plane[2]
        ahead: Floats = np.moveaxis(seen, -1, 0) - self._points(w)
        return ahead

    def _at(self, w: Floats) -> tuple[Floats | bool, ...]:
        """What kernels of the variances take first."""
        sigmas = self.sigma_u, self.sigma_v
        rays = self.rays
        return rays.origins, rays.directions, self.plane, *self._on_plane(w), *sigmas, w, rays.logarithmic

    def _points(self, w: Floats) -> Floats:
        """Mirror points (3, rows, cols) at w, mm."""
        points: Floats = self.rays.inner_origins + self.distance(w) * self.rays.inner_directions
        return points

    def _on_plane(self, w: Floats) -> tuple[Floats, Floats]:
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


@inlined
def _amid(a, i, j):  # type: ignore[no-untyped-def]
    """The mean of a pixel and its neighbours, opposite ones only, so that what is linear stays."""
    total, count = a[i, j], 1
    for di in range(_ALONG + 1):
        for dj in range(-_ACROSS, _ACROSS + 1):
            if di == 0 and dj <= 0:
                continue
            if i < di or i + di >= a.shape[0] or j < abs(dj) or j + abs(dj) >= a.shape[1]:
                continue
            pair = a[i + di, j + dj] + a[i - di, j - dj]
            if math.isfinite(pair):
                total += pair
                count += 2
    return total / count


@exact
def _variances(o, d, plane, u, v, sigma_u, sigma_v, w, log, var_p, var_q, start, stop):  # type: ignore[no-untyped-def]
    size_u, size_v = (
        plane[1, 0] ** 2 + plane[1, 1] ** 2 + plane[1, 2] ** 2,
        (plane[2, 0] ** 2 + plane[2, 1] ** 2 + plane[2, 2] ** 2),
    )
    for i in range(start, stop):
        r = PAD + i
        for j in range(u.shape[1]):
            c = PAD + j
            t = math.exp(w[i, j]) if log else w[i, j]
            dx, dy, dz = d[0, r, c], d[1, r, c], d[2, r, c]
            at_u, at_v = u[i, j], v[i, j]
            noise = size_u * sigma_u[i, j] ** 2 + size_v * sigma_v[i, j] ** 2
            for _ in range(2):
                ex = plane[0, 0] + at_u * plane[1, 0] + at_v * plane[2, 0] - o[0, r, c] - t * dx
                ey = plane[0, 1] + at_u * plane[1, 1] + at_v * plane[2, 1] - o[1, r, c] - t * dy
                ez = plane[0, 2] + at_u * plane[1, 2] + at_v * plane[2, 2] - o[2, r, c] - t * dz
                square = ex * ex + ey * ey + ez * ez
                if not noise > _SWING**2 * square:
                    break
                at_u, at_v = _amid(u, i, j), _amid(v, i, j)
            inverse = 1.0 / math.sqrt(square)
            ex, ey, ez = ex * inverse, ey * inverse, ez * inverse
            nx, ny, nz = ex - dx, ey - dy, ez - dz
            scale = 1.0 / (nx * dx + ny * dy + nz * dz)
            unit = 1.0 / t if log else 1.0
            ue = plane[1, 0] * ex + plane[1, 1] * ey + plane[1, 2] * ez
            ve = plane[2, 0] * ex + plane[2, 1] * ey + plane[2, 2] * ez
            # to second order: noise along the way changes what noise across it does
            more = 1.0 + 3.0 * ((ue * sigma_u[i, j]) ** 2 + (ve * sigma_v[i, j]) ** 2) / square
            factor = scale * inverse * unit
            for axis in range(2):
                if axis == 0:
                    ax = _along_cols(o, 0, r, c) + t * _along_cols(d, 0, r, c)
                    ay = _along_cols(o, 1, r, c) + t * _along_cols(d, 1, r, c)
                    az = _along_cols(o, 2, r, c) + t * _along_cols(d, 2, r, c)
                else:
                    ax = _along_rows(o, 0, r, c) + t * _along_rows(d, 0, r, c)
                    ay = _along_rows(o, 1, r, c) + t * _along_rows(d, 1, r, c)
                    az = _along_rows(o, 2, r, c) + t * _along_rows(d, 2, r, c)
                s = -scale * (nx * ax + ny * ay + nz * az)
                ax, ay, az = ax + s * dx, ay + s * dy, az + s * dz
                eT = ex * ax + ey * ay + ez * az
                by_u = (
                    factor
                    * sigma_u[i, j]
                    * (plane[1, 0] * ax + plane[1, 1] * ay + plane[1, 2] * az - ue * eT)
                )
                by_v = (
                    factor
                    * sigma_v[i, j]
                    * (plane[2, 0] * ax + plane[2, 1] * ay + plane[2, 2] * az - ve * eT)
                )
                if axis == 0:
                    var_p[i, j] = more * (by_u * by_u + by_v * by_v)
                else:
                    var_q[i, j] = more * (by_u * by_u + by_v * by_v)


@exact
def _no_normal(o, d, plane, u, v, sigma_u, sigma_v, w, log, var_p, var_q, out, start, stop):  # type: ignore[no-untyped-def]
    size_u = plane[1, 0] ** 2 + plane[1, 1] ** 2 + plane[1, 2] ** 2
    size_v = plane[2, 0] ** 2 + plane[2, 1] ** 2 + plane[2, 2] ** 2
    for i in range(start, stop):
        r = PAD + i
        for j in range(u.shape[1]):
            c = PAD + j
            t = math.exp(w[i, j]) if log else w[i, j]
            unit = t if log else 1.0
            away, ahead = 0.0, 0.0
            for k in range(3):
                x = plane[0, k] + u[i, j] * plane[1, k] + v[i, j] * plane[2, k] - o[k, r, c] - t * d[k, r, c]
                away += x * x
                ahead += x * d[k, r, c]
            beside = away - max(ahead, 0.0) ** 2
            noise = max(size_u * sigma_u[i, j] ** 2, size_v * sigma_v[i, j] ** 2)
            moved = unit * unit * max(var_p[i, j], var_q[i, j])
            out[i, j] = not (beside > _SURE**2 * noise and away > moved)
