"""HeightStream: heights of a moving mirror, frame by frame, each from the last.

As long as the pixels that can be used stay the same but for small holes, a frame costs one look at the
equations and one linear solve with the last factorisation and the last integrating factor (a chord step; a
second one after a large change). Sigma, anchors' shares and agreement, chi2, the curl alarm and where the
mirror ends are those of the last frame that was solved in full. A frame that does not bear them out is solved
in full itself: one of other noise, with doubts or wrong pixels where there were none, or whose slopes
contradict each other more. Modes of a calibrated rig are solved for as often as `refresh` says.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.ndimage

from optolever.decode import Correspondence
from optolever.notices import Notice
from optolever.scene import Scene

from .coupled import Solution, doubted, solved_height, with_rig
from .heightmap import HeightMap
from .judgement.circulation import (
    chi2_limit,
    circulation_chi2,
    curl_limit,
    curl_scale,
    curl_score,
    curl_suspects,
)
from .judgement.discontinuities import touched
from .judgement.holes import bridged, noise_gain, small_holes
from .problem import Problem
from .result import anchors_apart, height_map, off_mirror
from .rig.model import Measurement
from .solver.anchors import Anchors
from .solver.newton import State, chord_step

__all__ = ["HeightStream"]

_SETTLED = 0.05  # rms change of the height over its sigma that the next step would bring
_STEPS = 3  # chord steps before the frame is solved in full
_NOISIER = 1.2  # times the last sigma: from there on it is computed anew
_MOST = 25.0  # times its variance that a single pixel counts with, as it may be at an edge now
_NEAR = 4  # pixels by which noise moves what is in doubt around a crease


class HeightStream:
    """Give it correspondences of one scene in the order of time.

    anchor: as in `reconstruct`. refresh: every so many frames one is solved in full (sigma, outliers, alarm).
    """

    def __init__(self, scene: Scene, anchor: Anchors = None, refresh: int = 100) -> None:
        self._scene, self._anchor, self._refresh = scene, anchor, max(1, refresh)
        self._age = 0
        self._last: Solution | None = None
        self._seen: Correspondence | None = None  # its correspondence
        self._judgement: tuple[Notice, ...] = ()

    def update(self, correspondence: Correspondence) -> HeightMap:
        """The height of one more frame. Raises InputError as `reconstruct` does."""
        height = None
        if self._last is not None and self._age < self._refresh:
            height = self._followed(correspondence)
        if height is None:
            start = self._last.height if self._last is not None else None
            solved = solved_height(correspondence, self._scene, self._anchor, start=start)
            if not self._scene.exact:
                measured = Measurement(correspondence, self._anchor, None, None)
                solved = with_rig(solved, measured, self._scene)
            height = solved.height
            self._last, self._age, self._seen = solved, 0, correspondence
            apart = (
                *anchors_apart(solved.problem, solved.state, height),
                *off_mirror(height, self._scene.mirror),
            )
            self._judgement = (*height.notices[len(correspondence.notices) :], *apart)
        self._age += 1
        return replace(height, notices=(*correspondence.notices, *self._judgement))

    def _followed(self, correspondence: Correspondence) -> HeightMap | None:
        """The height by chord steps; None where the frame has to be solved in full."""
        assert self._last is not None
        assert self._seen is not None
        problem, state, last = self._last.problem, self._last.state, self._last.height
        noise = self._last.noise
        variance = np.sum(list(noise.values()), axis=0)
        renewed = _renewed(problem, correspondence)
        if renewed is None or not _as_noisy(self._seen, correspondence):
            return None
        size, rate = 0.0, 1.0
        for _ in range(_STEPS):
            before, last_size = state.w, size
            state = chord_step(renewed.data, renewed.labels, state)
            size = float(np.sqrt(np.mean((state.w - before) ** 2 / variance)))
            rate = min(1.0, size / last_size) if last_size > 0 else 1.0
            if size * rate <= _SETTLED:
                state = replace(state, doubt=doubted(renewed, state, 1.0))
                if not _borne_out(self._last, renewed, state):
                    return None
                chi2, freedom = last.diagnostics.chi2, last.diagnostics.freedom
                height = replace(
                    height_map(renewed, state, correspondence, noise, math.nan, chi2, freedom),
                    calibration=last.calibration,
                    sources=last.sources,
                    shares=last.shares,
                    displacement=last.displacement,
                    own=last.own,
                )
                # the variance knows of the doubts of the frame that was solved in full
                kept = replace(state, doubt=self._last.state.doubt)
                self._last = self._last._replace(state=kept, height=height)
                return height
        return None


def _as_noisy(last: Correspondence, now: Correspondence) -> bool:
    """Whether a frame's sigma agrees with the last one's."""
    both = last.good & now.good
    before, after = (one.sigma_u[both] ** 2 + one.sigma_v[both] ** 2 for one in (last, now))
    with np.errstate(divide="ignore", invalid="ignore"):
        times = float(np.mean(np.fmin(after / before, _MOST))) if both.any() else math.inf
    return 1 / _NOISIER**2 < times < _NOISIER**2


def _borne_out(last: Solution, problem: Problem, state: State) -> bool:
    """Whether edges in doubt, wrong pixels and circulation are those of the last frame solved in full."""
    known = last.problem.suspects | last.problem.bridged
    if last.state.doubt is not None:
        known = known | touched(last.state.doubt)
    known = scipy.ndimage.binary_dilation(known, np.ones((3, 3)), _NEAR) | problem.bridged
    if state.doubt is not None and (touched(state.doubt) & ~known).any():
        return False
    score = curl_score(*state.slopes, *state.variances, problem.data.mask)
    limit = curl_limit(score) * max(1.0, np.nan_to_num(curl_scale(score)))
    if (curl_suspects(score, limit, problem.bridged) & problem.data.mask & ~known).any():
        return False
    chi2, freedom = circulation_chi2(problem.data, state, noise_gain(problem.data.mask, problem.bridged))
    usual = last.height.diagnostics.chi2
    return not chi2 > max(chi2_limit(freedom), _NOISIER**2 * (usual if usual is not None else 0.0))


def _renewed(problem: Problem, c: Correspondence) -> Problem | None:
    """The last problem with a new measurement, if that can be used where the last one was, and nowhere else
    but in small holes."""
    if c.u.shape != problem.valid.shape:
        return None
    valid = c.good & np.isfinite(c.u) & np.isfinite(c.v)
    new = valid & ~problem.valid
    if (new & ~small_holes(~new)).any():
        return None
    fields: dict[str, Any] = {
        name: problem.to_grid(np.asarray(getattr(c, name), dtype=np.float64))
        for name in ("u", "v", "sigma_u", "sigma_v")
    }
    usable = problem.to_grid(valid)
    holes = small_holes(usable)
    if not np.array_equal((usable | holes) & problem.data.mask, problem.data.mask):
        return None
    fresh = bridged(replace(problem.data, mask=usable, **fields), holes)
    data, empty = replace(fresh, mask=problem.data.mask), np.zeros_like(holes)
    return replace(problem, valid=valid, bridged=holes, suspects=empty, data=data)
