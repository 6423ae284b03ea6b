"""Places of pixels beside unlit ones, behind a lens: by the clean pixels around.

A lens mixes light over half a pixel and three of its rms blurs. Beside the end of the light the place is that
of the lit part of it, off by half a step and always inwards, which a height adds up along the whole rim. So
it is the quadratic's through the clean pixels of 11 x 11, where this is no worse than a few pixels and
leaves noise of them: at a crease, which dims light as well, it leaves whole pixels.
"""

import cv2
import numpy as np

from optolever.kernels import F32, F64, I64, exact

from .neighbours import Mask, Result

__all__ = ["beyond_rims"]

#: Pixels around that a quadratic takes, on either side; share of the light around below which a pixel is
#: unlit; largest variance, over that of one pixel, and of the residual, over noise; how many pixels of a
#: rim share an error.
_AROUND, _UNLIT, _MOST, _LEFT, _ALIKE = 5, 0.3, 4.0, 4.0, 9.0


def beyond_rims(result: Result, amplitude: F32, reach: float) -> None:
    """In place: coordinate and sigma of good pixels within a reach, px, of unlit ones; amplitude (H, W)."""
    flagged, side = result.flags != 0, int(reach)
    if not side or not flagged.any():
        return
    brightest = cv2.dilate(amplitude, np.ones((5, 5), np.uint8))
    unlit = (flagged & (amplitude < _UNLIT * brightest)).astype(np.uint8)
    down, along = np.mgrid[-side : side + 1, -side : side + 1]
    rim = (cv2.dilate(unlit, (down**2 + along**2 <= reach**2).astype(np.uint8)) > 0) & ~flagged
    at = np.argwhere(rim)
    square, product, noise, power = _moments(result.coordinate, result.sigma, ~flagged & ~rim, at)
    inverse = np.linalg.inv(square + 1e-9 * np.eye(6))
    terms = np.einsum("kij,akj->aki", inverse, product)
    left = (power - np.einsum("aki,aki->ak", terms, product)) / np.maximum(square[:, 0, 0] - 6, 1.0)
    kept = (inverse[:, 0, 0] < _MOST) & (left < _LEFT * noise).all(axis=0)
    to = slice(None), *at[kept].T
    result.coordinate[to] += terms[:, kept, 0]
    result.sigma[to] = np.sqrt(_ALIKE * inverse[:, 0, 0] * noise)[:, kept]


@exact
def _moments(place: F32, sigma: F32, clean: Mask, at: I64) -> tuple[F64, F64, F64, F64]:
    """Normal matrices (K, 6, 6) of the quadratics around pixels (K, 2), products (A, K, 6) with the places
    (A, H, W) less the pixel's, the mean variances (A, K), and the places' squares (A, K)."""
    (axes, rows, cols), count = place.shape, len(at)
    square, product = np.zeros((count, 6, 6)), np.zeros((axes, count, 6))
    noise, power = np.zeros((axes, count)), np.zeros((axes, count))
    one = np.ones(6)
    for k in range(count):
        y, x = at[k]
        for i in range(max(y - _AROUND, 0), min(y + _AROUND + 1, rows)):
            for j in range(max(x - _AROUND, 0), min(x + _AROUND + 1, cols)):
                if clean[i, j]:
                    one[1], one[2] = (i - y) / _AROUND, (j - x) / _AROUND
                    one[3], one[4], one[5] = one[1] * one[1], one[1] * one[2], one[2] * one[2]
                    for m in range(6):
                        for n in range(6):
                            square[k, m, n] += one[m] * one[n]
                        for a in range(axes):
                            product[a, k, m] += one[m] * (place[a, i, j] - place[a, y, x])
                    for a in range(axes):
                        noise[a, k] += sigma[a, i, j] ** 2
                        power[a, k] += (place[a, i, j] - place[a, y, x]) ** 2
        for a in range(axes):
            noise[a, k] /= max(square[k, 0, 0], 1.0)
    return square, product, noise, power
