"""The dents' closed forms: pure functions of x, y (mm) and numbers; each gives height, dz/dx, dz/dy.

With T(x) = taper(x, length, taper) = s^3 (10 - 15 s + 6 s^2), s = clamp((length - x)/taper, 0, 1): 1 inside,
and zero in value, slope and curvature at x = length. Radius r = hypot(x - x0, y - y0); x0, y0 are the params
named x and y. The keyword names here are the params of `Formula`; GLSL evaluates the same expressions.
"""

from collections.abc import Callable

import numpy as np

from .fields import Float

__all__ = ["FORMS", "ball", "flat", "gaussian", "needle", "raised_cosine", "ridge", "rounded_needle", "tilt"]

Shape = tuple[Float, Float, Float]


def flat(px: Float, py: Float) -> Shape:
    """h = 0."""
    zero = np.zeros(np.broadcast_shapes(np.shape(px), np.shape(py)))
    return zero, zero, zero


def tilt(px: Float, py: Float, *, slope: float, length: float) -> Shape:
    """h = slope (length - x)."""
    zero = 0.0 * (px + py)
    return slope * (length - px) + zero, zero - slope, zero


def raised_cosine(px: Float, py: Float, *, peak: float, kx: float, ky: float) -> Shape:
    """h = peak/4 (1 - cos kx x)(1 - cos ky y), evaluated as peak sin^2(kx x/2) sin^2(ky y/2)."""
    sx, sy = np.sin(0.5 * kx * px), np.sin(0.5 * ky * py)
    a, b = sx * sx, sy * sy
    return (
        peak * a * b,
        peak * kx * sx * np.cos(0.5 * kx * px) * b,
        peak * ky * sy * np.cos(0.5 * ky * py) * a,
    )


def gaussian(
    px: Float, py: Float, *, peak: float, sigma: float, x: float, y: float, length: float, taper: float
) -> Shape:
    """h = peak exp(-r^2 / (2 sigma^2)) T(x)."""
    dx, dy = px - x, py - y
    bell = peak * np.exp((dx * dx + dy * dy) / (-2 * sigma * sigma))
    return _tapered(px, bell, -dx / sigma**2 * bell, -dy / sigma**2 * bell, length, taper)


def ball(
    px: Float, py: Float, *, peak: float, contact: float, x: float, y: float, length: float, taper: float
) -> Shape:
    """Hertz's contact with a ball, q = r/contact: h = peak H(q) T(x).

    H = 1 - q^2/2 for q <= 1, ((2 - q^2) asin(1/q) + sqrt(q^2 - 1))/pi outside; dH/dq = -q inside,
    2 (sqrt(q^2 - 1)/q - q asin(1/q))/pi outside. K. L. Johnson, Contact Mechanics (1985), eq. 3.41a, 3.42a.
    """
    dx, dy = (px - x) / contact, (py - y) / contact
    q2 = dx * dx + dy * dy
    q = np.sqrt(np.maximum(q2, 1.0))
    arc, root = np.arcsin(1 / q), np.sqrt(q * q - 1)
    inside = q2 <= 1
    height = peak * np.where(inside, 1 - 0.5 * q2, ((2 - q * q) * arc + root) / np.pi)
    over_q = peak / contact * np.where(inside, -1.0, 2 * (root / q - q * arc) / (np.pi * q))  # (dh/dr) / q
    return _tapered(px, height, over_q * dx, over_q * dy, length, taper)


def needle(
    px: Float, py: Float, *, peak: float, decay: float, x: float, y: float, length: float, taper: float
) -> Shape:
    """h = peak exp(-r/decay) T(x): a cusp; the slope at its very tip is taken as 0."""
    dx, dy = px - x, py - y
    r = np.hypot(dx, dy)
    spike = peak * np.exp(-r / decay)
    over_r = -spike / decay / np.where(r > 0, r, 1.0)
    return _tapered(px, spike, over_r * dx, over_r * dy, length, taper)


def rounded_needle(
    px: Float,
    py: Float,
    *,
    peak: float,
    decay: float,
    rounding: float,
    x: float,
    y: float,
    length: float,
    taper: float,
) -> Shape:
    """h = peak exp(-(R - rounding)/decay) T(x), R = sqrt(r^2 + rounding^2)."""
    dx, dy = px - x, py - y
    r2 = dx * dx + dy * dy
    root = np.sqrt(r2 + rounding * rounding)
    spike = peak * np.exp(-r2 / (root + rounding) / decay)
    over_r = -spike / decay / root
    return _tapered(px, spike, over_r * dx, over_r * dy, length, taper)


def ridge(
    px: Float,
    py: Float,
    *,
    peak: float,
    sigma: float,
    x: float,
    y: float,
    nx: float,
    ny: float,
    length: float,
    taper: float,
) -> Shape:
    """h = peak exp(-q^2 / (2 sigma^2)) T(x), q = nx (x - x0) + ny (y - y0): a ridge along (-ny, nx)."""
    q = nx * (px - x) + ny * (py - y)
    bell = peak * np.exp(q * q / (-2 * sigma * sigma))
    along = -q / sigma**2 * bell
    return _tapered(px, bell, nx * along, ny * along, length, taper)


def taper_of(px: Float, length: float, taper: float) -> tuple[Float, Float]:
    """T(x) and dT/dx."""
    s = np.clip((length - px) / taper, 0.0, 1.0)
    return s * s * s * (10 + s * (6 * s - 15)), -30 / taper * (s * (1 - s)) ** 2


def _tapered(px: Float, height: Float, slope_x: Float, slope_y: Float, length: float, taper: float) -> Shape:
    value, slope = taper_of(px, length, taper)
    return height * value, slope_x * value + height * slope, slope_y * value


FORMS: dict[str, Callable[..., Shape]] = {
    "flat": flat,
    "tilt": tilt,
    "raised-cosine": raised_cosine,
    "gaussian": gaussian,
    "ball": ball,
    "needle": needle,
    "rounded-needle": rounded_needle,
    "ridge": ridge,
}
