"""Sharp display cells: a place's error by the cells that is common to neighbours.

A pixel of footprint w and blur b (cells) reads a fringe of P cells through the sidebands m = +1, -1,
W(f) = sinc(f) sinc(w f) exp(-2 pi^2 b^2 f^2) at f = m - 1 / P; their sum over W(1 / P), times P / 2 pi, is
the amplitude of the error, whose period is a cell. Neighbours that sample different places of their cells
show it as third differences (see neighbours). Where the sampling is commensurate they do not: that share
counts here, as a variance and as a shift in common. The blur is known, or bounded by the contrast of the
finest fringe against a coarser one, or white less black.
"""

import numpy as np

from optolever.kernels import F32, F64

from ..plan import AxisPlan
from . import Effect, View

__all__ = ["estimate", "variance"]

#: Relative error of a contrast, by a display's response; side of a neighbourhood; fewest and most pixels.
_CONTRAST, _SQUARE, _FEWEST, _MOST = 0.02, 32, 64, 1024
#: Negligible share of sigma; share of the variance of sharp cells that a blur of 0 to 0.9 cells leaves in
#: the mean: the sidebands fall as exp(-2 (pi b)^2), their square to 0.141 / 0.9.
_SLIGHT, _LIKELY = 0.1, 0.16


def estimate(view: View) -> Effect | None:
    """The blur, cells rms, known or at least; None where it costs nothing, or nobody asks for it."""
    settings, sigma = view.settings, 0.0
    blur, steps = settings.blur_px, _steps(view)
    if not settings.on_cells or (settings.noise is not None and blur is None):
        return None
    if blur is None:
        bounds = [_bound(view, axis, step) for axis, step in zip(view.plan.axes, steps, strict=True)]
        blur, sigma = max((one for one in bounds if one is not None), default=0.0), np.nan
    found = Effect("cells", blur, sigma, "cells rms, least blur")
    for more, own in zip(_variances(view, steps, found), view.variance, strict=True):
        usual = float(np.nanmedian(own)) if np.isfinite(own).any() else np.inf
        if more > _SLIGHT**2 * usual / _SQUARE:  # a sum along a line keeps what is in common
            return found
    return None


def variance(view: View, found: Effect) -> F64:
    """Variance (A,), px^2, that neighbours have in common; of a blur that is only bounded, in the mean."""
    return _variances(view, _steps(view), found)


def _variances(view: View, steps: list[F32 | None], found: Effect) -> F64:
    every = zip(view.plan.axes, steps, strict=True)
    share = _LIKELY if np.isnan(found.sigma) else 1.0
    return share * np.array([_common(axis, step, found.value) for axis, step in every])


def _steps(view: View) -> list[F32 | None]:
    return [_gradient(view, place) for place in view.place]


def _gradient(view: View, place: F64) -> F32 | None:
    """Steps (2, K) of a map along columns and rows, from its cubic fit; None: too few pixels."""
    known = np.flatnonzero(np.isfinite(place))
    if len(known) < _FEWEST:
        return None
    known = known[:: 1 + len(known) // _MOST]
    row, col = view.sample.places[known].T.astype(np.float64)
    size = max(float(np.ptp(row)), float(np.ptp(col)), 1.0)
    y, x = (row - row.mean()) / size, (col - col.mean()) / size
    powers = [(i, j) for i in range(4) for j in range(4 - i)]
    one, none = np.ones_like(x), np.zeros_like(x)
    xs, ys = (np.stack([none, one, x, x * x, x * x * x]) for x in (x, y))  # from the power -1 on
    terms = np.stack([xs[i + 1] * ys[j + 1] for i, j in powers])
    fit = np.linalg.lstsq(terms @ terms.T, terms @ place[known], rcond=1e-12)[0]
    along = sum(c * i * xs[i] * ys[j + 1] for c, (i, j) in zip(fit, powers, strict=True))
    down = sum(c * j * xs[i + 1] * ys[j] for c, (i, j) in zip(fit, powers, strict=True))
    return np.asarray(np.abs(np.stack([along, down])) / size, np.float32)


def _bound(view: View, axis: AxisPlan, step: F32 | None) -> float | None:
    """Least blur (cells) by the contrast of the finest fringe; None: unknown."""
    levels, plan = view.sample.levels.astype(np.float64), view.plan
    if not axis.fringes or step is None:
        return None
    fine = axis.fringes[-1]
    own = _median(_amplitude(fine.inverse @ levels[list(fine.index)]))
    if len(axis.fringes) > 1:
        coarse = axis.fringes[0]
        whole, per2 = (_median(_amplitude(coarse.inverse @ levels[list(coarse.index)])), coarse.period**-2)
    elif min(plan.white, plan.black) >= 0:
        whole, per2 = _median(levels[plan.white] - levels[plan.black]) / 2, 0.0
    else:
        return None
    if not np.isfinite([whole, own]).all():  # white that clips everywhere
        return None
    total = (np.log(max(whole, 1e-6) / max(own, 1e-6)) - _CONTRAST) / (
        2 * np.pi**2 * (fine.period**-2 - per2)
    )
    return float(np.sqrt(max(total - (1 + float(np.median(np.square(step).sum(axis=0)))) / 12, 0.0)))


def _median(values: F64) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else np.nan


def _amplitude(fit: F64) -> F64:
    return np.asarray(np.hypot(fit[1], fit[2]))


def _common(axis: AxisPlan, step: F32 | None, blur: float) -> float:
    """Variance (px^2) of one axis."""
    if not axis.fringes or step is None:
        return 0.0
    period = axis.fringes[-1].period

    def through(f: float) -> F32:
        box = np.sinc(f) * np.sinc(step[0] * f) * np.sinc(step[1] * f)
        return np.asarray(box * np.exp(-2 * (np.pi * blur * f) ** 2))

    sides = np.abs(through(1 - 1 / period)) + np.abs(through(1 + 1 / period))
    amplitude = period / (2 * np.pi) * sides / np.maximum(np.abs(through(1 / period)), 1e-3)
    together = np.square(np.sinc(_SQUARE * (step - np.rint(step)))).prod(axis=0)
    return float(np.mean(np.minimum(amplitude, 0.5) ** 2 / 2 * together))
