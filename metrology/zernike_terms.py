"""Zernike polynomials over a circle, their indices and names.

Z_n^m = N R_n^|m|(rho) (cos m theta for m >= 0, sin |m| theta for m < 0), N = sqrt((2 - [m = 0]) (n + 1)), so
that each has an rms of 1 over the full circle; R by Jacobi polynomials (Born and Wolf, Principles of Optics,
9.2.1). With N = 1 (amplitude) each is 1 at the edge, theta = 0 or 90 degrees / m. ANSI order: ISO 14999-2,
ANSI Z80.28, from 0; fringe order: University of Arizona's, from 1.
"""

import numpy as np
from scipy.special import eval_jacobi

from optolever.arrays import Floats
from optolever.errors import InputError

__all__ = ["FRINGE", "ansi_index", "fringe_index", "norm", "zernike", "zernike_name"]

_ORDERS = "Primary", "Secondary", "Tertiary", "Quaternary", "Quinary"
_SHAPES = {1: "Coma", 2: "Astigmatism", 3: "Trefoil", 4: "Quadrafoil", 5: "Pentafoil", 6: "Hexafoil"}


def zernike(n: int, m: int, rho: Floats, theta: Floats) -> Floats:
    """Z_n^m at rho (1 at the aperture's edge) and theta (from x to y). InputError for invalid n, m."""
    if n < 0 or abs(m) > n or (n - m) % 2:
        raise InputError(f"zernike: n = {n}, m = {m}, must be n >= |m| with n - m even")
    order, half = abs(m), (n - abs(m)) // 2
    radial = (-1) ** half * rho**order * eval_jacobi(half, order, 0, 1 - 2 * rho**2)
    turn = np.cos(order * theta) if m >= 0 else np.sin(order * theta)
    return np.asarray(norm(n, m) * radial * turn)


def norm(n: int, m: int) -> float:
    """Amplitude of Z_n^m of rms 1 over the full circle."""
    return float(np.sqrt((1 if m == 0 else 2) * (n + 1)))


def ansi_index(n: int, m: int) -> int:
    """Place in ANSI order, from 0."""
    return (n * (n + 2) + m) // 2


def fringe_index(n: int, m: int) -> int:
    """Place in fringe order, from 1.

    >>> fringe_index(4, 0), fringe_index(3, -1)
    (9, 8)
    """
    half = (n + abs(m)) // 2
    return (1 + half) ** 2 - 2 * abs(m) + (m < 0)


#: (n, m) of the first 36 fringe terms, in order.
FRINGE = sorted(
    ((n, m) for n in range(11) for m in range(-n, n + 1, 2) if fringe_index(n, m) <= 36),
    key=lambda pair: fringe_index(*pair),
)


def zernike_name(n: int, m: int) -> str:
    """Name of the term, as prysm has it: Primary Coma X.

    >>> zernike_name(2, -2), zernike_name(6, 0)
    ('Primary Astigmatism 45°', 'Secondary Spherical')
    """
    if n < 2:
        return "Piston" if n == 0 else "Tilt X" if m > 0 else "Tilt Y"
    if n == 2 and m == 0:
        return "Defocus"
    order = n // 2 - 1 if m == 0 else (n - abs(m)) // 2 + (abs(m) > 1)
    prefix = _ORDERS[order - 1] if order <= len(_ORDERS) else f"{order}th"
    if m == 0:
        return f"{prefix} Spherical"
    along = ("X" if m > 0 else "Y") if m % 2 else ("00°" if m > 0 else "45°")
    return f"{prefix} {_SHAPES.get(abs(m), f'{abs(m)}-foil')} {along}"
