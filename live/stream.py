"""Live: the frames of one prepared rig, one reading each."""

from dataclasses import replace

import cv2
import numpy as np

from optolever.errors import InputError

from .arrays import Cells, Frame, Mask
from .chain import Rig, Settled, Track, at_rest, settle
from .circulation import BLOCKS, circulation, excess
from .prepared import Prepared
from .pressure import Forces
from .reading import Figures, Reading
from .touches import Touches
from .verdict import Verdict, judge

__all__ = ["Live"]

_SPARSE = 4  # stride of the pixels and cells of medians and shares
_LEAST_NOISE = 0.05  # minimum variance of a dark image over that at rest
_LEAST_STRENGTH = 0.05
_REMAINS = 0.05  # of the window's smoothing after the steps: measured on drawn streams (lab live)
_FOLLOWED = 25  # frames from one start at rest to the next
_CURL = 10.0  # 1 by noise: above, a frame is also fitted from rest


class Live:
    """Readings of frames in order of time; the fit of each frame starts from the preceding one.

    An untrusted frame is fitted once more from rest. The frame after it starts from rest, as does one after a
    frame without a contact, and one in 25: components that no window resolves neither persist nor drift.
    After `reset` a frame gives the same height within its noise."""

    def __init__(self, prepared: Prepared) -> None:
        self.prepared = prepared
        self._track, self._followed = at_rest(prepared.rig), 0
        self._touches = Touches(prepared)
        self._forces = None if prepared.layer is None else Forces(prepared, prepared.layer)

    def reset(self) -> None:
        """Forget the frames before."""
        self._track, self._followed = at_rest(self.prepared.rig), 0

    def update(self, frame: Frame, time: float = 0.0) -> Reading:
        """The reading of a frame (H, W) of the camera, taken at `time` (s). InputError for a wrong size or
        type."""
        used = self._used(frame)
        settled = self._settle(used, self._track)
        figures, verdict = self._judged(used, settled)
        if self._track.whole and (not verdict.trusted or max(figures.curl) > _CURL):
            again = self._settle(used, at_rest(self.prepared.rig))
            others = self._judged(used, again)
            if _merit(others[0]) < _merit(figures):
                settled, (figures, verdict) = again, others
        reading = _reading(self.prepared, settled, figures, verdict, time)
        touches = self._touches.update(reading)
        self._track, self._followed = settled.track, self._followed + 1
        if not touches or not verdict.trusted or self._followed == _FOLLOWED:
            self.reset()
        forces = () if self._forces is None else self._forces.update(reading, touches)
        return replace(reading, touches=touches, forces=forces)

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

    def _judged(self, frame: Frame, settled: Settled) -> tuple[Figures, Verdict]:
        figures = _figures(self.prepared, frame, settled)
        return figures, judge(figures)


def _figures(prepared: Prepared, frame: Frame, settled: Settled) -> Figures:
    rig, good = prepared.rig, settled.good
    sigmas = prepared.noise.curl_fine, prepared.noise.curl_coarse
    around = [circulation(settled.slopes, good, block) for block in BLOCKS]
    fine, coarse = (excess(part, sigma) for part, sigma in zip(around, sigmas, strict=True))
    lit, anchor = rig.lit, rig.mirror.anchor[0] > 0
    few = slice(None, None, _SPARSE), slice(None, None, _SPARSE)
    full = (frame[few] >= rig.carriers.full)[rig.carriers.lit[few] > 0]
    level = settled.track.state.level
    return Figures(
        light=float(np.median((level[few] / np.maximum(rig.rest.level[few], 1))[lit[few]])),
        contrast=float(np.median(settled.contrast[few][good[few]])) if good[few].any() else 0.0,
        saturated=float(np.mean(full)),
        lost=1 - _share(good, lit),
        anchored=_share(good, anchor),
        curl=(fine, coarse),
        left=settled.left,
        moved=_moved(rig, settled, anchor & good),
        noise=float(np.sqrt(settled.usual)),
        steps=settled.steps,
    )


def _share(good: Mask, among: Mask) -> float:
    return float(np.count_nonzero(good & among) / np.count_nonzero(among))


def _moved(rig: Rig, settled: Settled, where: Mask) -> float:
    """Shift of the image at the anchor, pixels: its median displacement over the rest map's gradient."""
    if not where.any():
        return 0.0
    offset = settled.track.state.displacement - rig.rest.displacement
    turns = np.median(offset[:, where], axis=1)
    per_cell = np.median(rig.gradient[:, where], axis=1).reshape(2, 2).T.astype(np.float64)
    shift = np.linalg.lstsq(per_cell, turns, rcond=None)[0]
    return float(np.hypot(*shift)) * rig.carriers.cell


def _merit(figures: Figures) -> float:
    return figures.lost + 1e-3 * max(figures.curl) + 1e-3 * figures.left


def _reading(
    prepared: Prepared, settled: Settled, figures: Figures, verdict: Verdict, time: float
) -> Reading:
    rig, good = prepared.rig, settled.good
    tau = settled.track.tau
    sigma = _sigma(prepared, settled, figures)
    x, y = (prepared.points[i] + tau * rig.mirror.planes[3 + i] for i in (0, 1))
    z = tau * rig.normal
    return Reading(z, sigma, good, x, y, verdict.trusted, verdict.reason, verdict.notices, figures, time)


def _sigma(prepared: Prepared, settled: Settled, figures: Figures) -> Cells:
    """Sigma by noise at rest, scaled to this frame's noise and amplitude and to the inconsistency of its
    slopes (Birge's factor); the predicted change by further steps; and what the window still smooths."""
    usual = max(settled.usual / prepared.rig.noise, _LEAST_NOISE)
    birge = max(1.0, *figures.curl)
    factor = np.float32(np.sqrt(usual * birge)) if np.isfinite(usual * birge) else np.float32(np.inf)
    noise = prepared.noise.sigma * factor / np.maximum(settled.strength, _LEAST_STRENGTH)
    sigma = np.hypot(np.hypot(noise, settled.ahead), _smoothed(prepared, settled))
    return np.where(settled.good, sigma, np.inf).astype(np.float32)


def _smoothed(prepared: Prepared, settled: Settled) -> Cells:
    """What the window still smooths of z, mm (R, C): a window of variance s^2 cells^2 changes a surface by
    s^2 / 2 times its second differences; steps undo most of that, less where the fit leaves a residual."""
    window, z = prepared.rig.carriers.window, settled.track.tau * prepared.rig.normal
    variance = float(np.square(np.arange(window.size) - window.size // 2) @ window / window.sum())
    bends = (np.abs(cv2.Sobel(z, cv2.CV_32F, *order, ksize=1)) for order in ((2, 0), (0, 2)))
    misfit = np.maximum(settled.fit.residual / np.float32(max(settled.usual, 1e-6)), 1)
    return np.asarray(np.float32(_REMAINS * variance / 2) * misfit * sum(bends))
