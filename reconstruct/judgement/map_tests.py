"""Tests of a height map: each has a figure, a limit, words that hold beyond it, and what to do.

A test of a quantity that one step of the chain alone has is taken there (`height_map`, `less_sag`).
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from optolever.decode import Correspondence
from optolever.notices import Judged
from optolever.scene import Scene

from ..heightmap import HeightFlag, HeightMap
from ..problem import Problem
from ..result import UNKNOWN
from ..rig.hypotheses import of_another_rig
from ..rig.model import LIKELY, Measurement, RigJudgement
from ..rig.since_rest import PictureShift
from ..solver.newton import State
from .circulation import circulation_test

__all__ = ["Solved", "judged"]

_PRESSED = "total_sigma includes it; the rest capture has a contact of its own"
_MOSTLY = 0.5  # of the good pixels: lost, without a word
_LOST = 0.005  # of the pixels, that a rest capture does not know: above, they are named
_HOLLOW = 0.3  # of the depth: silicone rises less beside a contact
_DEEP = 5.0  # sigmas of a mean depth; how much deeper than high a map is that was exchanged
_APART = 5.0  # standard deviations, rms: rigs that are right stay below 1.2
_SURE = 3.0  # standard deviations
_WEDGE = 10.0  # times: of a prism within a tenth of its length


class Solved(NamedTuple):
    """A height map and its sources. corrected: the correspondence less the rest capture's deviation;
    rig: how the slopes were judged beside the rig's errors; mistake: in the scene, without which the capture
    fits, in words; shift: of the picture since rest; loaded: whether sag and motion were measured; named:
    whether the anchor is that of a mirror at rest."""

    height: HeightMap
    problem: Problem
    state: State
    scene: Scene
    measured: Measurement
    corrected: Correspondence
    rig: RigJudgement | None
    mistake: str | None
    shift: PictureShift | None
    loaded: bool

    @property
    def at_rest(self) -> bool:
        """Whether there is a rest capture."""
        return self.measured.rest is not None


def judged(solved: Solved) -> tuple[Judged, ...]:
    """The map's tests and all others that it allows, in the order of their notices. A contact at rest is no
    load, and the cause where the load does not fit."""
    found = [one for one in (*solved.height.tests, *(test(solved) for test in TESTS)) if one is not None]
    pressed = any(one.test == "below rest" and one.fails for one in found)
    return tuple(replace(one, cure=_PRESSED) if pressed and one.test == "load" else one for one in found)


def _circulation(solved: Solved) -> Judged | None:
    rig, diagnostics = solved.rig, solved.height.diagnostics
    typed = rig is not None and not solved.scene.exact
    likely = rig is not None and typed and rig.likely
    return circulation_test(diagnostics.chi2, diagnostics.freedom, typed, solved.at_rest, likely)


def _plausible(solved: Solved) -> Judged | None:
    rig, limit = solved.rig, LIKELY**0.5
    words = "The capture contradicts its scene beyond the scene's accuracy; no height is trusted"
    cure = "check pose, pitch and size of pattern and camera, and that the capture belongs to this scene"
    if solved.height.implausible:
        if solved.mistake:
            cure = f"with one change it fits: {solved.mistake}; correct it"
        return Judged("plausible", math.nan, math.nan, words, cure)
    return (
        None
        if rig is None
        else Judged("plausible", rig.errors, math.inf if rig.likely else limit, words, cure)
    )


def _unknown(solved: Solved) -> Judged | None:
    height = solved.height
    unknown = (height.flags == HeightFlag.SINGULAR) & (
        height.total_sigma > UNKNOWN * solved.scene.mirror.length
    )
    every = np.count_nonzero(height.good | unknown)
    if not every:
        return None
    words = "total sigma exceeds a quarter of the mirror's length, share"
    cure = "these pixels have no height; correct [mirror] size_mm, [accuracy] or the anchor"
    return Judged("total sigma", np.count_nonzero(unknown) / every, _MOSTLY, words, cure)


def _rest_pixels(solved: Solved) -> Judged | None:
    """Pixels of the press that the rest capture does not know."""
    if not solved.at_rest:
        return None
    lost, where = solved.measured.correspondence.good & ~solved.corrected.good, ""
    count = int(np.count_nonzero(lost))
    if count:
        rows, cols = (np.flatnonzero(lost.any(axis=axis)) for axis in (1, 0))
        where = f" (rows {rows[0]} to {rows[-1]}, columns {cols[0]} to {cols[-1]})"
    words = f"The rest capture has no coordinates for {count} pixels of the press{where}: no height there"
    cure = "capture the mirror at rest with the same exposure"
    return Judged("rest pixels", count / lost.size, _LOST, words, cure)


def _moved(solved: Solved) -> Judged | None:
    """Whether the picture has moved as a whole, more than a rig does and than the fit is unsure of."""
    shift = solved.shift
    if shift is None:
        return None
    taken = "the rig's motion" if shift.prior else "the mirror's sinking"
    cure = (
        f"as of a mirror that sank by {1e3 * abs(shift.sunk):.2g} µm; heights count it as {taken}, "
        "total_sigma as either: clamp the rig, let it warm up, and capture the mirror at rest again"
    )
    return Judged(
        "moved", shift.pixels, shift.limit, "The picture has moved as a whole since rest, pixels", cure
    )


def _below_rest(solved: Solved) -> Judged | None:
    """Heights below the mirror at rest: both captures are exchanged, or rest has a contact."""
    height = solved.height
    z = height.z[height.good]
    if not solved.at_rest or solved.scene.medium is None or not z.size:
        return None
    lowest, highest, low = float(-z.min()), max(float(z.max()), 0.0), "Heights lie below those at rest, mm:"
    limit = _DEEP * max(float(np.median(height.sigma[height.good])), highest)
    if lowest > limit:
        words, cure = f"{low} press and rest are probably exchanged", "exchange C.npz and reconstruct --rest"
        return Judged("below rest", lowest, limit, words, cure)
    words, cure = (
        f"{low} the rest capture probably shows a contact",
        "right for the difference of two presses; else take everything off the mirror and capture it again",
    )
    limit = max(_HOLLOW * highest, _DEEP * float(height.total_sigma[height.good][z.argmin()]))
    return Judged("below rest", lowest, limit, words, cure)


def _anchors(solved: Solved) -> Judged | None:
    """Whether the anchors (of the edge, its points) contradict each other, noise and rig considered: each
    against the height that they have in common."""
    problem, state, height = solved.problem, solved.state, solved.height
    if height.implausible or solved.loaded:
        return None
    data, rows, used = problem.data, state.rows, state.share > 0
    off = rows.predict(state.w, *state.slopes) - rows.known
    sigma = problem.to_grid(height.total_sigma / np.abs(problem.rays.inner_directions[2]))
    unit = data.distance(state.w) if data.rays.logarithmic else 1.0
    variance = np.square(sigma / unit).ravel()[rows.pixel]
    variance += rows.sigma**2 + rows.spread(*state.variances) + state.bend**2
    score = off[used] / np.sqrt(variance[used])
    apart = math.sqrt(np.nanmean(np.square(score))) if np.isfinite(score).any() else 0.0
    cure = (
        "heights err by more than sigma; a curved mirror's edge does not lie at z = 0 (reconstruct --anchor "
        "middle); on a flat one the scene is wrong: optolever calibrate, or reconstruct --rest"
    )
    return Judged("anchors", apart, _APART, "The anchors contradict each other; rms in sigma", cure)


def _wedge(solved: Solved) -> Judged | None:
    """Whether all anchors lie where the free mode is small, as where the mirror meets the pattern."""
    state, height = solved.state, solved.height
    used = np.broadcast_to(state.root**2, state.w.shape).ravel()[state.rows.pixel[state.share > 0]]
    if height.implausible or not used.any():
        return None
    sigma = float(np.median(height.total_sigma[height.good])) if height.good.any() else math.nan
    cure = (
        f"total_sigma is {sigma:.2g} mm (median) by that; anchor the mirror farther from where it meets the "
        "pattern, or capture it at rest (reconstruct --rest)"
    )
    words = "The error of the anchors grows towards the mirror's other end, times"
    return Judged("wedge", 1 / float(used.max()), _WEDGE, words, cure)


def _edge(solved: Solved) -> Judged | None:
    """Whether good pixels lie off the mirror by more than one pixel, which may see it in part, and the
    uncertainty of their positions."""
    height, mirror, anchor = solved.height, solved.scene.mirror, solved.measured.anchor
    x, y = height.x[height.good], height.y[height.good]
    if height.implausible or not x.size:
        return None
    farthest = max(0.0, float(max(-x.min(), x.max() - mirror.length, -y.min(), y.max() - mirror.width)))
    step = float(np.nanmax(np.hypot(np.diff(height.x, axis=1), np.diff(height.y, axis=1)), initial=0))
    moves = np.zeros((1, 2, 3)) if height.displacement is None else height.displacement
    corners = [[1.0, x, y] for x in (0.0, mirror.length) for y in (0.0, mirror.width)]
    limit = step + _SURE * max(float(np.linalg.norm(moves @ corner)) for corner in corners)
    cure = (
        "x and y are shifted by as much; most likely the mirror's size or the camera's place is wrong in the "
        "scene: correct it, or calibrate with a ball"
    ) + ("" if anchor is None or isinstance(anchor, str) else "; or the anchor is no point of the mirror")
    return Judged("mirror's edge", farthest, limit, "Points lie beyond the mirror's edge, mm", cure)


def _rest_rig(solved: Solved) -> Judged | None:
    return of_another_rig(solved.measured, solved.scene)


#: None of a test: the map has no such figure.
TESTS: tuple[Callable[[Solved], Judged | None], ...] = (
    _circulation,
    _plausible,
    _unknown,
    _rest_pixels,
    _moved,
    _below_rest,
    _anchors,
    _wedge,
    _edge,
    _rest_rig,
)
