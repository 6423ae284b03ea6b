"""The mirror's equations in closed form, pixel by pixel.

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

import numpy as np

from optolever.blocks import over_image
from optolever.kernels import exact, inlined, kernel

from ..arrays import Floats, Mask
from ..geometry import PAD, RayField

__all__ = ["no_normal", "slope_variances", "slopes"]

_SWING = 0.05  # noise over the way to the pattern: what noise does to a slope depends on where noise put it
_SURE = 3.0  # standard deviations: beyond them lies noise of a normal distribution but for 0.3 %
_ALONG, _ACROSS = 2, 1  # rows and columns on either side that predict where it lies without noise


def slopes(rays: RayField, plane: Floats, u: Floats, v: Floats, w: Floats) -> tuple[Floats, ...]:
    """Slopes of the unknown per pixel and their derivatives with respect to it.

    u, v, w: (rows, cols); w: t in mm, or log t.
    Returns p, q (along columns, along rows) and dp/dw, dq/dw; NaN where u or v is.
    """
    p, q, p_w, q_w = (np.empty(u.shape) for _ in range(4))
    with np.errstate(over="ignore", invalid="ignore"):
        t = np.exp(w) if rays.logarithmic else w
        arrays = rays.origins, rays.directions, plane, u, v, t, p, q, p_w, q_w
        over_image(lambda start, stop: _slopes(*arrays, start, stop), u.shape)
        if rays.logarithmic:
            for slope, change in ((p, p_w), (q, q_w)):
                slope /= t
                change -= slope
    return p, q, p_w, q_w


def slope_variances(
    rays: RayField,
    plane: Floats,
    u: Floats,
    v: Floats,
    sigma_u: Floats,
    sigma_v: Floats,
    w: Floats,
) -> tuple[Floats, Floats]:
    """Variances of p and q that the standard deviations of u and v (pattern pixels) cause."""
    out = np.empty(u.shape), np.empty(u.shape)
    log = rays.logarithmic
    over_image(
        lambda start, stop: _variances(
            rays.origins, rays.directions, plane, u, v, sigma_u, sigma_v, w, log, *out, start, stop
        ),
        u.shape,
    )
    return out


def no_normal(
    rays: RayField,
    plane: Floats,
    u: Floats,
    v: Floats,
    sigma_u: Floats,
    sigma_v: Floats,
    w: Floats,
    var_p: Floats,
    var_q: Floats,
) -> Mask:
    """Pixels whose normal n ~ e - d is lost in noise, (rows, cols).

    e has no direction where X is at P, and is d where X is on the ray's way on from P: X must be farther
    from that half-line than its noise may move it, and farther from P than a pixel's noisy slopes, of
    variances var_p and var_q, move P.
    """
    found = np.empty(u.shape, dtype=np.bool_)
    log = rays.logarithmic
    arrays = rays.origins, rays.directions, plane, u, v, sigma_u, sigma_v, w, var_p, var_q, log, found
    over_image(lambda start, stop: _no_normal(*arrays, start, stop), u.shape)
    return found


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
def _no_normal(o, d, plane, u, v, sigma_u, sigma_v, w, var_p, var_q, log, out, start, stop):  # type: ignore[no-untyped-def]
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
