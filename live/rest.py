"""How far the mirror is not at rest where it counts as such: the rig creeps, or a load pulls at the anchor.

A rig that creeps moves the image. The shift of the image near the anchor is measured; what a shift of the
camera by a pixel does to height and slopes is solved once.

Contacts make the surface around them sink (`reconstruct.sink_around`). The anchor, which counts as at rest,
moves that far: all heights with it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from optolever.reconstruct import sink_around
from optolever.scene import Layer

from .arrays import Cells, Float, Mask
from .chain import Rig
from .chord import chord_step, slopes_at
from .contact import Touch

__all__ = ["Creep", "Load", "creep_of", "load_of", "near_anchor", "shift_of"]

_STEP = 0.1  # pixels: of the shift that is solved
_ROUNDS = 6  # of the coupled equations
_WHOLE = 0.99  # share of a window


@dataclass(frozen=True, slots=True, eq=False)
class Creep:
    """Of an image that is shifted by a pixel along columns, along rows: heights (2, R, C), mm; slopes (2, 2,
    R, C): of the distance along the ray, mm a cell; per_tilt, per_height: shift of the image near the anchor
    by a tilt of the mirror, pixels a rad, and by its height, pixels a mm."""

    heights: Cells
    slopes: Cells
    per_tilt: float
    per_height: float


@dataclass(frozen=True, slots=True, eq=False)
class Load:
    """Of contacts: heights (R, C): what all heights are too low by, mm; shift: of the image near the anchor,
    pixels, at most."""

    heights: Cells
    shift: float


def near_anchor(rig: Rig) -> tuple[Mask, Mask]:
    """The anchor's cells; cells next to them whose window is complete (where none is: the anchor's)."""
    anchor, side = rig.mirror.anchor[0] > 0, rig.carriers.window.size + 4
    near = cv2.dilate(anchor.astype(np.uint8), np.ones((side, side), np.uint8)) > 0
    whole = near & (rig.carriers.share > _WHOLE)
    return anchor, np.asarray(whole if whole.any() else anchor)


def shift_of(rig: Rig, offset: Cells, where: Mask) -> Float:
    """Shift of the image along columns and rows (2,), pixels: the median displacement over the rest map's
    gradient. offset (2, R, C): turns less those at rest."""
    if not where.any():
        return np.zeros(2)
    turns = np.median(offset[:, where], axis=1)
    per_cell = np.median(rig.gradient[:, where], axis=1).reshape(2, 2).T.astype(np.float64)
    shift = np.linalg.lstsq(per_cell, turns, rcond=None)[0] * rig.carriers.cell
    return np.asarray(shift, np.float64)


def creep_of(rig: Rig, points: Cells, near: Mask) -> Creep:
    """points (3, R, C): of the mirror at rest; near: see near_anchor."""
    trust, steepest = rig.lit.astype(np.float32), np.inf
    heights: list[Cells] = []
    slopes: list[Cells] = []
    for axis in range(2):
        offset = np.float32(_STEP / rig.carriers.cell) * rig.gradient[2 * axis : 2 * axis + 2]
        tau: Cells = np.zeros(trust.shape, np.float32)
        for _ in range(_ROUNDS):
            change, slope = chord_step(rig.mirror, np.asarray(offset, np.float32), tau, trust)
            tau = np.asarray(tau + change, np.float32)
        heights.append(np.asarray(tau * rig.normal / _STEP, np.float32))
        slopes.append(np.asarray(slope / _STEP, np.float32))
        rise, run = (np.gradient(part, axis=1 - axis)[near] for part in (heights[-1], points[axis]))
        steepest = min(steepest, float(np.median(np.abs(rise / run))))
    return Creep(np.stack(heights), np.stack(slopes), 1 / steepest, _per_height(rig, near))


def _per_height(rig: Rig, near: Mask) -> float:
    """Shift of the image by a mirror that is nearer, of the same slope, pixels a mm."""
    nothing, mirror = np.zeros_like(rig.normal), rig.mirror

    def changed(du: float = 0.0, dv: float = 0.0, tau: float = 0.0) -> Float:
        offset = np.stack([nothing + np.float32(du), nothing + np.float32(dv)])
        found = slopes_at(mirror.planes, mirror.steps, offset, nothing + np.float32(tau)) - mirror.slopes
        return np.asarray(np.median(found[:, near], axis=1) / _STEP, np.float64)

    by_shift = np.stack([changed(du=_STEP), changed(dv=_STEP)], axis=1)
    offset = np.linalg.lstsq(by_shift, -changed(tau=_STEP), rcond=None)[0]
    shift = shift_of(rig, np.broadcast_to(offset[:, None, None], (2, *nothing.shape)), near)
    return float(np.hypot(*shift) / abs(np.median(rig.normal[near])))


def load_of(rig: Rig, points: Cells, creep: Creep, touches: Sequence[Touch], layer: Layer | None) -> Load:
    """The load of contacts on the anchor. layer: elastic; None: a half-space."""
    anchor = rig.mirror.anchor[0]
    used = anchor > 0
    sink, shift = np.zeros(np.count_nonzero(used)), 0.0
    for touch in touches:
        radius = math.sqrt(touch.area / math.pi)
        away = np.hypot(points[0][used] - touch.x, points[1][used] - touch.y).astype(np.float64)
        sink += sink_around(touch.depth, radius, away, layer)
        far, away = sink_around(touch.depth, radius, away, None), np.maximum(away, radius)
        shift += float((creep.per_tilt * far / away + creep.per_height * far).max())
    moved = float((anchor[used] * sink / rig.normal[used]).sum() / (anchor * rig.mirror.factor).sum())
    return Load(np.abs(rig.mirror.factor * rig.normal * np.float32(moved)), shift)
