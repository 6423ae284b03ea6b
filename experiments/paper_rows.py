"""From a reconstruction to its row of numbers and its curves, along the line through the dent's middle."""

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.notices import Notice
from optolever.reconstruct import HeightMap, PaperGeometry, Profile, recursion

from .metrics import rms
from .paper_simulation import Points

__all__ = ["Curve", "PaperRow", "dense_row", "paper_rows"]

Array = NDArray[np.float64]
Curve = dict[str, Array]
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
    was reconstructed, by the drops (rises diverge in noise); notices: of the dense solver's height map;
    curve: l, and true and found d and theta there, by name ("mean d").
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
    curve: Curve = dataclasses.field(default_factory=dict, compare=False, repr=False)
    field: float | None = None
    notices: tuple[Notice, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Plain values: all but the curve."""
        return {name: value for name, value in dataclasses.asdict(self).items() if name != "curve"}


def paper_rows(
    points: Points, geometry: PaperGeometry, peak: float, names: Names, signs: tuple[int, ...] = SIGNS
) -> Iterator[PaperRow]:
    """The paper's recursion on measured points, by every sign and with gamma or without."""
    for sign in signs:
        for gamma in (False, True):
            result = recursion(points.m, points.w, geometry, sign=sign, gamma=gamma)
            found = {name: getattr(result, name) for name in ("rises", "drops", "mean")}
            yield _row((*names, sign, gamma), points, found, peak)


def dense_row(points: Points, height: HeightMap, row: int, peak: float, names: Names) -> PaperRow:
    """The dense solver's row of the camera that `points` stand for; theta by differences along it."""
    z = np.where(height.good, height.z, np.nan)[row, ::-1]
    x = height.x[row, ::-1]
    return _row((*names, None, None), points, {"mean": Profile(x, z, np.arctan(np.gradient(z, x)))}, peak)


def _row(
    names: tuple[str, str, str, str, int | None, bool | None],
    points: Points,
    found: dict[str, Profile],
    peak: float,
) -> PaperRow:
    """The row of a reconstruction: rms of its series, and what concerns its mean profile."""
    mean = found["mean"]
    error = mean.d - points.d
    known = np.isfinite(error)
    deepest = int(np.argmax(np.where(known, points.d, -np.inf)))
    share = {name: rms(_finite(profile.d - points.d)) / peak for name, profile in found.items()}
    curve = {"l": points.l, "d": points.d, "theta": points.theta}
    for name, profile in found.items():
        curve |= {f"{name} d": profile.d, f"{name} theta": profile.theta}
    return PaperRow(
        *names,
        points=int(known.sum()),
        drops=share.get("drops"),
        rises=share.get("rises"),
        mean=share["mean"],
        largest=float(np.max(np.abs(error), where=known, initial=0.0)) / peak if known.any() else np.nan,
        peak=float(mean.d[deepest] / points.d[deepest] - 1),
        theta=rms(_finite(mean.theta - points.theta)),
        curve=curve,
    )


def _finite(values: Array) -> Array:
    return values[np.isfinite(values)]
