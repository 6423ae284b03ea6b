"""The rig and its mirror since rest: motion of the picture and the load's far field, from one frame.

Outside three radii of the contacts the displacement (du, dv) is, by least squares,

    a shift of the picture along columns and along rows, its roll about the middle,
    and for each contact the far field of a load (`contact.far_field`: its force, moments and size)

A load makes the anchor sink, which counts as at rest; the shift and roll are a camera's that moved. Both come
off the heights. Where more than noise is left, a cell weighs 1 / (1 + r^2 / 4), r: its residual over noise.
Their covariance (A^T A)^-1 is scaled by the scatter of fits of frames at rest, and by what the fit leaves, as
if nine samples were independent. An even sinking of the mirror, or a tilt about its edge, is the same picture
as a shift along columns: `sinking` says how much one pixel is."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from optolever.arrays import Cells, Circle, Floats, Mask
from optolever.contact import far_field, fit
from optolever.scene import Layer

from ..fringe.chain import Rig
from ..fringe.chord import chord_step, slopes_at

__all__ = ["Deviation", "RigMotion", "fitted", "rig_motion"]

_STEP = 0.1  # pixels, turns, mm: of differences
_ROUNDS = 6  # of the coupled equations
_SAMPLES = 2500  # cells of a fit
_FAR = (3.0, 2.0, 1.5)  # radii of a contact, the first that leave enough cells
_FEWEST = 100  # cells
_NEAR = 0.02  # of a radius: differences of the far field
_PRIOR = (0.5, 0.2, 0.2, 0.2, 1.0)  # of a contact's depth: sigma of its terms at its edge
_EXCESS, _INDEPENDENT = 1.3, 9.0  # variance over noise that counts as misfit; its independent samples
_REWEIGHTED, _KEPT = 5, 0.842  # fits, each by the residuals of the last; of the noise's variance so weighted


@dataclass(frozen=True, slots=True, eq=False)
class RigMotion:
    """What motions of the picture do: a shift by a pixel along columns, along rows, a roll of `turn` rad
    (a pixel at the longer sides).

    heights (4, R, C): that take them off, mm, and by an anchor that sinks by 1 mm; slopes (3, 2, R, C): of
    the distance along the ray, mm a cell; at (2, n): cells of the fit; x, y (n,): their places, mm; shapes
    (3, 2, n): displacement, turns; by_height (2, n), by_slope (2, 2, n): displacement by z, turns/mm, by
    dz/dx and dz/dy; anchor (3, m): x, y and weight of the anchor's cells; sinking, tilt: of the mirror, mm,
    rad, that shift the picture by a pixel."""

    heights: Cells
    slopes: Cells
    turn: float
    at: Floats
    x: Floats
    y: Floats
    shapes: Floats
    by_height: Floats
    by_slope: Floats
    anchor: Floats
    sinking: float
    tilt: float


@dataclass(frozen=True, slots=True, eq=False)
class Deviation:
    """From rest, of one frame: parts (4,): shift of the picture along columns and rows, and its roll, pixels
    (a roll's at the longer sides), sinking of the anchor by loads, mm; root (4, 4): of the covariance of
    these by noise; misfit: rms residual over noise; growth: of the sigmas by it."""

    parts: Cells
    root: Cells
    misfit: float
    growth: float

    @property
    def sigmas(self) -> Cells:
        """Of the parts (4,)."""
        return np.asarray(self.growth * np.linalg.norm(self.root, axis=1))

    @property
    def motion(self) -> Cells:
        """Of the picture: shift and roll (3,), pixels."""
        return self.parts[:3]

    def heights(self, creep: RigMotion, every: int = 1) -> Cells:
        """To be added to the heights of every so many cells (r, c), mm."""
        return np.asarray(np.tensordot(self.parts, creep.heights[:, ::every, ::every], 1))

    def modes(self, creep: RigMotion, every: int = 1) -> Cells:
        """Heights (4, r, c) by independent errors of one standard deviation by noise, mm."""
        return np.asarray(np.tensordot(self.root.T, creep.heights[:, ::every, ::every], 1))


def rig_motion(rig: Rig, points: Cells) -> RigMotion:
    """points (3, R, C): of the mirror at rest, mm."""
    rows, cols = rig.lit.shape
    turn = 2 / max(rows, cols) / rig.carriers.cell
    shifts = rig.gradient.reshape(2, 2, rows, cols) / np.float32(rig.carriers.cell)
    shapes = np.stack([*shifts, np.float32(turn) * _roll(rig)])
    heights, slopes = zip(*(_solved(rig, shape) for shape in shapes), strict=True)
    anchor = rig.mirror.anchor[0]
    used = anchor > 0
    weight = float((anchor * rig.mirror.factor).sum())
    free = rig.mirror.factor * rig.normal * np.float32(1 / weight)
    # of height z the distance along the ray is z / normal; the anchor's mean of it is what counts
    places = np.stack([points[0][used], points[1][used], anchor[used] / rig.normal[used]]).astype(np.float64)
    at = _sampled(rig)
    by_height, by_slope = _by_heights(rig, points, at)
    x, y = (points[k][*at].astype(np.float64) for k in (0, 1))
    sampled = shapes[:, :, *at].astype(np.float64)
    tilted = by_height * (x.max() - x) - by_slope[:, 0]
    sinking, tilt = (float(np.vdot(sampled[0], one) / np.vdot(one, one)) for one in (by_height, tilted))
    sizes = abs(sinking), abs(tilt)
    planes = np.stack([*(-height for height in heights), free])
    return RigMotion(planes, np.stack(slopes), turn, at, x, y, sampled, by_height, by_slope, places, *sizes)


def fitted(
    creep: RigMotion,
    offset: Cells,
    good: Mask,
    contacts: Sequence[tuple[Circle, float]],
    layer: Layer | None,
    noise: Iterable[float],
) -> Deviation:
    """offset (2, R, C): displacement from rest, turns; contacts: circles and depths, mm; noise: variance of
    the displacement of a cell, and what of it a fit of all cells keeps, turns^2."""
    circles, depths = [circle for circle, _ in contacts], [depth for _, depth in contacts]
    use = _outside(creep, good, circles)
    parts = np.concatenate([creep.shapes[:, :, use], _loads(creep, layer, circles, use)])
    columns = parts.reshape(len(parts), -1)
    right = offset[:, *creep.at][:, use].astype(np.float64).ravel()
    variance, kept = (float(part) for part in noise)
    prior = np.append(np.zeros(3), _inverse_priors(layer, circles, depths))
    weights, rests = np.ones(right.size), list[float]()
    for _ in range(_REWEIGHTED if circles else 1):
        root = np.sqrt(weights / kept)
        found, inverse, left = fit(columns * root, (right * root)[None], prior)
        squares = np.square(right - found[:, 0] @ columns)
        rests.append(left**2 * kept / float(weights.sum()) if right.size else math.inf)
        if not _EXCESS * variance < (rest := rests[-1] / (_KEPT if rests[1:] else 1.0)) < math.inf:
            break
        weights = np.tile(1 / (1 + squares.reshape(2, -1).mean(axis=0) / (4 * variance)), 2)
    excess = max(rest - _EXCESS * variance, 0.0) / kept * right.size / _INDEPENDENT
    moves = np.zeros((4, len(columns)))
    moves[:3, :3] = np.eye(3)
    moves[3, 3:] = _terms(layer, circles, creep.anchor[0], creep.anchor[1]) @ creep.anchor[2]
    values, vectors = np.linalg.eigh(moves @ inverse @ moves.T)
    root, amounts = vectors * np.sqrt(np.maximum(values, 0)), moves @ found[:, 0]
    misfit, growth = math.sqrt(rests[0] / variance), max(1.0, math.sqrt(excess))
    return Deviation(amounts.astype(np.float32), root.astype(np.float32), misfit, growth)


def _outside(creep: RigMotion, good: Mask, circles: Sequence[Circle]) -> Mask:
    """Cells of the fit (n,) outside the contacts."""
    away = np.full(creep.x.size, np.inf)
    for x, y, radius in circles:
        away = np.minimum(away, np.hypot(creep.x - x, creep.y - y) / radius)
    away[~good[*creep.at]] = 0
    far = next((far for far in _FAR if np.count_nonzero(away > far) >= _FEWEST), _FAR[-1])
    return np.asarray(away > far)


def _inverse_priors(layer: Layer | None, circles: Sequence[Circle], depths: Sequence[float]) -> Floats:
    """Over the standard deviations of the amplitudes of contacts' terms (5 n,), at a place on the edge where
    none is zero."""
    x, y, radius = np.array(circles, np.float64).reshape(-1, 3).T
    size = _terms(layer, circles, x + 0.6 * radius, y + 0.8 * radius)
    each = np.diagonal(size.reshape(len(circles), len(_PRIOR), len(circles)), axis1=0, axis2=2).T
    return np.asarray(np.abs(each) / (np.array(_PRIOR) * np.array(depths)[:, None])).ravel()


def _terms(layer: Layer | None, circles: Sequence[Circle], x: Floats, y: Floats) -> Floats:
    """Heights (5 n, m) at places (m,): the far field, and the flank of a Gaussian dent that fades."""
    if not circles:
        return np.zeros((0, x.size))
    fields = far_field(layer, circles, x, y).reshape(len(circles), 4, x.size)
    q2 = np.array([((x - a) ** 2 + (y - b) ** 2) / radius**2 for a, b, radius in circles])
    return np.concatenate([fields, np.exp2(-q2)[:, None]], axis=1).reshape(5 * len(circles), x.size)


def _loads(creep: RigMotion, layer: Layer | None, circles: Sequence[Circle], use: Mask) -> Floats:
    """Displacements (4 n, 2, m) by far fields of amplitude 1 mm."""
    x, y = creep.x[use], creep.y[use]
    step = _NEAR * min((circle[2] for circle in circles), default=1.0)
    z, east, west, north, south = (
        _terms(layer, circles, x + a * step, y + b * step)
        for a, b in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))
    )
    slope = (east - west) / (2 * step), (north - south) / (2 * step)
    parts = zip((z, *slope), (creep.by_height, *creep.by_slope.swapaxes(0, 1)), strict=True)
    return np.asarray(sum(part[:, None] * by[None, :, use] for part, by in parts))


def _roll(rig: Rig) -> Cells:
    """Displacement (2, R, C) by a turn of the picture about its middle, turns a rad."""
    rows, cols = rig.lit.shape
    wide, high = (float(np.linalg.norm(rig.mirror.planes[k : k + 3, rows // 2, cols // 2])) for k in (6, 12))
    row = (np.arange(rows, dtype=np.float32) - np.float32(rows / 2 - 0.5))[:, None]
    col = np.arange(cols, dtype=np.float32) - np.float32(cols / 2 - 0.5)
    along, down = rig.gradient[:2], rig.gradient[2:]
    return np.asarray(down * (np.float32(wide / high) * col) - along * (np.float32(high / wide) * row))


def _solved(rig: Rig, shape: Cells) -> tuple[Cells, Cells]:
    """Heights and slopes by a displacement (2, R, C), to its first order."""
    trust = rig.lit.astype(np.float32)
    tau: Cells = np.zeros(trust.shape, np.float32)
    slope = np.zeros_like(shape)
    for _ in range(_ROUNDS):
        change, slope = chord_step(rig.mirror, np.asarray(_STEP * shape, np.float32), tau, trust)
        tau = np.asarray(tau + change, np.float32)
    return np.asarray(tau * rig.normal / _STEP, np.float32), np.asarray(slope / _STEP, np.float32)


def _sampled(rig: Rig) -> Floats:
    """Rows and columns (2, n) of the cells of a fit: those with a complete window."""
    every = max(1, round(math.sqrt(rig.lit.size / _SAMPLES)))
    use = np.zeros(rig.lit.shape, np.bool_)
    use[every // 2 :: every, every // 2 :: every] = True
    whole = use & rig.whole
    return np.stack(np.nonzero(whole if whole.any() else use & rig.lit))


def _by_heights(rig: Rig, points: Cells, at: Floats) -> tuple[Floats, Floats]:
    """See RigMotion: the linearised equations at rest, turned round."""
    planes, steps = (part.astype(np.float64) for part in (rig.mirror.planes, rig.mirror.steps))
    zero = np.zeros(rig.lit.shape)

    def change(du: float = 0.0, dv: float = 0.0, tau: float = 0.0) -> Floats:
        one, other = (
            slopes_at(planes, steps, np.stack([zero + s * du, zero + s * dv]), zero + s * tau)
            for s in (1, -1)
        )
        return np.asarray((one - other)[:, *at] / 2e-4)

    tiny = 1e-4
    by_shift = np.stack([change(du=tiny), change(dv=tiny)], axis=1)  # (2 slopes, 2, n)
    by_tau = change(tau=tiny)
    (a, b), (c, d) = by_shift
    inverse = np.stack([[d, -b], [-c, a]]) / (a * d - b * c)  # (2, 2 slopes, n)
    along = 1 / rig.normal.astype(np.float64)
    turned = np.stack([np.gradient(along, axis=axis)[*at] for axis in (1, 0)])
    by_height = np.einsum("dsn,sn->dn", inverse, turned - by_tau * along[*at])
    steps_xy = np.stack(
        [[np.gradient(points[k].astype(np.float64), axis=axis)[*at] for k in (0, 1)] for axis in (1, 0)]
    )
    by_slope = np.einsum("dsn,skn->dkn", inverse, steps_xy * along[*at])
    return by_height, by_slope
