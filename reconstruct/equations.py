"""The mirror's equations in closed form, pixel by pixel.

The mirror point is P = o + t d, the pattern point X(u, v), e = (X - P)/|X - P|. The normal bisects, n ~ e -
d,
and the mirror holds its own tangents, n . dP/di = 0; hence with the ray field's derivative along a pixel axis

    p = dt/di = -n . (o_i + t d_i) / (n . d)

and, with the tangent T = o_i + t d_i + p d, any change of the normal moves it by dp = -(dn . T) / (n . d);
dn/dt = -(d - (d.e) e)/|X - P| gives p_t (plus the change of the tangent itself, -n . d_i / (n . d)),
dn/du = (U - (U.e) e)/|X - P| the error that the decoder's sigma causes.
With the unknown w = log t, the slopes are p/t, their derivative with respect to w is p_t - p/t.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from optolever.blocks import over_image
from optolever.compiling import Apart

from .geometry import PAD, RayField

__all__ = ["slope_variances", "slopes"]

Floats = NDArray[np.float64]


def slopes(
    rays: RayField, plane: Floats, u: Floats, v: Floats, w: Floats, step: int = 1
) -> tuple[Floats, ...]:
    """Slopes of the unknown per pixel step and their derivatives with respect to it.

    rays: the fine grid; u, v, w: (rows, cols) arrays of its every step-th pixel. w: t in mm, or log t.
    Returns p, q (along columns, along rows) and dp/dw, dq/dw; NaN where u or v is.
    """
    p, q, p_w, q_w = (np.empty(u.shape) for _ in range(4))
    log = rays.logarithmic
    if step == 1 and not log:
        arrays = rays.origins, rays.directions, plane, u, v, w, p, q, p_w, q_w
        over_image(lambda start, stop: _fine_slopes(*arrays, start, stop), u.shape)
        return p, q, p_w, q_w
    over_image(
        lambda start, stop: _slopes(
            rays.origins, rays.directions, plane, u, v, w, step, log, p, q, p_w, q_w, start, stop
        ),
        u.shape,
    )
    return p, q, p_w, q_w


def slope_variances(
    rays: RayField,
    plane: Floats,
    u: Floats,
    v: Floats,
    sigma_u: Floats,
    sigma_v: Floats,
    w: Floats,
    step: int = 1,
) -> tuple[Floats, Floats]:
    """Variances of p and q that the standard deviations of u and v (pattern pixels) cause."""
    out = np.empty(u.shape), np.empty(u.shape)
    log = rays.logarithmic
    over_image(
        lambda start, stop: _variances(
            rays.origins, rays.directions, plane, u, v, sigma_u, sigma_v, w, step, log, *out, start, stop
        ),
        u.shape,
    )
    return out


@njit(cache=True, nogil=True, inline="always")
def _along_cols(a, k, r, c):  # type: ignore[no-untyped-def]
    return (8.0 * (a[k, r, c + 1] - a[k, r, c - 1]) - (a[k, r, c + 2] - a[k, r, c - 2])) / 12.0


@njit(cache=True, nogil=True, inline="always")
def _along_rows(a, k, r, c):  # type: ignore[no-untyped-def]
    return (8.0 * (a[k, r + 1, c] - a[k, r - 1, c]) - (a[k, r + 2, c] - a[k, r - 2, c])) / 12.0


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc"}, pipeline_class=Apart)
def _fine_slopes(o, d, plane, u, v, w, p, q, p_w, q_w, start, stop):  # type: ignore[no-untyped-def]
    """_slopes of every pixel and w = t, as vector instructions."""
    for i in range(start, stop):
        r = PAD + i
        for j in range(u.shape[1]):
            c = PAD + j
            t = w[i, j]
            dx, dy, dz = d[0, r, c], d[1, r, c], d[2, r, c]
            ex = plane[0, 0] + u[i, j] * plane[1, 0] + v[i, j] * plane[2, 0] - o[0, r, c] - t * dx
            ey = plane[0, 1] + u[i, j] * plane[1, 1] + v[i, j] * plane[2, 1] - o[1, r, c] - t * dy
            ez = plane[0, 2] + u[i, j] * plane[1, 2] + v[i, j] * plane[2, 2] - o[2, r, c] - t * dz
            inverse = 1.0 / math.sqrt(ex * ex + ey * ey + ez * ez)
            ex, ey, ez = ex * inverse, ey * inverse, ez * inverse
            de = dx * ex + dy * ey + dz * ez
            nx, ny, nz = ex - dx, ey - dy, ez - dz
            scale = -1.0 / (nx * dx + ny * dy + nz * dz)
            mx, my, mz = -(dx - de * ex) * inverse, -(dy - de * ey) * inverse, -(dz - de * ez) * inverse

            gx, gy, gz = _along_cols(d, 0, r, c), _along_cols(d, 1, r, c), _along_cols(d, 2, r, c)
            ax = _along_cols(o, 0, r, c) + t * gx
            ay = _along_cols(o, 1, r, c) + t * gy
            az = _along_cols(o, 2, r, c) + t * gz
            slope = scale * (nx * ax + ny * ay + nz * az)
            change = scale * (
                mx * (ax + slope * dx)
                + my * (ay + slope * dy)
                + mz * (az + slope * dz)
                + (nx * gx + ny * gy + nz * gz)
            )
            p[i, j] = slope
            p_w[i, j] = change

            gx, gy, gz = _along_rows(d, 0, r, c), _along_rows(d, 1, r, c), _along_rows(d, 2, r, c)
            ax = _along_rows(o, 0, r, c) + t * gx
            ay = _along_rows(o, 1, r, c) + t * gy
            az = _along_rows(o, 2, r, c) + t * gz
            slope = scale * (nx * ax + ny * ay + nz * az)
            change = scale * (
                mx * (ax + slope * dx)
                + my * (ay + slope * dy)
                + mz * (az + slope * dz)
                + (nx * gx + ny * gy + nz * gz)
            )
            q[i, j] = slope
            q_w[i, j] = change


@njit(cache=True, nogil=True, error_model="numpy")
def _slopes(o, d, plane, u, v, w, step, log, p, q, p_w, q_w, start, stop):  # type: ignore[no-untyped-def]
    for i in range(start, stop):
        r = PAD + step * i
        for j in range(u.shape[1]):
            c = PAD + step * j
            t = math.exp(w[i, j]) if log else w[i, j]
            dx, dy, dz = d[0, r, c], d[1, r, c], d[2, r, c]
            ex = plane[0, 0] + u[i, j] * plane[1, 0] + v[i, j] * plane[2, 0] - o[0, r, c] - t * dx
            ey = plane[0, 1] + u[i, j] * plane[1, 1] + v[i, j] * plane[2, 1] - o[1, r, c] - t * dy
            ez = plane[0, 2] + u[i, j] * plane[1, 2] + v[i, j] * plane[2, 2] - o[2, r, c] - t * dz
            inverse = 1.0 / math.sqrt(ex * ex + ey * ey + ez * ez)
            ex, ey, ez = ex * inverse, ey * inverse, ez * inverse
            de = dx * ex + dy * ey + dz * ez
            nx, ny, nz = ex - dx, ey - dy, ez - dz
            scale = -step / (nx * dx + ny * dy + nz * dz)
            mx, my, mz = -(dx - de * ex) * inverse, -(dy - de * ey) * inverse, -(dz - de * ez) * inverse

            gx, gy, gz = _along_cols(d, 0, r, c), _along_cols(d, 1, r, c), _along_cols(d, 2, r, c)
            ax = _along_cols(o, 0, r, c) + t * gx
            ay = _along_cols(o, 1, r, c) + t * gy
            az = _along_cols(o, 2, r, c) + t * gz
            slope = scale * (nx * ax + ny * ay + nz * az)
            s = slope / step
            change = scale * (
                mx * (ax + s * dx) + my * (ay + s * dy) + mz * (az + s * dz) + (nx * gx + ny * gy + nz * gz)
            )
            p[i, j] = slope / t if log else slope
            p_w[i, j] = change - slope / t if log else change

            gx, gy, gz = _along_rows(d, 0, r, c), _along_rows(d, 1, r, c), _along_rows(d, 2, r, c)
            ax = _along_rows(o, 0, r, c) + t * gx
            ay = _along_rows(o, 1, r, c) + t * gy
            az = _along_rows(o, 2, r, c) + t * gz
            slope = scale * (nx * ax + ny * ay + nz * az)
            s = slope / step
            change = scale * (
                mx * (ax + s * dx) + my * (ay + s * dy) + mz * (az + s * dz) + (nx * gx + ny * gy + nz * gz)
            )
            q[i, j] = slope / t if log else slope
            q_w[i, j] = change - slope / t if log else change


@njit(cache=True, nogil=True, error_model="numpy")
def _variances(o, d, plane, u, v, sigma_u, sigma_v, w, step, log, var_p, var_q, start, stop):  # type: ignore[no-untyped-def]
    for i in range(start, stop):
        r = PAD + step * i
        for j in range(u.shape[1]):
            c = PAD + step * j
            t = math.exp(w[i, j]) if log else w[i, j]
            dx, dy, dz = d[0, r, c], d[1, r, c], d[2, r, c]
            ex = plane[0, 0] + u[i, j] * plane[1, 0] + v[i, j] * plane[2, 0] - o[0, r, c] - t * dx
            ey = plane[0, 1] + u[i, j] * plane[1, 1] + v[i, j] * plane[2, 1] - o[1, r, c] - t * dy
            ez = plane[0, 2] + u[i, j] * plane[1, 2] + v[i, j] * plane[2, 2] - o[2, r, c] - t * dz
            inverse = 1.0 / math.sqrt(ex * ex + ey * ey + ez * ez)
            ex, ey, ez = ex * inverse, ey * inverse, ez * inverse
            nx, ny, nz = ex - dx, ey - dy, ez - dz
            scale = 1.0 / (nx * dx + ny * dy + nz * dz)
            unit = 1.0 / t if log else 1.0
            ue = plane[1, 0] * ex + plane[1, 1] * ey + plane[1, 2] * ez
            ve = plane[2, 0] * ex + plane[2, 1] * ey + plane[2, 2] * ez
            factor = step * scale * inverse * unit
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
                    var_p[i, j] = by_u * by_u + by_v * by_v
                else:
                    var_q[i, j] = by_u * by_u + by_v * by_v
