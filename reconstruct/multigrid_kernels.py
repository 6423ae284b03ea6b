"""What multigrid does to rows of pixels.

Weights of edges to the right, down, down right (falling) and down left (rising); the last two (1, 1) on the
finest level. Shares of the left (across), upper (along) and corner neighbours in what is interpolated.
"""

import numpy as np

from optolever.kernels import exact, inlined

__all__ = [
    "galerkin",
    "interpolate",
    "interpolation",
    "invert",
    "residual",
    "restrict",
    "sweep",
]


@inlined
def _around(right, down, falling, rising, i, j):  # type: ignore[no-untyped-def]
    """Weights to the eight neighbours: up left, up, up right, left, right, down left, down, down right."""
    rows, cols = right.shape
    nine = falling.shape[0] > 1
    up, low, west, east = i > 0, i + 1 < rows, j > 0, j + 1 < cols
    nw = falling[i - 1, j - 1] if nine and up and west else 0.0
    n = down[i - 1, j] if up else 0.0
    ne = rising[i - 1, j + 1] if nine and up and east else 0.0
    w = right[i, j - 1] if west else 0.0
    e = right[i, j] if east else 0.0
    sw = rising[i, j] if nine and low and west else 0.0
    s = down[i, j] if low else 0.0
    se = falling[i, j] if nine and low and east else 0.0
    return nw, n, ne, w, e, sw, s, se


@exact
def invert(right, down, falling, rising, inverse, start, stop):  # type: ignore[no-untyped-def]
    for i in range(start, stop):
        for j in range(right.shape[1]):
            nw, n, ne, w, e, sw, s, se = _around(right, down, falling, rising, i, j)
            total = nw + n + ne + w + e + sw + s + se
            inverse[i, j] = 1.0 / total if total > 0.0 else 0.0


@inlined
def _part(one, other):  # type: ignore[no-untyped-def]
    """one / (one + other) within 0 and 1."""
    total = one + other
    if total <= 0.0:
        return 1.0
    return min(1.0, max(0.0, one / total))


@exact
def interpolation(right, down, falling, rising, across, along, corners, start, stop):  # type: ignore[no-untyped-def]
    rows, cols = right.shape
    for r in range(start, stop):
        i = 2 * r
        for c in range(across.shape[1]):
            j = 2 * c
            if j + 1 < cols:
                nw, n, ne, w, e, sw, s, se = _around(right, down, falling, rising, i, j + 1)
                across[r, c] = _part(nw + w + sw, ne + e + se)
            if i + 1 < rows:
                nw, n, ne, w, e, sw, s, se = _around(right, down, falling, rising, i + 1, j)
                along[r, c] = _part(nw + n + ne, sw + s + se)
            if i + 1 < rows and j + 1 < cols:
                nw, n, ne, w, e, sw, s, se = _around(right, down, falling, rising, i + 1, j + 1)
                total = nw + n + ne + w + e + sw + s + se
                if total <= 0.0:
                    corners[r, c, 0] = 1.0
                    continue
                share = 1.0 / total
                left = along[r, c]
                top = across[r, c]
                low, far = 1.0, 1.0
                if i + 2 < rows:
                    a, b, d, f, g, h, k, m = _around(right, down, falling, rising, i + 2, j + 1)
                    low = _part(a + f + h, d + g + m)
                if j + 2 < cols:
                    a, b, d, f, g, h, k, m = _around(right, down, falling, rising, i + 1, j + 2)
                    far = _part(a + b + d, h + k + m)
                corners[r, c, 0] = share * (nw + n * top + w * left)
                corners[r, c, 1] = share * (ne + n * (1.0 - top) + e * far)
                corners[r, c, 2] = share * (sw + s * low + w * (1.0 - left))
                corners[r, c, 3] = share * (se + s * (1.0 - low) + e * (1.0 - far))


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
def galerkin(  # type: ignore[no-untyped-def]
    right,
    down,
    falling,
    rising,
    across,
    along,
    corners,
    out_right,
    out_below,
    out_down,
    out_fall,
    out_rise,
    start,
    stop,
):
    """Coarse couplings, cell by cell: a cell owns the fine edges that begin in its first two rows and
    columns, all of which end within its four corners' reach. out_below: of the cell's lower side.
    """
    rows, cols = right.shape
    nine = falling.shape[0] > 1
    p = np.zeros((3, 3, 4))
    sums = np.zeros(6)
    p[0, 0, 0] = p[0, 2, 1] = p[2, 0, 2] = p[2, 2, 3] = 1.0
    for r in range(start, stop):
        i = 2 * r
        for c in range(across.shape[1]):
            j = 2 * c
            p[0, 1, 0], p[0, 1, 1] = across[r, c], 1.0 - across[r, c]
            p[1, 0, 0], p[1, 0, 2] = along[r, c], 1.0 - along[r, c]
            p[1, 1] = corners[r, c]
            if c + 1 < across.shape[1]:
                p[1, 2, 1], p[1, 2, 3] = along[r, c + 1], 1.0 - along[r, c + 1]
            if r + 1 < across.shape[0]:
                p[2, 1, 2], p[2, 1, 3] = across[r + 1, c], 1.0 - across[r + 1, c]
            sums[:] = 0.0
            for a in range(2):
                if i + a >= rows:
                    break
                low = i + a + 1 < rows
                for b in range(2):
                    if j + b >= cols:
                        break
                    east = j + b + 1 < cols
                    if east:
                        _pairs(right[i + a, j + b], p[a, b], p[a, b + 1], sums)
                    if low:
                        _pairs(down[i + a, j + b], p[a, b], p[a + 1, b], sums)
                    if nine and low and east:
                        _pairs(falling[i + a, j + b], p[a, b], p[a + 1, b + 1], sums)
                        _pairs(rising[i + a, j + b + 1], p[a, b + 1], p[a + 1, b], sums)
            out_right[r, c] = sums[0]
            out_down[r, c] += sums[1]
            out_fall[r, c] = sums[2]
            if c + 1 < across.shape[1]:
                out_rise[r, c + 1] = sums[3]
                out_down[r, c + 1] += sums[4]
            out_below[r, c] = sums[5]


@exact
def sweep(right, down, falling, rising, inverse, x, rhs, parity, forward, start, stop):  # type: ignore[no-untyped-def]
    rows, cols = right.shape
    nine = falling.shape[0] > 1
    for r in range(start, stop):
        i = 2 * r + parity
        for k in range(cols):
            j = k if forward else cols - 1 - k
            total = rhs[i, j]
            if i > 0:
                total += down[i - 1, j] * x[i - 1, j]
                if nine and j > 0:
                    total += falling[i - 1, j - 1] * x[i - 1, j - 1]
                if nine and j + 1 < cols:
                    total += rising[i - 1, j + 1] * x[i - 1, j + 1]
            if i + 1 < rows:
                total += down[i, j] * x[i + 1, j]
                if nine and j > 0:
                    total += rising[i, j] * x[i + 1, j - 1]
                if nine and j + 1 < cols:
                    total += falling[i, j] * x[i + 1, j + 1]
            if j > 0:
                total += right[i, j - 1] * x[i, j - 1]
            if j + 1 < cols:
                total += right[i, j] * x[i, j + 1]
            x[i, j] = total * inverse[i, j]


@exact
def residual(right, down, falling, rising, x, rhs, out, start, stop):  # type: ignore[no-untyped-def]
    rows, cols = right.shape
    nine = falling.shape[0] > 1
    for i in range(start, stop):
        for j in range(cols):
            here = x[i, j]
            total = rhs[i, j]
            if j > 0:
                total += right[i, j - 1] * (x[i, j - 1] - here)
            if j + 1 < cols:
                total += right[i, j] * (x[i, j + 1] - here)
            if i > 0:
                total += down[i - 1, j] * (x[i - 1, j] - here)
                if nine:
                    if j > 0:
                        total += falling[i - 1, j - 1] * (x[i - 1, j - 1] - here)
                    if j + 1 < cols:
                        total += rising[i - 1, j + 1] * (x[i - 1, j + 1] - here)
            if i + 1 < rows:
                total += down[i, j] * (x[i + 1, j] - here)
                if nine:
                    if j > 0:
                        total += rising[i, j] * (x[i + 1, j - 1] - here)
                    if j + 1 < cols:
                        total += falling[i, j] * (x[i + 1, j + 1] - here)
            out[i, j] = total


@exact
def restrict(fine, across, along, corners, out, start, stop):  # type: ignore[no-untyped-def]
    rows, cols = fine.shape
    for r in range(start, stop):
        i = 2 * r
        for c in range(out.shape[1]):
            j = 2 * c
            low, east = i + 1 < rows, j + 1 < cols
            total = fine[i, j]
            if east:
                total += across[r, c] * fine[i, j + 1]
            if j > 0:
                total += (1.0 - across[r, c - 1]) * fine[i, j - 1]
            if low:
                total += along[r, c] * fine[i + 1, j]
                if east:
                    total += corners[r, c, 0] * fine[i + 1, j + 1]
                if j > 0:
                    total += corners[r, c - 1, 1] * fine[i + 1, j - 1]
            if i > 0:
                total += (1.0 - along[r - 1, c]) * fine[i - 1, j]
                if east:
                    total += corners[r - 1, c, 2] * fine[i - 1, j + 1]
                if j > 0:
                    total += corners[r - 1, c - 1, 3] * fine[i - 1, j - 1]
            out[r, c] = total


@exact
def interpolate(below, across, along, corners, x, start, stop):  # type: ignore[no-untyped-def]
    rows, cols = x.shape
    small_rows, small_cols = below.shape
    for r in range(start, stop):
        i = 2 * r
        under = min(r + 1, small_rows - 1)
        for c in range(small_cols):
            j = 2 * c
            after = min(c + 1, small_cols - 1)
            here = below[r, c]
            x[i, j] += here
            if j + 1 < cols:
                x[i, j + 1] += across[r, c] * here + (1.0 - across[r, c]) * below[r, after]
            if i + 1 < rows:
                x[i + 1, j] += along[r, c] * here + (1.0 - along[r, c]) * below[under, c]
                if j + 1 < cols:
                    x[i + 1, j + 1] += (
                        corners[r, c, 0] * here
                        + corners[r, c, 1] * below[r, after]
                        + corners[r, c, 2] * below[under, c]
                        + corners[r, c, 3] * below[under, after]
                    )
