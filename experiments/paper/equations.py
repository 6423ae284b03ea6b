"""The equations of the paper, one pure function each, on arrays of any common shape (mm, radians, float64).

Saga, Kajimoto, Tachi, "High-Resolution Tactile Sensor Using the Movement of a Reflected Image"; numbers are
the paper's. A cut through the prism: l from P0 along the mirror, d into the prism, m = |P0 P| on the pattern
face, w = |R0 R| on the capture face; alpha0, beta0 the faces' angles with the mirror; alpha, beta the angles
of the rays towards the pattern and the camera with the mirror's normal; theta = atan(dd/dl).

The print carries the sign of theta in (9) that no mirror obeys, and its (17) has lost a factor. Here `sign` =
+1 is the reflection law, alpha = beta + 2 theta, and `sign` = -1 the printed one; (17) is re-derived from
(16).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "angle_increment",
    "capture_position",
    "height_increment",
    "mirror_position",
    "pattern_angle",
    "pattern_position",
    "slope_angle",
]

Array = NDArray[np.float64]

_SMALL_ANGLE = 1e-4  # below it the closed form of (5) cancels; three terms of its series are exact to 1e-16


def height_increment(dl: Array | float, theta: Array | float, dtheta: Array | float) -> Array:
    """Rise over dl while the slope angle goes linearly from theta to theta + dtheta.

    (5), (19): dl / dtheta log |cos theta / cos(theta + dtheta)|, and its series about the middle where dtheta
    -> 0.
    """
    step = np.asarray(dtheta, dtype=np.float64)
    small = np.abs(step) < _SMALL_ANGLE
    middle = np.tan(theta + step / 2)
    series = middle * (1 + step**2 / 12 * (1 + middle**2))
    safe = np.where(small, 1.0, step)
    closed = np.log(np.abs(np.cos(theta) / np.cos(theta + safe))) / safe
    return np.asarray(dl * np.where(small, series, closed), dtype=np.float64)


def pattern_angle(beta: Array | float, theta: Array | float, sign: int = 1) -> Array:
    """Alpha, the angle towards the pattern, by the reflection law (sign +1) or by the print (sign -1):
    (9).
    """
    return np.asarray(beta + 2 * sign * np.asarray(theta), dtype=np.float64)


def slope_angle(alpha: Array | float, beta: Array | float, sign: int = 1) -> Array:
    """Theta from the two rays: (9) solved for it."""
    return np.asarray(sign * (np.asarray(alpha) - beta) / 2, dtype=np.float64)


def pattern_position(l: Array | float, d: Array | float, alpha: Array | float, alpha0: float) -> Array:
    """The position m on the pattern face that a ray of angle alpha from (l, d) meets: (12), exact."""
    gamma = np.arctan2(d, l)
    return np.asarray(np.hypot(l, d) * np.cos(alpha - gamma) / np.cos(alpha - alpha0), dtype=np.float64)


def capture_position(
    l: Array | float, d: Array | float, beta: Array | float, beta0: float, length: float
) -> Array:
    """The position w on the capture face that a ray of angle beta from (l, d) meets: (14), exact."""
    rest = length - np.asarray(l)
    gamma = np.arctan2(d, rest)
    return np.asarray(np.hypot(rest, d) * np.cos(beta - gamma) / np.cos(beta - beta0), dtype=np.float64)


def mirror_position(w: Array | float, d: Array | float, beta0: float, length: float) -> Array:
    """The mirror position l at depth d on the ray of w of a camera at infinity (beta = beta0): (14) solved
    for l.
    """
    return np.asarray(length - (w - d * np.sin(beta0)) / np.cos(beta0), dtype=np.float64)


def angle_increment(
    l: Array | float, d: Array | float, m: Array | float, alpha0: float, gamma: bool = True
) -> Array:
    """Alpha - alpha0 from the pattern position m reflected at (l, d): (16) to second order, (17), the root
    nearest 0.

    A x^2 + 2 B x + C = 0 with A = R cos 2a - m^2, B = R sin a cos a, C = m^2 - R cos^2 a, R = l^2 + d^2 and a
    = alpha0, or alpha0 - atan(d / l) where gamma is kept (the paper sets it to 0). The roots are always real:
    as a quadratic in m^2 > 0, B^2 - A C has no positive zero.
    """
    a = alpha0 - np.arctan2(d, l) if gamma else alpha0
    square = np.square(l) + np.square(d)
    quadratic = square * np.cos(2 * a) - np.square(m)
    linear = square * np.sin(a) * np.cos(a)
    constant = np.square(m) - square * np.cos(a) ** 2
    root = np.sqrt(np.maximum(linear**2 - quadratic * constant, 0.0))  # rounding alone makes it negative
    return np.asarray(-constant / (linear + np.copysign(root, linear)), dtype=np.float64)
