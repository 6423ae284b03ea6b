"""Corners of the paper's lattice: sub-pixel in the rest frame, tracked into a deformed one.

A corner is a centre of symmetry. Around it, in lattice coordinates x = (s along u, t along v), the image is
E(x + d + q(x)) (1 + g x): E is even, d the distance of the corner from its expected place, q the quadratic
curvature of the map, g a slope of the light. So the odd part of the image is linear in d, q and g, for any
profile and blur of the lines; least squares give d, and the residuals its sigma.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter, map_coordinates, spline_filter

from optolever.errors import InputError
from optolever.files import load_arrays, save_arrays
from optolever.patterns import Sequence, lattice_lines
from optolever.records import Comparable

from .crossed import displaced
from .prior import PatternMap, frame_pair, prior_map

__all__ = ["Crossings", "lattice"]

F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]
#: Largest change of the displacement in its last pass, cycles: the numbers of lines need no more.
_SETTLED = 0.1
#: Distance from the expected place, periods: at half a period the next line is as near.
_FARTHEST = 0.25
#: Patch around a corner: samples along either line, their reach and spacing (periods), t, s.
_SAMPLES = 41
_REACH = 0.47
_SHARE = 2 * _REACH / (_SAMPLES - 1)
_GRID = np.meshgrid(*2 * [np.linspace(-1, 1, _SAMPLES)], indexing="ij")
#: Blurs of the patch (periods) in successive rounds: the first one converges from a quarter of a period.
_BLURS = (0.15, 0.1, 0.0, 0.0)
_BATCH = 500
#: Blur of the image, periods rms: lines' edges too sharp for the camera's pixels would shift less.
_SOFT = 0.03
#: Least share of a patch inside the image; largest share of its variance that deviates from a corner.
_LEAST, _UNLIKE = 0.5, 0.1
#: Darkness of a line's centre below which there is no line.
_LEAST_DARKNESS = 0.15


@dataclass(frozen=True, slots=True, eq=False)
class Crossings(Comparable):
    """K crossings found at rest; `now` is NaN and `sigma` inf where a crossing is lost in the deformed frame.

    index  (K, 2) numbers of the lines along u and v      pattern  (K, 2) their u, v, pattern pixels
    rest   (K, 2) row, col at rest, camera pixels          now      (K, 2) row, col in the deformed frame
    sigma, sigma_rest  (K, 2) standard deviations of row, col, camera pixels
    """

    index: NDArray[np.int64]
    pattern: F64
    rest: F64
    now: F64
    sigma: F64
    sigma_rest: F64

    @property
    def found(self) -> NDArray[np.bool_]:
        """True where the crossing was found in both frames, (K,)."""
        return np.asarray(np.isfinite(self.now).all(axis=1))

    def save(self, path: str | Path) -> None:
        """Write an .npz with the fields' names."""
        save_arrays(path, {field.name: getattr(self, field.name) for field in fields(self)})

    @classmethod
    def load(cls, path: str | Path) -> Crossings:
        """Read what save() wrote."""
        names = [field.name for field in fields(cls)]
        arrays = load_arrays(path, names)
        return cls(**{name: arrays[name] for name in names})


def lattice(
    frames: ArrayLike, rest: ArrayLike, sequence: Sequence, *, prior: PatternMap | None = None
) -> Crossings:
    """Crossings of the lattice in `frames`, each matched to the same one in `rest`.

    frames, rest  (N, H, W) as the sequence describes them, or the lattice frame alone, (H, W)
    prior         u and v at rest, to a quarter of the lattice's period (a trace, a decoded capture);
                  default: the surface fills the frame, u along columns, v along rows

    A crossing is matched by the displacement of the lattice's first harmonic, which is a crossed fringe: its
    median in each connected part of the mirror must be within half a period (see crossed).
    """
    frame, image, still = frame_pair(frames, rest, sequence, "lattice")
    lines = lattice_lines(frame, sequence.cols), lattice_lines(frame, sequence.rows)
    period, width = frame.period_px or 1.0, frame.width_px or 1.0
    u, v = prior_map(prior, sequence, still.shape)
    number, start, steps = _expected(u, v, lines, period)
    place, sigma_rest = refined(still, start, steps, period, width)
    seen = np.isfinite(sigma_rest).all(axis=1)
    if not seen.any():
        raise InputError("lattice: no crossing was found in the rest frame; is the prior that frame's?")
    number, place, sigma_rest = number[seen], place[seen], sigma_rest[seen]
    moved = displaced(image, still, (u, v), (sequence.rows, sequence.cols), period, _SETTLED)
    du, dv = (np.where(moved.good, part, np.nan) for part in (moved.du, moved.dv))
    again, start, steps = _expected(u + du, v + dv, lines, period)
    found, sigma_found = refined(image, start, steps, period, width)
    here, there = np.nonzero((number[:, None] == again).all(axis=2))
    now, sigma = np.full(place.shape, np.nan), np.full(place.shape, np.inf)
    now[here], sigma[here] = found[there], sigma_found[there]
    pattern = np.stack([line[own] for line, own in zip(lines, number.T, strict=True)], axis=1)
    return Crossings(number, pattern, place, now, sigma, sigma_rest)


def _expected(u: F64, v: F64, lines: tuple[F64, F64], period: float) -> tuple[NDArray[np.int64], F64, F64]:
    """Corners that a map (H, W) predicts: numbers of their lines (K, 2), row and column (K, 2), camera steps
    per pattern pixel of u and v (K, 2, 2). They are found from the nearest pixel by a Newton step of the map.
    """
    coords = np.stack([u, v], axis=-1)
    first, count = (lines[0][0], lines[1][0]), (len(lines[0]), len(lines[1]))
    number = np.rint((coords - first) / period)
    away = first + period * number - coords
    jacobian = np.stack([np.gradient(coords, axis=axis) for axis in (0, 1)], axis=-1)
    jacobian[~np.isfinite(jacobian).all(axis=(2, 3))] = 0.0
    near = (np.abs(away) <= np.abs(jacobian).sum(axis=-1)).all(axis=-1)
    near &= (np.abs(np.linalg.det(jacobian)) > 1e-6) & ((number >= 0) & (number < count)).all(axis=-1)
    number, inverse = number[near].astype(np.int64), np.linalg.inv(jacobian[near])
    step = np.einsum("kij,kj->ki", inverse, away[near])
    order = np.argsort(np.hypot(*step.T), kind="stable")
    nearest = order[np.unique(number[order], axis=0, return_index=True)[1]]
    place = np.argwhere(near) + step
    return number[nearest], place[nearest], inverse[nearest].transpose(0, 2, 1)


def refined(image: NDArray[Any], start: F64, steps: F64, period: float, width: float) -> tuple[F64, F64]:
    """Row and column (K, 2) of the corners near start (K, 2), NaN if there is none, and their sigma.

    steps (K, 2, 2): camera (row, col) per pattern pixel of u and v.
    """
    area = period**2 * np.abs(np.linalg.det(steps))
    soft = _SOFT * math.sqrt(np.median(area)) if len(area) else 0.0
    spline = spline_filter(gaussian_filter(image.astype(np.float64), soft), mode="mirror")
    # opposite samples count once, and so do samples within the blur or a pixel
    each = 0.5 * np.minimum(1, area * _SHARE**2 / max(1.0, 4 * math.pi * soft**2))
    points, sigmas = [start[:0]], [start[:0]]
    for first in range(0, len(start), _BATCH):
        batch = np.s_[first : first + _BATCH]
        point, place = start[batch], np.zeros_like(start[batch])
        for blur in _BLURS:
            patch, inside = _patches(spline, point, steps[batch], period)
            move, spread, there = _centre(patch, inside, period, width, each[batch], blur)
            place += move
            point = start[batch] + np.einsum("ki,kij->kj", place, steps[batch])
        there &= np.hypot(*place.T) < _FARTHEST * period
        sigma = np.sqrt(np.einsum("ki,kij->kj", spread**2, steps[batch] ** 2))
        points.append(np.where(there[:, None], point, np.nan))
        sigmas.append(np.where(there[:, None], sigma, np.inf))
    return np.concatenate(points), np.concatenate(sigmas)


def _patches(spline: F64, point: F64, steps: F64, period: float) -> tuple[F64, Mask]:
    """Image at point + s steps[u] + t steps[v], (K, t, s), and whether it and its opposite are inside."""
    t, s = (_REACH * period * axis for axis in _GRID)
    along, down = steps[:, None, None, 0], steps[:, None, None, 1]
    place = point[:, None, None] + s[..., None] * along + t[..., None] * down
    patch = map_coordinates(spline, np.moveaxis(place, -1, 0), mode="mirror", prefilter=False)
    inside: Mask = np.all((place >= 1) & (place <= np.array(spline.shape) - 2), axis=-1)
    return patch, inside & inside[:, ::-1, ::-1]


def _centre(
    patch: F64, inside: Mask, period: float, width: float, each: F64, blur: float
) -> tuple[F64, F64, Mask]:
    """Corner relative to the middle of its patch, s and t (K, 2), pattern pixels; sigma; whether it exists.

    each: number of independent samples per sample (K,); blur: of the patch, periods.
    """
    t, s = _GRID
    if blur:
        patch = gaussian_filter(patch, blur / _SHARE, axes=(1, 2))
    even, odd = 0.5 * (patch + patch[:, ::-1, ::-1]), 0.5 * inside * (patch - patch[:, ::-1, ::-1])
    down, along = np.gradient(even, _SHARE * period, axis=(1, 2))
    bends = [power * slope for slope in (along, down) for power in (s * s, s * t, t * t)]
    terms = np.stack([along, down, *bends, s * even, t * even], axis=1) * inside[:, None]
    terms, left = terms.reshape(len(patch), terms.shape[1], -1), odd.reshape(len(patch), -1)
    normal = terms @ terms.transpose(0, 2, 1)
    normal += 1e-9 * np.eye(len(bends) + 4) * (1 + np.trace(normal, axis1=1, axis2=2))[:, None, None]
    inverse = np.linalg.inv(normal)
    found = np.einsum("kij,kjn,kn->ki", inverse, terms, left, optimize=True)
    left = left - np.einsum("ki,kin->kn", found, terms)
    misfit = (left**2).sum(axis=1)
    count = each * inside.sum(axis=(1, 2))
    variance = misfit / np.maximum(count - terms.shape[1], 1)
    sigma = np.sqrt(variance[:, None] * np.diagonal(inverse, axis1=1, axis2=2)[:, :2])
    there = (inside.mean(axis=(1, 2)) > _LEAST) & _crossed(patch, even, width / (_REACH * period))
    contrast = (inside * (even - even.mean(axis=(1, 2), keepdims=True)) ** 2).sum(axis=(1, 2))
    return -found[:, :2], sigma, there & (misfit < _UNLIKE * contrast)


def _crossed(patch: F64, even: F64, width: float) -> Mask:
    """Whether both lines, next to their corner, are darker than all four fields between them.

    width: of a line, in halves of a patch.
    """
    t, s = _GRID
    between = [patch[:, (down * t > 0.7) & (along * s > 0.7)] for down in (-1, 1) for along in (-1, 1)]
    light = np.min([field.mean(axis=1) for field in between], axis=0)
    sides = (np.abs(s), np.abs(t)), (np.abs(t), np.abs(s))
    arms = [even[:, (one < width / 4) & (other > 0.5)].mean(axis=1) for one, other in sides]
    return np.asarray(np.max(arms, axis=0) < (1 - _LEAST_DARKNESS) * light)
