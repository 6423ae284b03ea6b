"""Row and column noise: what pixels of one row, or column, of a frame share of the noise.

Cameras read by rows and amplify by columns (EMVA 1288 release 4.0, row and column noise), and a lamp that
flickers before a rolling shutter leaves bands. A height adds it up along a whole line, where independent
noise averages out. Constraints of a plan are free of the scene, so that the product of two pixels' residuals
is, on average, what both share. What is shown otherwise than described leaves residuals, too, which lines of
equal place share: an axis tells most where it changes along the line, and the least of both axes stands.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .correspondence import LineNoise
from .noise import Sample, explain, harmonics, product, trimmed_variance, unsaturated
from .plan import AxisPlan, Plan, constraints

__all__ = ["line_noise"]

F32 = NDArray[np.float32]
#: Pixels that are looked at, at most; deviations beyond which a residual is an outlier, and of chance, from
#: which on a share is one.
_MOST, _FAR, _SURE = 4096, 4.0, 3.0


def line_noise(plan: Plan, lit: Sample, turns: tuple[float, ...]) -> LineNoise | None:
    """None where nothing is surely shared, or fringes do not tell. turns: of the finest fringe of each axis
    in a pattern pixel, 0 without one."""
    thin = max(1, lit.levels.shape[1] // _MOST)
    some = lit.only(slice(None, None, thin))
    if len(plan.axes) != 2 or not all(turns) or len(some.places) < 2:
        return None
    rows, cols = np.min([_shares(plan, axis, some) for axis in plan.axes], axis=0).tolist()
    by_axis = dict(zip((axis.axis for axis in plan.axes), turns, strict=True))
    return LineNoise(rows, cols, by_axis["u"], by_axis["v"]) if max(rows, cols) > 0 else None


def _shares(plan: Plan, axis: AxisPlan, sample: Sample) -> tuple[float, float]:
    """Shares of rows and of columns, by the frames of one axis; 0 where these have no constraints."""
    groups = constraints(replace(plan, axes=(axis,), white=-1, black=-1), len(sample.levels))
    if not groups:
        return 0.0, 0.0
    rows = groups[-1].astype(np.float32)
    sample = sample.only(unsaturated(rows, sample.levels, sample.white).all(axis=0))
    residual = product(rows, sample.levels)
    if not residual.size:
        return 0.0, 0.0
    fringes = [(one, harmonics(one, sample.levels)) for one in axis.fringes]
    explain(residual, np.ones(residual.shape, np.bool_), rows != 0, fringes)
    residual[np.square(residual) > _FAR**2 * trimmed_variance(residual.ravel())] = 0.0
    return _shared(residual, sample.places[:, 0]), _shared(residual, sample.places[:, 1])


def _shared(residual: F32, line: NDArray[np.int64]) -> float:
    """Mean product of residuals (M, K) of two pixels of a line (K,), over their mean square; 0 where chance
    leaves as much."""
    count = np.bincount(line).astype(np.float64)
    pairs = float((count * (count - 1)).sum())
    sums = np.stack([np.bincount(line, one) for one in residual])
    square = np.square(residual, dtype=np.float64).sum(axis=1)
    if pairs == 0 or square.sum() == 0:
        return 0.0
    share = float((np.square(sums).sum(axis=1) - square).sum() / pairs / (square.sum() / line.size))
    return share if share > _SURE * np.sqrt(2 / (pairs * len(residual))) else 0.0
