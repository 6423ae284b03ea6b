"""HeightStream: heights of a moving mirror, frame by frame, each from the last.

As long as the pixels that can be used stay the same but for small holes, a frame costs one look at the
equations and one linear solve with the last factorisation and the last integrating factor (a chord step; a
second one after a large change). Sigma, anchors' shares and agreement, chi2, the curl alarm and where the
mirror ends are those of the last frame that was solved in full; modes of a calibrated rig are solved for as
often as `refresh` says.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from optolever.decode import Correspondence
from optolever.notices import Notice
from optolever.scene import Scene

from .anchors import Anchors
from .coupled import Solution, doubted, solved_height, with_modes
from .heightmap import HeightMap
from .holes import bridged, small_holes
from .newton import chord_step
from .problem import Problem, require_correspondence
from .propagation import Measurement, interpolated
from .result import anchors_apart, height_map

__all__ = ["HeightStream"]

_SETTLED = 0.05  # rms change of the height over its sigma that the next step would bring
_STEPS = 3  # chord steps before the frame is solved in full


class HeightStream:
    """Give it correspondences of one scene in the order of time.

    anchor: as in `reconstruct`. refresh: every so many frames one is solved in full (sigma, outliers, alarm).
    """

    def __init__(self, scene: Scene, anchor: Anchors = None, refresh: int = 100) -> None:
        self._scene, self._anchor, self._refresh = scene, anchor, max(1, refresh)
        self._age = self._modes_age = 0
        self._last: Solution | None = None
        self._judgement: tuple[Notice, ...] = ()

    def update(self, correspondence: Correspondence) -> HeightMap:
        """The height of one more frame. Raises InputError as `reconstruct` does."""
        require_correspondence(correspondence)
        height = None
        if self._last is not None and self._age < self._refresh:
            height = self._followed(correspondence)
        if height is None:
            start = self._last.height if self._last is not None else None
            solved = solved_height(correspondence, self._scene, self._anchor, start=start)
            height = self._with_modes(solved.height, correspondence)
            self._last, self._age = solved._replace(height=height), 0
            apart = anchors_apart(solved.problem, solved.state, height)
            self._judgement = (*height.notices[len(correspondence.notices) :], *apart)
        self._age += 1
        self._modes_age += 1
        return replace(height, notices=(*correspondence.notices, *self._judgement))

    def _with_modes(self, height: HeightMap, correspondence: Correspondence) -> HeightMap:
        """With the modes of a calibrated rig: the last ones, anew where they are `refresh` frames old."""
        modes = None if self._last is None else self._last.height.calibration
        if modes is not None and self._modes_age < self._refresh:
            modes = interpolated(modes.astype(np.float64), 1, np.isfinite(height.z))
        else:
            modes, self._modes_age = None, 0
        measured = Measurement(correspondence, self._anchor, None, None, "coupled")
        return with_modes(height, measured, self._scene, modes)

    def _followed(self, correspondence: Correspondence) -> HeightMap | None:
        """The height by chord steps; None where the frame has to be solved in full (a crease appears)."""
        assert self._last is not None
        problem, state, variance, last = self._last
        renewed = _renewed(problem, correspondence)
        if renewed is None:
            return None
        size, rate = 0.0, 1.0
        for _ in range(_STEPS):
            before, last_size = state.w, size
            state = chord_step(renewed.data, renewed.labels, state)
            size = float(np.sqrt(np.mean((state.w - before) ** 2 / variance)))
            rate = min(1.0, size / last_size) if last_size > 0 else 1.0
            if size * rate <= _SETTLED:
                doubt = doubted(renewed, state, 1.0)
                if doubt is not None and state.doubt is None:
                    return None
                state = replace(state, doubt=doubt)
                correlation = last.diagnostics.correlation
                height = height_map(
                    renewed, state, correspondence.flags, math.nan, "coupled", variance, correlation
                )
                chi2, freedom = last.diagnostics.chi2, last.diagnostics.freedom
                height = replace(
                    height,
                    diagnostics=replace(height.diagnostics, chi2=chi2, freedom=freedom),
                    calibration=last.calibration,
                    sources=last.sources,
                    shares=last.shares,
                )
                self._last = Solution(problem, state, variance, height)
                return height
        return None


def _renewed(problem: Problem, c: Correspondence) -> Problem | None:
    """The last problem with a new measurement, if that can be used where the last one was."""
    if c.u.shape != problem.valid.shape:
        return None
    valid = c.good & np.isfinite(c.u) & np.isfinite(c.v)
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
