"""The line through a dent's middle: the seed's simulation of it, exact, by the reflection law or by the
printed sign; its measurement, one column of lattice crossings detected in a frame at rest and in a dented
one; and a reconstruction's row of numbers and curves.

For a mirror point, (12) and (14) give the positions of its ray on the pattern and on the capture face; the
mirror point of a given position on either face is found by bisection.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever import InputError
from optolever.live import lattice
from optolever.notices import Notice
from optolever.patterns import Sequence, sequence
from optolever.projector import capture
from optolever.reconstruct import HeightMap
from optolever.scene import Scene, Surface, dent, trace

from ..arrays import Floats
from ..metrics import rms
from ..place import Place
from .equations import capture_position, pattern_angle, pattern_position
from .recursion import PaperGeometry, Profile, recursion
from .rows import capture_positions, pattern_positions, prism_geometry

_HALVINGS = 60
PIXELS_PER_LINE = 10  # camera pixels per lattice line, for separate lines
Frame = NDArray[Any]
Curve = dict[str, Floats]
Names = tuple[str, str, str, str]  # case, data, law, method
SIGNS = (1, -1)


@dataclass(frozen=True, slots=True)
class Points:
    """Mirror points along a line (points,), by rising l: measured m and w (mm); true l, d (mm) and theta
    (rad).
    """

    m: Floats
    w: Floats
    l: Floats
    d: Floats
    theta: Floats


@dataclass(frozen=True, slots=True)
class Line:
    """The cut y = const through a dent, one y for all points or one each (mm)."""

    surface: Surface
    geometry: PaperGeometry
    y: Floats | float

    @classmethod
    def of(cls, place: Place) -> Line:
        """The cut through the mirror's middle."""
        return cls(place.surface, prism_geometry(place.scene), place.scene.mirror.width / 2)

    def points(self, l: Floats, sign: int = 1) -> Points:
        """The mirror points at l, with positions on the pattern and on the capture face."""
        g, y = self.geometry, np.broadcast_to(self.y, l.shape)
        d = np.asarray(self.surface.height(l, y), dtype=np.float64)
        theta = np.arctan(np.asarray(self.surface.gradient(l, y)[0], dtype=np.float64))
        m = pattern_position(l, d, pattern_angle(g.beta0, theta, sign), g.alpha0)
        return Points(m, capture_position(l, d, g.beta0, g.beta0, g.length), l, d, theta)


def lattice_points(line: Line, count: int, sign: int) -> Points:
    """`count` lines, equally spaced (half a space from the ends) on the part of the pattern in view at rest.

    Lines without a mirror point (a cusp skips some) are omitted; for a line with several, one is returned.
    """
    g = line.geometry
    rest = g.length * np.cos(g.beta0) / np.cos(g.beta0 - g.alpha0)
    m = rest * (np.arange(count) + 0.5) / count
    l = _where_rising(lambda x: line.points(x, sign).m, m, g.length)
    return line.points(l[np.abs(line.points(l, sign).m - m) < 1e-6 * rest], sign)


def pixel_points(line: Line, w: Floats, sign: int) -> Points:
    """The mirror points of the capture positions w (mm), in order of l."""
    return line.points(np.sort(_seen(line, w)), sign)


def seen_points(surface: Surface, geometry: PaperGeometry, m: Floats, w: Floats, y: Floats) -> Points:
    """Measured points m, w with the truth at the measured places: the mirror points of w at this y."""
    line = Line(surface, geometry, np.nan_to_num(y))
    order = np.argsort(m)
    at = line.points(np.where(np.isfinite(w), _seen(line, w), np.nan)[order])
    return replace(at, m=m[order], w=w[order])


def _seen(line: Line, w: Floats) -> Floats:
    return _where_rising(lambda x: -line.points(x).w, -w, line.geometry.length)


def _where_rising(function: Callable[[Floats], Floats], values: Floats, length: float) -> Floats:
    """Inverse of a rising function on (0, length), by bisection."""
    low, high = np.zeros_like(values), np.full_like(values, length)
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        below = function(middle) < values
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return (low + high) / 2


def lattice_frames(
    scene: Scene, surface: Surface, lines: int, *, noise: float, seed: int, renderer: str
) -> tuple[Sequence, Frame, Frame]:
    """The displayed sequence, and its frames at rest and dented, (1, H, W) each.

    The lattice has `lines` lines on the part of the pattern in view at rest, or as many as a smaller camera
    resolves.
    """
    geometry, pattern = prism_geometry(scene), scene.pattern
    seen = geometry.length * np.cos(geometry.beta0) / np.cos(geometry.beta0 - geometry.alpha0)
    lines = min(lines, scene.camera.cols // PIXELS_PER_LINE)
    shown = sequence("lattice", pattern.rows, pattern.cols, period=seen / lines / pattern.pitch)
    rest, dented = (
        capture(scene, shape, shown, renderer=renderer, noise=noise, seed=seed + step).frames
        for step, shape in enumerate((dent("flat", scene), surface))
    )
    return shown, rest, dented


def lattice_positions(
    scene: Scene, shown: Sequence, rest: Frame, dented: Frame
) -> tuple[Floats, Floats, Floats]:
    """m, w and y (mm) of the crossings along the pattern line nearest to the mirror's middle.

    m: position of the crossing on the pattern; w, y: its position in the dented frame, NaN if not detected.
    InputError if fewer than two are detected.
    """
    pattern = scene.pattern
    crossings = lattice(dented, rest, shown, prior=trace(scene, dent("flat", scene)))
    middle = crossings.index[np.argmin(np.abs(crossings.pattern[:, 1] - (pattern.rows - 1) / 2)), 1]
    column = crossings.index[:, 1] == middle
    found = int((column & crossings.found).sum())
    if found < 2:
        raise InputError(
            f"scene {scene.name}: {found} lattice crossings found along the middle, needs at least 2"
        )
    row, col = crossings.now[column].T
    m = pattern_positions(scene, crossings.pattern[column, 0])
    return m, capture_positions(scene, row, col), scene.camera.rays_at(row, col)[0][:, 1]


@dataclass(frozen=True, slots=True)
class PaperRow:
    """Errors of one reconstruction along the line through the dent's middle, over the peak depth.

    case: smooth | needle | pencil; data: exact | frames; law: reflection | print, the law of the simulation;
    method: lattice | pixels (the paper's, on crossings or on every pixel) | dense; sign, gamma: of the
    paper's equations (dense: None); points: their number; drops, rises, mean: rms of each series (dense: mean
    alone); largest: of the mean; peak: estimated over true depth at the deepest point, minus 1; theta: rms
    error of the mean's slope angle (rad); field: rms over all pixels, if the full field was reconstructed, by
    the drops (rises diverge in noise); notices: of the dense solver's height map; curve: l, and true and
    estimated d and theta there, by name ("mean d").
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
    """The paper's recursion on measured points, for each sign, with gamma and without."""
    for sign in signs:
        for gamma in (False, True):
            result = recursion(points.m, points.w, geometry, sign=sign, gamma=gamma)
            found = {name: getattr(result, name) for name in ("rises", "drops", "mean")}
            yield _row((*names, sign, gamma), points, found, peak)


def dense_row(points: Points, height: HeightMap, row: int, peak: float, names: Names) -> PaperRow:
    """The dense solver's result along the camera row of `points`; theta by differences along the row."""
    z = np.where(height.good, height.z, np.nan)[row, ::-1]
    x = height.x[row, ::-1]
    return _row((*names, None, None), points, {"mean": Profile(x, z, np.arctan(np.gradient(z, x)))}, peak)


def _row(
    names: tuple[str, str, str, str, int | None, bool | None],
    points: Points,
    found: dict[str, Profile],
    peak: float,
) -> PaperRow:
    """The row of a reconstruction: rms of its series, errors and curve of its mean profile."""
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


def _finite(values: Floats) -> Floats:
    return values[np.isfinite(values)]
