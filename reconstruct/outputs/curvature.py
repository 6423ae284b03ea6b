"""Curvature from measured slopes: in a window around every pixel both are fitted by planes of one Hessian.

slope_x = a + h_xx dx + h_xy dy, slope_y = b + h_xy dx + h_yy dy, weights 1/sigma^2: three unknowns once each
slope's weighted mean is taken off; the inverse of their normal matrix, times chi2 per degree of freedom where
that is no chance (the curvature changes within the window), is their covariance.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from optolever.arrays import Floats
from optolever.blocks import over_rows
from optolever.errors import InputError
from optolever.files import save_arrays
from optolever.kernels import exact
from optolever.records import Comparable
from optolever.schema import load_record

from .slope_map import SlopeMap

__all__ = ["CurvatureMap", "curvature_map"]

_ARRAYS = ("xx", "xy", "yy", "sigma_xx", "sigma_xy", "sigma_yy", "mean", "sigma_mean")
_CHANCE = 3.0  # standard deviations of chi2


@dataclass(frozen=True, slots=True, eq=False)
class CurvatureMap(Comparable):
    """Second derivatives of z and the mean curvature, 1/mm, with their sigmas, (H, W) each.

    mean: half the sum of the principal curvatures, negative at the bottom of a dent (z > 0 into the medium);
    NaN where the window has not enough good pixels.
    """

    xx: Annotated[Floats, "H W"]
    xy: Annotated[Floats, "H W"]
    yy: Annotated[Floats, "H W"]
    sigma_xx: Annotated[Floats, "H W"]
    sigma_xy: Annotated[Floats, "H W"]
    sigma_yy: Annotated[Floats, "H W"]
    mean: Annotated[Floats, "H W"]
    sigma_mean: Annotated[Floats, "H W"]

    def save(self, path: str | Path) -> None:
        """Write an .npz with the fields' names."""
        save_arrays(path, {name: getattr(self, name) for name in _ARRAYS})

    @classmethod
    def load(cls, path: str | Path) -> "CurvatureMap":
        """Read what save() wrote; InputError names the file and the field."""
        return load_record(cls, path)


def curvature_map(slopes: SlopeMap, reach: int = 2) -> CurvatureMap:
    """Curvature over windows of (2 reach + 1)^2 pixels. InputError unless reach is at least 1."""
    if reach < 1:
        raise InputError(f"reach = {reach}: must be at least 1 pixel")
    out = np.full((len(_ARRAYS), *slopes.x.shape), np.nan)
    good = slopes.good & np.isfinite(slopes.slope_x) & (slopes.sigma_x > 0) & (slopes.sigma_y > 0)
    over_rows(
        lambda start, stop: _fit(
            slopes.x, slopes.y, slopes.slope_x, slopes.slope_y, slopes.sigma_x, slopes.sigma_y, good, reach,
            out, start, stop,
        ),
        slopes.x.shape[0],
    )  # fmt: skip
    return CurvatureMap(*out)


@exact
def _fit(x, y, p, q, sigma_p, sigma_q, good, reach, out, start, stop):  # type: ignore[no-untyped-def]
    rows, cols = x.shape
    for i in range(start, stop):
        for j in range(cols):
            if not good[i, j]:
                continue
            # Weighted sums of 1, dx, dy, s, dx dx, dx dy, dy dy, dx s, dy s, s s for either slope.
            sums, count = np.zeros((2, 10)), 0
            for r in range(max(i - reach, 0), min(i + reach + 1, rows)):
                for c in range(max(j - reach, 0), min(j + reach + 1, cols)):
                    if not good[r, c]:
                        continue
                    dx, dy = x[r, c] - x[i, j], y[r, c] - y[i, j]
                    count += 1
                    for k in range(2):
                        s = p[r, c] - p[i, j] if k == 0 else q[r, c] - q[i, j]
                        sigma = sigma_p[r, c] if k == 0 else sigma_q[r, c]
                        w = 1.0 / (sigma * sigma)
                        row = sums[k]
                        row[0] += w
                        row[1] += w * dx
                        row[2] += w * dy
                        row[3] += w * s
                        row[4] += w * dx * dx
                        row[5] += w * dx * dy
                        row[6] += w * dy * dy
                        row[7] += w * dx * s
                        row[8] += w * dy * s
                        row[9] += w * s * s
            for k in range(2):
                row = sums[k]
                row[4] -= row[1] * row[1] / row[0]
                row[5] -= row[1] * row[2] / row[0]
                row[6] -= row[2] * row[2] / row[0]
                row[7] -= row[1] * row[3] / row[0]
                row[8] -= row[2] * row[3] / row[0]
                row[9] -= row[3] * row[3] / row[0]
            # Normal matrix [[a, b, 0], [b, c, d], [0, d, e]] of h_xx, h_xy, h_yy.
            a, b, d, e = sums[0, 4], sums[0, 5], sums[1, 5], sums[1, 6]
            c = sums[0, 6] + sums[1, 4]
            f, g, h = sums[0, 7], sums[0, 8] + sums[1, 7], sums[1, 8]
            det = a * (c * e - d * d) - b * b * e
            if not det > 1e-9 * a * c * e:
                continue
            v_aa, v_ab, v_ac = (c * e - d * d) / det, -b * e / det, b * d / det
            v_bb, v_bc, v_cc = a * e / det, -a * d / det, (a * c - b * b) / det
            xx = v_aa * f + v_ab * g + v_ac * h
            xy = v_ab * f + v_bb * g + v_bc * h
            yy = v_ac * f + v_bc * g + v_cc * h
            # two slopes of each pixel, less two means and three unknowns
            freedom = max(2 * count - 5, 1)
            chi2 = (sums[0, 9] + sums[1, 9] - xx * f - xy * g - yy * h) / freedom
            wide = np.sqrt(chi2) if chi2 > 1.0 + _CHANCE * np.sqrt(2.0 / freedom) else 1.0
            px, py = p[i, j], q[i, j]
            scale = 0.5 / (1.0 + px * px + py * py) ** 1.5
            wa, wb, wc = scale * (1.0 + py * py), -2.0 * scale * px * py, scale * (1.0 + px * px)
            out[0, i, j], out[1, i, j], out[2, i, j] = xx, xy, yy
            for k, v in enumerate((v_aa, v_bb, v_cc)):
                out[3 + k, i, j] = wide * np.sqrt(v)
            out[6, i, j] = wa * xx + wb * xy + wc * yy
            out[7, i, j] = wide * np.sqrt(
                wa * wa * v_aa + wb * wb * v_bb + wc * wc * v_cc
                + 2.0 * (wa * wb * v_ab + wa * wc * v_ac + wb * wc * v_bc)
            )  # fmt: skip
