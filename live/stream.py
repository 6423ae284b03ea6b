"""Live: the frames of one prepared rig, one reading each."""

import math
from dataclasses import dataclass

import cv2
import numpy as np

from optolever.contact import Surface, contacts, regions
from optolever.errors import InputError

from .arrays import Cells, Float, Frame, Mask
from .chain import COMPRESSED, Settled, settle
from .circulation import BLOCKS, circulation, excess
from .holes import holes_of
from .prepared import Prepared
from .reading import CREPT, Figures, Reading
from .rest import Creep, Deviation, creep_of, fitted
from .touches import Touches, forces_of
from .verdict import FADED, UNEXPLAINED, judge

__all__ = ["Live"]

_SPARSE = 4  # stride of the pixels and cells of medians and shares
_LEAST_NOISE = 0.05  # minimum variance of a dark image over that at rest
_LEAST_STRENGTH = 0.05
_REMAINS, _MOST = 0.06, 0.6  # share of the window's smoothing that stays: measured on 33 dents of lab live
_COLUMNS = 80  # at least, of the grid on which contacts are looked for first
_ROUNDS = 4  # of contacts, and of the fit of their load
_UNSETTLED = 0.2  # sigma of a correction, over its change by a round
_SAME = 0.1  # of a contact's radius: one that moves less between rounds is the same
_HIDDEN = 10.0  # sigma at rest: of a height that is interpolated

_Found = tuple[tuple[float, float, float], float]  # circle and depth of a contact, mm


@dataclass(frozen=True, slots=True, eq=False)
class _Fitted:
    """A frame: z (R, C), mm, as the anchor counts as at rest; noise (R, C): its sigma; deviation: from rest;
    alone: misfit of a motion of the picture without contacts; steep, dust: see Holes."""

    settled: Settled
    figures: Figures
    deviation: Deviation
    alone: float
    steep: bool
    dust: float
    z: Cells
    noise: Cells


class Live:
    """Readings of frames in order of time. Each is fitted from rest; a contact keeps the identity of the
    nearest one in the frame before."""

    def __init__(self, prepared: Prepared) -> None:
        self.restart(prepared)

    def restart(self, prepared: Prepared) -> None:
        """Begin anew, with another rest."""
        self.prepared, self._faded = prepared, 0
        self._touches = Touches()
        self.creep: Creep = creep_of(prepared.rig, prepared.points)

    def update(self, frame: Frame, time: float = 0.0) -> Reading:
        """The reading of a frame (H, W) of the camera, taken at `time` (s). InputError for a wrong size or
        type."""
        found = self._fitted(self._used(frame))
        self._faded = self._faded + 1 if found.figures.contrast < FADED else 0
        return self._reading(found, time)

    def _reading(self, found: _Fitted, time: float) -> Reading:
        """The heights less what the rig and the anchor moved, and the contacts in them."""
        prepared, rig, tau = self.prepared, self.prepared.rig, found.settled.tau
        x, y = (prepared.points[i] + tau * rig.mirror.planes[3 + i] for i in (0, 1))
        moved = found.deviation.heights(self.creep)
        z = found.z + moved
        modes = np.float32(found.deviation.growth) * found.deviation.modes(self.creep)
        sigma = np.sqrt(np.square(found.noise) + np.square(modes).sum(axis=0))
        surface = Surface(
            x,
            y,
            z,
            np.where(found.settled.good, found.noise, np.float32(_HIDDEN) * prepared.noise.sigma),
            found.settled.good,
            modes=modes,
            motions=len(modes),
            draws=prepared.noise.draws,
        )
        pressing = () if judge(found.figures).broken else regions(surface, _COLUMNS)
        verdict = judge(found.figures, self._faded, found.steep and not pressing, found.dust)
        touches = self._touches.named(contacts(surface, pressing, prepared.layer)) if verdict.trusted else ()
        alone = found.alone < UNEXPLAINED  # far from rest the fit's first order makes dents of its own
        error = np.float32(prepared.error or 0.0)
        still = max(prepared.edge, abs(found.figures.sinking))
        return Reading(
            z=z,
            sigma=sigma,
            total_sigma=np.sqrt(np.square(sigma) + np.float32(still**2) + np.square(error * z)),
            noise=found.noise,
            moved=moved,
            good=found.settled.good,
            x=x,
            y=y,
            trusted=verdict.trusted,
            reason=verdict.reason,
            notices=verdict.notices,
            figures=found.figures,
            time=time,
            tareable=not verdict.broken and (not pressing or (not verdict.trusted and alone)),
            touches=touches,
            forces=forces_of(touches),
        )

    def _fitted(self, frame: Frame) -> _Fitted:
        prepared, rig = self.prepared, self.prepared.rig
        settled = settle(rig, frame, prepared.noise.sigma)
        curl, scale = _curl(prepared, settled.slopes, settled.good), _noise_scale(prepared, settled)
        z, noise = settled.tau * rig.normal, _sigma(prepared, settled, curl)
        deviation, alone = self._deviation(settled, z, noise, scale)
        moved = np.append(deviation.shift, deviation.roll)
        if (np.abs(moved) > CREPT * deviation.sigmas[:3]).any():  # what is left of it is the mirror's
            turned = np.tensordot(moved.astype(np.float32), self.creep.slopes, 1)
            curl = min(curl, _curl(prepared, settled.slopes - turned, settled.good), key=max)
            noise = _sigma(prepared, settled, curl)
        holes = holes_of(z, prepared.noise.sigma, settled.good, rig.lit, rig.rim)
        figures = self._figures(frame, settled, curl, deviation)
        return _Fitted(settled, figures, deviation, alone, *holes, z, noise)

    def _deviation(self, settled: Settled, z: Cells, noise: Cells, scale: float) -> tuple[Deviation, float]:
        """Contacts and their load in turn, on a coarser grid, until no contact comes or goes."""
        prepared = self.prepared
        offset = settled.state.displacement - prepared.rig.rest.displacement
        variance = (
            float(prepared.noise.displacement[0]) * scale,
            float(prepared.noise.displacement[1]) * scale,
        )
        every = max(1, z.shape[1] // _COLUMNS)
        few = slice(None, None, every), slice(None, None, every)
        x, y = (part[few] for part in prepared.points[:2])
        good, noise = (settled.good & ~prepared.rig.rim)[few], noise[few]
        before: list[_Found] = []
        last, alone = np.zeros_like(noise), math.inf
        for _ in range(_ROUNDS):
            found = fitted(self.creep, offset, settled.good, before, prepared.layer, variance)
            alone = min(alone, found.misfit if not before else math.inf)
            moved = found.heights(self.creep, every)
            sigma = np.hypot(noise, _UNSETTLED * (moved - last))
            coarse = Surface(x, y, z[few] + moved, sigma, good, modes=found.modes(self.creep, every))
            after = [(one.circle, one.depth) for one in regions(coarse)]
            still = float(np.abs(moved - last)[good].max(initial=0.0)) < float(np.median(noise))
            if still and _same(before, after):
                break
            before, last = after, moved
        return found, alone

    def _used(self, frame: Frame) -> Frame:
        """The part of the frame in complete cells."""
        shape = self.prepared.rows, self.prepared.cols
        if np.shape(frame) != shape or np.asarray(frame).dtype.kind != "u":
            raise InputError(
                f"frame: {np.asarray(frame).dtype} of shape {np.shape(frame)}, must be uint of {shape}"
            )
        rows, cols = self.prepared.rig.carriers.lit.shape
        return np.ascontiguousarray(frame[:rows, :cols])

    def _figures(
        self, frame: Frame, settled: Settled, curl: tuple[float, float], deviation: Deviation
    ) -> Figures:
        rig, good, creep = self.prepared.rig, settled.good, self.creep
        few = slice(None, None, _SPARSE), slice(None, None, _SPARSE)
        full = (frame[few] >= rig.carriers.full)[rig.carriers.lit[few] > 0]
        level = settled.state.level
        along, down, roll, _ = deviation.sigmas
        return Figures(
            light=float(np.median((level[few] / np.maximum(rig.rest.level[few], 1))[rig.lit[few]])),
            contrast=float(np.median(settled.contrast[few][good[few]])) if good[few].any() else 0.0,
            saturated=float(np.mean(full)),
            lost=1 - _share(good, rig.lit),
            anchored=_share(good, rig.mirror.anchor[0] > 0),
            curl=curl,
            left=settled.left,
            shift=(float(deviation.shift[0]), float(deviation.shift[1])),
            shift_sigma=max(float(along), float(down)),
            sinking=creep.sinking * float(deviation.shift[0]),
            tilt=creep.tilt * float(deviation.shift[0]),
            roll=creep.turn * deviation.roll,
            roll_sigma=creep.turn * float(roll),
            misfit=deviation.misfit,
            noise=float(np.sqrt(settled.usual)),
            steps=settled.steps,
            used=(1 - settled.jacobian) / (1 - COMPRESSED),
        )


def _same(before: list[_Found], after: list[_Found]) -> bool:
    """Whether the same contacts are found."""
    return len(before) == len(after) and all(
        math.dist(one[0], other[0]) < _SAME * other[0][2] for one, other in zip(before, after, strict=True)
    )


def _curl(prepared: Prepared, slopes: Cells, good: Mask) -> tuple[float, float]:
    around = [circulation(slopes, good, block) for block in BLOCKS]
    return excess(around[0], prepared.noise.curl_fine), excess(around[1], prepared.noise.curl_coarse)


def _share(good: Mask, among: Mask) -> float:
    return float(np.count_nonzero(good & among) / np.count_nonzero(among))


def _noise_scale(prepared: Prepared, settled: Settled) -> float:
    """Variance of the image's noise over that at rest."""
    return max(settled.usual / prepared.rig.noise, _LEAST_NOISE)


def _both(one: Cells | Float, other: Cells) -> Cells:
    """np.hypot takes some times longer."""
    return np.asarray(np.sqrt(one * one + other * other), np.float32)


def _sigma(prepared: Prepared, settled: Settled, curl: tuple[float, float]) -> Cells:
    """Sigma by noise at rest, scaled to this frame's noise and amplitude and to the inconsistency of its
    slopes (Birge's factor); the predicted change by further steps; and what the window still smooths."""
    usual, birge = _noise_scale(prepared, settled), max(1.0, *curl)
    factor = np.float32(np.sqrt(usual * birge)) if np.isfinite(usual * birge) else np.float32(np.inf)
    noise = prepared.noise.sigma * factor / np.maximum(settled.strength, _LEAST_STRENGTH)
    sigma = _both(_both(noise, settled.ahead), _smoothed(prepared, settled))
    return np.where(settled.good, sigma, np.float32(np.inf))


def _smoothed(prepared: Prepared, settled: Settled) -> Cells:
    """What the window still smooths of z, mm (R, C): a window of variance s^2 cells^2 changes a surface by
    s^2 / 2 times its second differences; steps undo all but a share of that, as the rms residual grows."""
    window, z = prepared.rig.carriers.window, settled.tau * prepared.rig.normal
    variance = float(np.square(np.arange(window.size) - window.size // 2) @ window / window.sum())
    bends = sum(np.abs(cv2.Sobel(z, cv2.CV_32F, *order, ksize=1)) for order in ((2, 0), (0, 2)))
    misfit = np.maximum(settled.residual / np.float32(max(settled.usual, 1e-6)), 1)
    share = np.minimum(np.float32(_REMAINS) * np.sqrt(misfit), np.float32(_MOST))
    return np.asarray(np.float32(variance / 2) * bends * share / (1 - share))  # of the bends as they are
