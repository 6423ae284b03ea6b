"""Live: the frames of one prepared rig, one reading each."""

import math
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from optolever.arrays import Cells, Frame, Mask
from optolever.blocks import blas_on_one
from optolever.contact import Contact, ElasticFit, Region, Surface, contacts, elastic_fits, regions
from optolever.errors import InputError
from optolever.kernels import plain

from .fringe.chain import COMPRESSED, Settled
from .fringe.circulation import circulations
from .fringe.strays import settle_without_strays
from .holes import holes_of
from .reading import CREPT, Figures, Reading
from .rest.prepared import Prepared
from .rest.rig_motion import Deviation, RigMotion, fitted, rig_motion
from .touches import Touches, forces_of
from .verdict import FADED, UNEXPLAINED, judge

__all__ = ["RESOLVED", "Live"]

_SPARSE = 4  # stride of the pixels and cells of medians and shares
_LEAST = 0.05  # variance of a dark image's noise, and amplitude, over those at rest
_REMAINS, _MOST = 0.06, 0.6  # share of the window's smoothing that stays: measured on 33 dents of lab live
_EARLY = 0.3  # the same, times steps, where few end the fit: after two 2.2 times that after five
_COLUMNS = 80  # at least, of the grid on which contacts are looked for first
_ROUNDS = 4  # of contacts and the fit of their load, of fits behind holes
_KINK = 30.0  # residual over the usual one, mean squares, at which half of what a kink loses is lacking
_AS_DEEP = 0.8  # of a contact's measured depth
_AWAY, _FITTED = 0.1, 2000  # radii by which a fit behind a hole moves it, to be done again; cells of the map
RESOLVED = 2.2  # windows, rms: radius of a contact whose depth is measured
_HIDDEN = 10.0  # sigma at rest: of a height that is interpolated

_Found = tuple[tuple[float, float, float], float]  # circle and depth of a contact, mm


class Live:
    """Readings of frames in order of time. Each is fitted from rest; a contact keeps the identity of the
    nearest one in the frame before."""

    def __init__(self, prepared: Prepared) -> None:
        self.restart(prepared)

    def restart(self, prepared: Prepared) -> None:
        """Begin anew, with another rest."""
        self.prepared, self._faded = prepared, 0
        self._touches = Touches()
        self.creep: RigMotion = rig_motion(prepared.rig, prepared.points)

    @blas_on_one()
    def update(self, frame: Frame, time: float = 0.0) -> Reading:
        """The reading of a frame (H, W) of the camera, taken at `time` (s): heights less what the rig and the
        anchor moved, and the contacts in them. InputError for a wrong size or type."""
        prepared, rig, frame = self.prepared, self.prepared.rig, self._used(frame)
        settled, strays = settle_without_strays(rig, frame, prepared.noise.sigma)
        good, raw, slopes = settled.good, settled.tau * rig.normal, settled.slopes
        late, early = _smoothed(prepared, settled)
        deviation, alone = self._deviation(settled, raw, _sigma(prepared, settled, late))
        if (np.abs(deviation.motion) > CREPT * deviation.sigmas[:3]).any():  # what is left is the mirror's
            slopes = slopes - np.tensordot(deviation.motion, self.creep.slopes, 1)
        fine, coarse = (circulations(slopes, good & rig.whole) / prepared.noise.curl).tolist()
        noise, wide = (_sigma(prepared, settled, lost, max(1.0, fine, coarse)) for lost in (late, early))
        steep, dusty = holes_of(raw, prepared.noise.sigma, good, rig.lit, rig.rim)
        figures = self._figures(frame, settled, (fine, coarse), deviation)
        self._faded = self._faded + 1 if figures.contrast < FADED else 0
        x, y = (prepared.points[i] + settled.tau * rig.mirror.planes[3 + i] for i in (0, 1))
        moved = deviation.heights(self.creep)
        z = raw + moved
        modes = np.float32(deviation.growth) * deviation.modes(self.creep)
        sigma = np.sqrt(np.square(wide) + np.square(modes).sum(axis=0))
        hidden = np.where(good, noise, np.float32(_HIDDEN) * prepared.noise.sigma)
        surface = Surface(x, y, z, hidden, good, modes=modes, motions=len(modes))
        dents = () if judge(figures).broken else regions(surface, _COLUMNS)
        pressing = [one for one in dents if not _is_dust(one, dusty, good)]
        lost = _lost_in_kinks(prepared, settled, early, z, pressing)
        sigma = np.sqrt(np.square(sigma) + np.square(lost).sum(axis=0))
        error, still = np.float32(prepared.error or 0.0), max(prepared.edge, abs(figures.sinking))
        surface = replace(surface, modes=np.stack([error * z, *lost, *modes]))
        verdict = judge(figures, self._faded, steep and not pressing, _share(dusty, rig.lit), strays)
        touches = self._touches.named(_touching(prepared, surface, pressing) if verdict.trusted else ())
        # far from rest the fit's first order makes dents of its own
        free = not pressing or (not verdict.trusted and alone < UNEXPLAINED)
        total = np.sqrt(np.square(sigma) + np.float32(still**2) + np.square(error * z))
        return Reading(
            z=z, sigma=sigma, total_sigma=total, noise=noise, moved=moved, good=good, x=x, y=y,
            trusted=verdict.trusted, reason=verdict.reason, notices=verdict.notices, figures=figures,
            time=time, tareable=free and not verdict.broken, touches=touches, forces=forces_of(touches),
        )  # fmt: skip

    def _deviation(self, settled: Settled, z: Cells, noise: Cells) -> tuple[Deviation, float]:
        """From rest, and the misfit of a motion of the picture alone: contacts and their load in turn, on a
        coarser grid, until no contact comes or goes."""
        prepared = self.prepared
        offset = settled.state.displacement - prepared.rig.rest.displacement
        variance = prepared.noise.displacement * _noise_scale(prepared, settled)
        every = max(1, z.shape[1] // _COLUMNS)
        few = np.s_[::every, ::every]
        x, y = (part[few] for part in prepared.points[:2])
        good, noise = (settled.good & ~prepared.rig.rim)[few], noise[few]
        before: list[_Found] = []
        last, alone = np.zeros_like(noise), math.inf
        for left in reversed(range(_ROUNDS)):
            found = fitted(self.creep, offset, settled.good, before, prepared.layer, variance)
            alone = min(alone, found.misfit if not before else math.inf)
            moved = found.heights(self.creep, every)
            if not left:
                break
            coarse = Surface(x, y, z[few] + moved, noise, good, modes=found.modes(self.creep, every))
            after = [(circle, one.depth) for one in regions(coarse) for circle in one.circles]
            still = float(np.abs(moved - last)[good].max(initial=0.0)) < float(np.median(noise))
            if still and len(before) == len(after):
                break
            before, last = after, moved
        return found, alone

    def _used(self, frame: Frame) -> Frame:
        """The part of the frame in complete cells."""
        shape = self.prepared.rows, self.prepared.cols
        if np.shape(frame) != shape or np.asarray(frame).dtype.kind != "u":
            raise InputError(
                f"frame: {np.asarray(frame).dtype} of {np.shape(frame)}, must be uint8 or uint16 of {shape}; "
                "of other programs: frame.astype(np.uint16)"
            )
        rows, cols = self.prepared.rig.carriers.lit.shape
        return plain(frame[:rows, :cols])

    def _figures(
        self, frame: Frame, settled: Settled, curl: tuple[float, float], deviation: Deviation
    ) -> Figures:
        rig, good, creep = self.prepared.rig, settled.good, self.creep
        few, (along, down, turned, _) = np.s_[::_SPARSE, ::_SPARSE], deviation.parts.tolist()
        full = (frame[few] >= rig.carriers.full)[rig.carriers.lit[few] > 0]
        level = settled.state.level
        sigmas = deviation.sigmas.tolist()
        light = level[few] / np.maximum(rig.rest.level[few], 1)
        return Figures(
            light=float(np.median(light[rig.lit[few]])),
            contrast=float(np.median(settled.contrast[few][good[few]])) if good[few].any() else 0.0,
            saturated=float(np.mean(full)), lost=1 - _share(good, rig.lit),
            anchored=_share(good, rig.mirror.anchor[0] > 0), curl=curl, left=settled.left,
            shift=(along, down), shift_sigma=max(sigmas[:2]), sinking=creep.sinking * along,
            tilt=creep.tilt * along, roll=creep.turn * turned, roll_sigma=creep.turn * sigmas[2],
            misfit=deviation.misfit, noise=float(np.sqrt(settled.usual)), steps=settled.steps,
            used=(1 - settled.jacobian) / (1 - COMPRESSED),
        )  # fmt: skip


def _is_dust(region: Region, dusty: Mask, good: Mask) -> bool:
    """Whether a region is hardly more than a hole to which no flank rises."""
    inside, at = region.inside, region.box
    return bool(np.count_nonzero(inside & dusty[at]) > np.count_nonzero(inside & good[at]))


def _touching(prepared: Prepared, surface: Surface, regions: Sequence[Region]) -> Sequence[Contact]:
    """The contacts; where part of one is not measured, forces and depths are by the field around."""
    layer, fits = prepared.layer, list[ElasticFit | None]()
    least = RESOLVED * prepared.rig.carriers.spread * math.sqrt(prepared.area)
    if any(one.hole or one.cut or one.radius < least for one in regions):
        every = (slice(None, None, math.ceil(math.sqrt(surface.good.size / _FITTED))),) * 2
        x, y, z, sigma = (part[every] for part in (surface.x, surface.y, surface.z, surface.sigma))
        modes, motions = surface.common[:, *every], surface.motions
        few = Surface(x, y, z, sigma, surface.good[every], modes=modes, motions=motions)
        fits, placed = elastic_fits(few, regions, layer, least, thin=False), regions
        for _ in range(_ROUNDS):  # what hides its middle makes a contact look wide and shallow
            before, placed = placed, [_placed(*pair) for pair in zip(regions, fits, strict=True)]
            if not any(one.hole and _apart(one, other) for one, other in zip(before, placed, strict=True)):
                break
            fits = elastic_fits(few, placed, layer, least, thin=False)
        pairs = zip(regions, fits, strict=True)  # a field that fades makes none as deep as what is measured
        fits = [fit if fit and fit.values[3] > _AS_DEEP * one.depth else None for one, fit in pairs]
    found = contacts(surface, regions, layer, fits)
    return [replace(one, depth_at_least=True) if one.radius < least else one for one in found]


def _placed(region: Region, fit: ElasticFit | None) -> Region:
    """A region where its fit is."""
    if fit is None:
        return region
    x, y, radius = fit.values[:3].tolist()
    return replace(region, x=x, y=y, radius=radius, circles=((x, y, radius),))


def _apart(one: Region, other: Region) -> bool:
    away = one.x - other.x, one.y - other.y, one.radius - other.radius
    return math.hypot(*away) > _AWAY * other.radius


def _lost_in_kinks(
    prepared: Prepared, settled: Settled, smoothed: Cells, z: Cells, regions: Sequence[Region]
) -> Cells:
    """Modes (k, R, C), mm, of the regions: what of the slope the window loses at its sharpest kink is lacking
    in all heights within. Beside cells without a height nothing is known of it."""
    reach, lost = prepared.rig.carriers.window.size // 2, np.zeros((len(regions), *z.shape), np.float32)
    apart = cv2.erode(settled.good.astype(np.uint8), np.ones((reach, reach), np.uint8))
    smoothed = smoothed * apart
    for one, mode in zip(regions, lost, strict=True):
        inside = one.inside * apart[one.box]
        sharp = np.square((settled.residual[one.box] * inside).max() / max(_KINK * settled.usual, 1e-6))
        within = np.clip(2 * z[one.box] / np.float32(one.depth) - 1, 0, 1) * one.inside
        mode[one.box] = within * (smoothed[one.box] * inside).max() * (sharp / (1 + sharp))
    return lost


def _share(good: Mask, among: Mask) -> float:
    return float(np.count_nonzero(good & among) / np.count_nonzero(among))


def _noise_scale(prepared: Prepared, settled: Settled) -> float:
    """Variance of the image's noise over that at rest."""
    return max(settled.usual / prepared.rig.noise, _LEAST)


def _sigma(prepared: Prepared, settled: Settled, smoothed: Cells, birge: float = 1.0) -> Cells:
    """Sigma by noise at rest, scaled to this frame's noise and amplitude and by Birge's factor, squared, the
    inconsistency of its slopes; the predicted change by further steps; and what the window still smooths."""
    factor = np.float32(np.sqrt(_noise_scale(prepared, settled) * birge))
    noise = prepared.noise.sigma * factor / np.maximum(settled.strength, _LEAST)
    squares = noise * noise + np.square(settled.ahead) + np.square(smoothed)
    return np.where(settled.good, np.sqrt(squares), np.float32(np.inf))


def _smoothed(prepared: Prepared, settled: Settled) -> tuple[Cells, Cells]:
    """What the window still smooths of z, mm (R, C): a window of variance s^2 cells^2 changes a surface by
    s^2 / 2 times its second differences; steps undo all but a share of that, as the rms residual grows. Then
    with what few steps leave of it, which makes no peak."""
    variance, z = prepared.rig.carriers.spread**2, settled.tau * prepared.rig.normal
    along, down = (np.abs(cv2.Sobel(z, cv2.CV_32F, *order, ksize=1)) for order in ((2, 0), (0, 2)))
    bends = np.float32(variance / 2) * (along + down)
    misfit = np.sqrt(np.maximum(settled.residual / np.float32(max(settled.usual, 1e-6)), 1))
    remains = _REMAINS, max(_REMAINS, _EARLY / settled.steps)
    shares = [np.minimum(np.float32(part) * misfit, np.float32(_MOST)) for part in remains]
    late, early = (np.asarray(bends * share / (1 - share)) for share in shares)  # of the bends as they are
    return late, early
