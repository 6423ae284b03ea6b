"""What multigrid does to rows of pixels.

w (4, rows + 2, cols + 2): weights of edges to the right, down, down right and down left; x and residuals have
the same border, of zeros. Shares of the left (across), upper (along) and corner neighbours in what is
interpolated.
"""

import numpy as np

from optolever.kernels import exact, inlined

__all__ = ["galerkin", "interpolate", "residual", "restrict", "sweep"]


@exact
def sweep(w, inverse, x, rhs, parity, forward, start, stop):  # type: ignore[no-untyped-def]
    cols = rhs.shape[1]
    for r in range(start, stop):
        i = 2 * r + parity + 1
        for k in range(cols):
            j = k + 1 if forward else cols - k
            around = w[0, i, j - 1] * x[i, j - 1] + w[0, i, j] * x[i, j + 1]
            around += w[1, i - 1, j] * x[i - 1, j] + w[1, i, j] * x[i + 1, j]
            around += w[2, i - 1, j - 1] * x[i - 1, j - 1] + w[2, i, j] * x[i + 1, j + 1]
            around += w[3, i - 1, j + 1] * x[i - 1, j + 1] + w[3, i, j] * x[i + 1, j - 1]
            x[i, j] = (rhs[i - 1, j - 1] + around) * inverse[i - 1, j - 1]


@exact
def residual(w, x, rhs, out, start, stop):  # type: ignore[no-untyped-def]
    for i in range(start + 1, stop + 1):
        for j in range(1, rhs.shape[1] + 1):
            here = x[i, j]
            flow = w[0, i, j - 1] * (x[i, j - 1] - here) + w[0, i, j] * (x[i, j + 1] - here)
            flow += w[1, i - 1, j] * (x[i - 1, j] - here) + w[1, i, j] * (x[i + 1, j] - here)
            flow += w[2, i - 1, j - 1] * (x[i - 1, j - 1] - here) + w[2, i, j] * (x[i + 1, j + 1] - here)
            flow += w[3, i - 1, j + 1] * (x[i - 1, j + 1] - here) + w[3, i, j] * (x[i + 1, j - 1] - here)
            out[i, j] = rhs[i - 1, j - 1] + flow


@exact
def restrict(fine, across, along, corners, out, start, stop):  # type: ignore[no-untyped-def]
    for r in range(start, stop):
        i = 2 * r + 1
        for c in range(across.shape[1]):
            j = 2 * c + 1
            total = fine[i, j] + across[r, c] * fine[i, j + 1] + (1.0 - across[r, c - 1]) * fine[i, j - 1]
            total += along[r, c] * fine[i + 1, j] + (1.0 - along[r - 1, c]) * fine[i - 1, j]
            total += corners[r, c, 0] * fine[i + 1, j + 1] + corners[r, c - 1, 1] * fine[i + 1, j - 1]
            total += corners[r - 1, c, 2] * fine[i - 1, j + 1] + corners[r - 1, c - 1, 3] * fine[i - 1, j - 1]
            out[r, c] = total


@exact
def interpolate(below, across, along, corners, x, start, stop):  # type: ignore[no-untyped-def]
    for r in range(start, stop):
        i = 2 * r + 1
        for c in range(across.shape[1]):
            j = 2 * c + 1
            here, after = below[r + 1, c + 1], below[r + 1, c + 2]
            under, beyond = below[r + 2, c + 1], below[r + 2, c + 2]
            x[i, j] += here
            x[i, j + 1] += across[r, c] * here + (1.0 - across[r, c]) * after
            x[i + 1, j] += along[r, c] * here + (1.0 - along[r, c]) * under
            x[i + 1, j + 1] += corners[r, c, 0] * here + corners[r, c, 1] * after
            x[i + 1, j + 1] += corners[r, c, 2] * under + corners[r, c, 3] * beyond


@inlined
def _pairs(w, a, b, out):  # type: ignore[no-untyped-def]
    """Energy w (a - b)^2 of interpolated values as couplings of the four corners: top, left, falling, rising,
    right, bottom.
    """
    d0, d1, d2, d3 = a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3]
    out[0] -= w * d0 * d1
    out[1] -= w * d0 * d2
    out[2] -= w * d0 * d3
    out[3] -= w * d1 * d2
    out[4] -= w * d1 * d3
    out[5] -= w * d2 * d3


@exact
def galerkin(w, across, along, corners, coarse, below, start, stop):  # type: ignore[no-untyped-def]
    """Coarse couplings, cell by cell: a cell owns the fine edges that begin in its first two rows and
    columns, all of which end within its four corners' reach. below: of the cell's lower side.
    """
    rows, cols = across.shape
    p = np.zeros((3, 3, 4))
    sums = np.zeros(6)
    p[0, 0, 0] = p[0, 2, 1] = p[2, 0, 2] = p[2, 2, 3] = 1.0
    for r in range(start, stop):
        for c in range(cols):
            low, far = across[min(r + 1, rows - 1), c], along[r, min(c + 1, cols - 1)]
            p[0, 1, 0], p[0, 1, 1] = across[r, c], 1.0 - across[r, c]
            p[1, 0, 0], p[1, 0, 2] = along[r, c], 1.0 - along[r, c]
            p[1, 1] = corners[r, c]
            p[1, 2, 1], p[1, 2, 3] = far, 1.0 - far
            p[2, 1, 2], p[2, 1, 3] = low, 1.0 - low
            sums[:] = 0.0
            for a in range(2):
                for b in range(2):
                    i, j = 2 * r + a + 1, 2 * c + b + 1
                    _pairs(w[0, i, j], p[a, b], p[a, b + 1], sums)
                    _pairs(w[1, i, j], p[a, b], p[a + 1, b], sums)
                    _pairs(w[2, i, j], p[a, b], p[a + 1, b + 1], sums)
                    _pairs(w[3, i, j + 1], p[a, b + 1], p[a + 1, b], sums)
            i, j = r + 1, c + 1
            coarse[0, i, j] = sums[0]
            coarse[1, i, j] += sums[1]
            coarse[2, i, j] = sums[2]
            coarse[3, i, j + 1] = sums[3]
            coarse[1, i, j + 1] += sums[4]
            below[r, c] = sums[5]
