"""Live: the frames of one prepared rig, one reading each."""

import math
from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from optolever.errors import InputError

from .arrays import Cells, Float, Frame, Mask
from .chain import COMPRESSED, Settled, Track, at_rest, settle
from .circulation import BLOCKS, circulation, excess
from .prepared import Prepared
from .pressure import Forces
from .reading import CREPT, Figures, Reading
from .rest import creep_of, load_of, near_anchor, shift_of
from .touches import Touches, widened
from .verdict import FADED, judge

__all__ = ["Live"]

_SPARSE = 4  # stride of the pixels and cells of medians and shares
_LEAST_NOISE = 0.05  # minimum variance of a dark image over that at rest
_LEAST_STRENGTH = 0.05
_REMAINS, _MOST = 0.06, 0.6  # share of the window's smoothing that stays: measured on 33 dents of lab live
_FOLLOWED = 25  # frames from one start at rest to the next
_CURL = 10.0  # 1 by noise: above, a frame is also fitted from rest


class Live:
    """Readings of frames in order of time; the fit of each frame starts from the preceding one.

    An untrusted frame is fitted once more from rest. The frame after it starts from rest, as does one after a
    frame without a contact, and one in 25: components that no window resolves neither persist nor drift.
    After `reset` a frame gives the same height within its noise."""

    def __init__(self, prepared: Prepared) -> None:
        self.restart(prepared)

    def restart(self, prepared: Prepared) -> None:
        """Begin anew, with another rest."""
        self.prepared, self._faded = prepared, 0
        self._track, self._followed = at_rest(prepared.rig), 0
        self._touches = Touches(prepared)
        self._forces = None if prepared.layer is None else Forces(prepared, prepared.layer)
        self._anchor, self._near = near_anchor(prepared.rig)
        self._creep = creep_of(prepared.rig, prepared.points, self._near)

    def reset(self) -> None:
        """Forget the frames before."""
        self._track, self._followed = at_rest(self.prepared.rig), 0

    def update(self, frame: Frame, time: float = 0.0) -> Reading:
        """The reading of a frame (H, W) of the camera, taken at `time` (s). InputError for a wrong size or
        type."""
        used = self._used(frame)
        settled = self._settle(used, self._track)
        figures = self._figures(used, settled)
        if self._track.whole and (judge(figures).broken or max(figures.curl) > _CURL):
            again = self._settle(used, at_rest(self.prepared.rig))
            others = self._figures(used, again)
            if _merit(others) < _merit(figures):
                settled, figures = again, others
        self._faded = self._faded + 1 if figures.contrast < FADED else 0
        reading = self._reading(settled, figures, time)
        self._track, self._followed = settled.track, self._followed + 1
        if not reading.touches or not reading.trusted or self._followed == _FOLLOWED:
            self.reset()
        return reading

    def _reading(self, settled: Settled, figures: Figures, time: float) -> Reading:
        """Contacts are found beyond noise and creep; they load the anchor, which may explain a shift."""
        prepared, rig = self.prepared, self.prepared.rig
        tau = settled.track.tau
        x, y = (prepared.points[i] + tau * rig.mirror.planes[3 + i] for i in (0, 1))
        noise = _sigma(prepared, settled, figures)
        reading = Reading(
            z=tau * rig.normal,
            sigma=noise,
            noise=noise,
            good=settled.good,
            x=x,
            y=y,
            trusted=True,
            reason="",
            notices=(),
            figures=figures,
            time=time,
        )
        found, steep = self._touches.found(reading, *self._crept(figures))
        if judge(figures).broken:
            found, steep = [], False
        if found:  # their slopes reach the anchor last; a blur moves the anchor's own, truncated windows
            edge = replace(figures, **self._shift(settled, self._anchor, 0))
            figures = min(figures, edge, key=lambda one: one.moved)
        pressing = [one for one, _ in found]
        load = load_of(rig, prepared.points, self._creep, pressing, prepared.layer)
        figures = replace(figures, pulled=load.shift)
        verdict, common = judge(figures, self._faded, steep), _both(self._crept(figures)[1], load.heights)
        reading = replace(
            reading,
            sigma=_both(noise, common),
            trusted=verdict.trusted,
            reason=verdict.reason,
            notices=verdict.notices,
            figures=figures,
            tareable=not found and not verdict.broken,
        )
        if not verdict.trusted:
            return reading
        touches = self._touches.named([widened(one, float(common[at])) for one, at in found])
        forces = () if self._forces is None else self._forces.update(reading, touches, common)
        return replace(reading, touches=touches, forces=forces)

    def _crept(self, figures: Figures) -> tuple[Cells, Cells]:
        """What a shift of the image does to the heights (R, C), mm, and its size, along both axes. It may be
        a load's: then sigma has both."""
        if not figures.moved > CREPT * figures.shift_sigma:
            nothing = np.zeros_like(self._creep.heights[0])
            return nothing, nothing
        parts = np.asarray(figures.shift, np.float32)[:, None, None] * self._creep.heights
        return parts[0] + parts[1], _both(*parts)

    def _shift(self, settled: Settled, where: Mask, which: int) -> dict[str, Any]:
        """Fields of the figures."""
        rig, noise = self.prepared.rig, self.prepared.noise
        offset = settled.track.state.displacement - rig.rest.displacement
        along, down = shift_of(rig, offset, where & settled.good)
        sigma = float(noise.shift[which]) * math.sqrt(max(settled.usual / rig.noise, _LEAST_NOISE))
        return {"shift": (float(along), float(down)), "shift_sigma": sigma}

    def _used(self, frame: Frame) -> Frame:
        """The part of the frame in complete cells."""
        shape = self.prepared.rows, self.prepared.cols
        if np.shape(frame) != shape or np.asarray(frame).dtype.kind != "u":
            raise InputError(
                f"frame: {np.asarray(frame).dtype} of shape {np.shape(frame)}, must be uint of {shape}"
            )
        rows, cols = self.prepared.rig.carriers.lit.shape
        return np.ascontiguousarray(frame[:rows, :cols])

    def _settle(self, frame: Frame, track: Track) -> Settled:
        return settle(self.prepared.rig, frame, track, self.prepared.noise.sigma)

    def _figures(self, frame: Frame, settled: Settled) -> Figures:
        prepared, rig, good = self.prepared, self.prepared.rig, settled.good
        moved = self._shift(settled, self._near, 1)
        curl = _curl(prepared, settled.slopes, good)
        if math.hypot(*moved["shift"]) > CREPT * moved["shift_sigma"]:  # along the edge it has a circulation
            turned = np.tensordot(np.asarray(moved["shift"], np.float32), self._creep.slopes, 1)
            curl = min(curl, _curl(prepared, settled.slopes - turned, good), key=max)
        few = slice(None, None, _SPARSE), slice(None, None, _SPARSE)
        full = (frame[few] >= rig.carriers.full)[rig.carriers.lit[few] > 0]
        level = settled.track.state.level
        return Figures(
            light=float(np.median((level[few] / np.maximum(rig.rest.level[few], 1))[rig.lit[few]])),
            contrast=float(np.median(settled.contrast[few][good[few]])) if good[few].any() else 0.0,
            saturated=float(np.mean(full)),
            lost=1 - _share(good, rig.lit),
            anchored=_share(good, rig.mirror.anchor[0] > 0),
            curl=curl,
            left=settled.left,
            pulled=0.0,
            noise=float(np.sqrt(settled.usual)),
            steps=settled.steps,
            used=(1 - settled.jacobian) / (1 - COMPRESSED),
            **moved,
        )


def _curl(prepared: Prepared, slopes: Cells, good: Mask) -> tuple[float, float]:
    around = [circulation(slopes, good, block) for block in BLOCKS]
    return excess(around[0], prepared.noise.curl_fine), excess(around[1], prepared.noise.curl_coarse)


def _share(good: Mask, among: Mask) -> float:
    return float(np.count_nonzero(good & among) / np.count_nonzero(among))


def _merit(figures: Figures) -> float:
    return figures.lost + 1e-3 * max(figures.curl) + 1e-3 * figures.left


def _both(one: Cells | Float, other: Cells) -> Cells:
    """np.hypot takes some times longer."""
    return np.asarray(np.sqrt(one * one + other * other), np.float32)


def _sigma(prepared: Prepared, settled: Settled, figures: Figures) -> Cells:
    """Sigma by noise at rest, scaled to this frame's noise and amplitude and to the inconsistency of its
    slopes (Birge's factor); the predicted change by further steps; and what the window still smooths."""
    usual = max(settled.usual / prepared.rig.noise, _LEAST_NOISE)
    birge = max(1.0, *figures.curl)
    factor = np.float32(np.sqrt(usual * birge)) if np.isfinite(usual * birge) else np.float32(np.inf)
    noise = prepared.noise.sigma * factor / np.maximum(settled.strength, _LEAST_STRENGTH)
    sigma = _both(_both(noise, settled.ahead), _smoothed(prepared, settled))
    return np.where(settled.good, sigma, np.float32(np.inf))


def _smoothed(prepared: Prepared, settled: Settled) -> Cells:
    """What the window still smooths of z, mm (R, C): a window of variance s^2 cells^2 changes a surface by
    s^2 / 2 times its second differences; steps undo all but a share of that, as the rms residual grows."""
    window, z = prepared.rig.carriers.window, settled.track.tau * prepared.rig.normal
    variance = float(np.square(np.arange(window.size) - window.size // 2) @ window / window.sum())
    bends = sum(np.abs(cv2.Sobel(z, cv2.CV_32F, *order, ksize=1)) for order in ((2, 0), (0, 2)))
    misfit = np.maximum(settled.fit.residual / np.float32(max(settled.usual, 1e-6)), 1)
    share = np.minimum(np.float32(_REMAINS) * np.sqrt(misfit), np.float32(_MOST))
    return np.asarray(np.float32(variance / 2) * bends * share / (1 - share))  # of the bends as they are
