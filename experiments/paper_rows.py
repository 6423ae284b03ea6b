"""From a reconstruction to its row of numbers and its curves, along the line through the dent's middle."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optolever.notices import Notice
from optolever.reconstruct import HeightMap, PaperGeometry, Profile, recursion

from .metrics import rms
from .paper_simulation import Points

__all__ = ["Curves", "PaperRow", "curve_name", "dense_row", "paper_rows"]

Array = NDArray[np.float64]
Curves = dict[str, dict[str, Array]]
Names = tuple[str, str, str, str]  # case, data, law, method
SIGNS = (1, -1)


@dataclass(frozen=True, slots=True)
class PaperRow:
    """Errors of one reconstruction along the line through the dent's middle, over the peak depth.

    case: smooth | needle | pencil; data: exact | frames; law: reflection | print, by which the light went;
    method: lattice | pixels (the paper's, on crossings or on every pixel) | dense; sign, gamma: of the
    paper's equations (dense: None); points: how many; drops, rises, mean: rms of each series (dense: mean
    alone); largest: of the mean; peak: estimated over true depth at the deepest point, minus 1; theta: rms
    error of the mean's slope angle (rad); field: rms over all pixels, where the whole field
    was reconstructed, by the drops (rises diverge in noise); notices: of the dense solver's height map.
    """

    case: str
    data: str
    law: str
    method: str
    sign: int | None
    gamma: bool | None
    points: int
    drops: float | None
    rises: float | None
    mean: float
    largest: float
    peak: float
    theta: float
    field: float | None = None
    notices: tuple[Notice, ...] = ()


def curve_name(data: str, law: str, method: str, sign: int | None = None, gamma: bool | None = None) -> str:
    """The key of a reconstruction's curves."""
    words = [data, law, method]
    return " ".join(words if sign is None else [*words, f"{sign:+d}", "gamma" if gamma else "no-gamma"])


def paper_rows(
    points: Points,
    geometry: PaperGeometry,
    peak: float,
    names: Names,
    curves: Curves,
    signs: tuple[int, ...] = SIGNS,
) -> Iterator[PaperRow]:
    """The paper's recursion on measured points, by every sign and with gamma or without; adds to `curves`."""
    for sign in signs:
        for gamma in (False, True):
            result = recursion(points.m, points.w, geometry, sign=sign, gamma=gamma)
            curve = {"l": points.l, "d": points.d, "theta": points.theta}
            for name in ("rises", "drops", "mean"):
                profile = getattr(result, name)
                curve |= {f"{name} d": profile.d, f"{name} theta": profile.theta}
            curves[curve_name(*names[1:], sign, gamma)] = curve
            drops, rises = (rms(_finite(p.d - points.d)) / peak for p in (result.drops, result.rises))
            yield _row(names, sign, gamma, (drops, rises), points, result.mean, peak)


def dense_row(
    points: Points, height: HeightMap, row: int, peak: float, names: Names, curves: Curves
) -> PaperRow:
    """The dense solver's row of the camera that `points` stand for; theta by differences along it."""
    z = np.where(height.good, height.z, np.nan)[row, ::-1]
    x = height.x[row, ::-1]
    theta = np.arctan(np.gradient(z, x))
    curves[curve_name(*names[1:])] = {
        "l": points.l,
        "d": points.d,
        "theta": points.theta,
        "mean d": z,
        "mean theta": theta,
    }
    return _row(names, None, None, (None, None), points, Profile(x, z, theta), peak)


def _row(
    names: Names,
    sign: int | None,
    gamma: bool | None,
    series: tuple[float | None, float | None],
    points: Points,
    profile: Profile,
    peak: float,
) -> PaperRow:
    """The row of a reconstruction: rms of drops and rises, and what concerns its mean profile."""
    error = profile.d - points.d
    known = np.isfinite(error)
    deepest = int(np.argmax(np.where(known, points.d, -np.inf)))
    return PaperRow(
        *names,
        sign,
        gamma,
        points=int(known.sum()),
        drops=series[0],
        rises=series[1],
        mean=rms(error[known]) / peak,
        largest=float(np.max(np.abs(error), where=known, initial=0.0)) / peak if known.any() else np.nan,
        peak=float(profile.d[deepest] / points.d[deepest] - 1),
        theta=rms(_finite(profile.theta - points.theta)),
    )


def _finite(values: Array) -> Array:
    return values[np.isfinite(values)]
