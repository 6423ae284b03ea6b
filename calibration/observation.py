"""A capture of a target, and the pixels of it that the adjustment uses.

A ball or a plate on the mirror is compared with the mirror at rest, pixel by pixel: common errors of both
captures (schlieren, cover glass, bow of the display) cancel to first order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from optolever.arrays import Floats
from optolever.decode import Correspondence
from optolever.errors import InputError

from .contact import FEWEST, contact
from .targets import Ball, Flat, Plate, Rest, Target

__all__ = ["Observation", "Sample", "against_rest", "checked", "frame_of", "sampled"]


_GRID = 40  # rows and columns of the sample
_LEAST_SIGMA = 1e-4  # cells: accuracy limit of the rig's model
_SAME = 5.0  # sigma: two captures whose difference is smaller everywhere are one pose


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """A capture of a target. name: prefix of the names of its unknowns; target: the captured mirror, ball or
    plate; mask (H, W): pixels to use; None: all, or for a ball the contact, detected by comparison with the
    frame's capture."""

    name: str
    target: Target
    correspondence: Correspondence
    mask: NDArray[np.bool_] | None = None

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Good pixels (H, W) in the mask."""
        c = self.correspondence
        good = c.good & np.isfinite(c.u) & np.isfinite(c.v)
        return good if self.mask is None else good & self.mask


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """Pixels (n,) of an observation: row, col, coordinates u, v and their sigmas in cells. reference: the
    mirror at rest; if given, u and v are differences from its capture; inflation: sigmas over the noise."""

    name: str
    target: Target
    row: Floats
    col: Floats
    u: Floats
    v: Floats
    sigma_u: Floats
    sigma_v: Floats
    reference: Rest | None = None
    inflation: float = 1.0

    def thinned(self, count: int) -> Sample:
        """About `count` of its pixels (less than twice as many), at a regular stride."""
        return self.picked(slice(None, None, max(1, self.row.size // count)))

    def picked(self, some: slice | NDArray[np.bool_]) -> Sample:
        """The sample restricted to these pixels."""
        names = ("row", "col", "u", "v", "sigma_u", "sigma_v")
        return replace(self, **{name: getattr(self, name)[some] for name in names})

    def inflated(self, factor: float) -> Sample:
        """The sample with sigmas of `factor` times the noise."""
        by = factor / self.inflation
        return replace(self, sigma_u=by * self.sigma_u, sigma_v=by * self.sigma_v, inflation=factor)


def checked(observations: Sequence[Observation], shape: tuple[int, int]) -> list[Observation]:
    """The observations, balls with a mask. InputError names a wrong capture."""
    if not observations:
        raise InputError("calibration: no capture is left; at least one of Flat or Rest is needed")
    names = [each.name for each in observations]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"capture {name!r}: the name is taken twice")
    for each in observations:
        _require(each, shape)
    _require_different(observations)
    (frame,) = (each for each in observations if each.name == frame_of(observations))
    return [_with_contact(each, frame) for each in observations]


def _with_contact(each: Observation, frame: Observation) -> Observation:
    if each.mask is not None or not isinstance(each.target, Ball):
        return each
    try:
        return replace(each, mask=contact(each.correspondence, frame.correspondence))
    except InputError as error:
        raise InputError(
            f"capture {each.name!r}: beside {frame.name!r} {error}; give a mask of it (...@MASK.png)"
        ) from error


def frame_of(observations: Sequence[Observation]) -> str:
    """The capture whose plane is z = 0: the first at rest, else the first flat."""
    for kind in (Rest, Flat):
        for each in observations:
            if isinstance(each.target, kind):
                return each.name
    raise InputError("calibration: no capture is Flat or Rest; one must say where z = 0 is")


def _require(each: Observation, shape: tuple[int, int]) -> None:
    found = each.correspondence.u.shape
    if found != shape:
        raise InputError(f"capture {each.name!r}: {found} pixels, the scene's camera has {shape}")
    if each.mask is not None and each.mask.shape != shape:
        raise InputError(f"capture {each.name!r}: mask of {each.mask.shape} pixels, must be {shape}")
    count = int(np.count_nonzero(each.usable))
    if count < FEWEST:
        raise InputError(
            f"capture {each.name!r}: {count} usable pixels, must be {FEWEST} or more; is the mirror in view?"
        )


def _require_different(observations: Sequence[Observation]) -> None:
    """InputError where two captures of flats, plates or balls agree within their noise (one pose twice)."""
    posed = [each for each in observations if isinstance(each.target, Flat | Plate | Ball)]
    for i, one in enumerate(posed):
        for other in posed[:i]:
            both = one.usable & other.usable
            if both.sum() < FEWEST:
                continue
            a, b = one.correspondence, other.correspondence
            noise = np.hypot(a.sigma_u, b.sigma_u)[both] + _LEAST_SIGMA
            if np.mean(np.abs(a.u - b.u)[both] <= _SAME * noise) > 0.99:
                raise InputError(
                    f"captures {other.name!r} and {one.name!r}: the same pose twice (within noise); move it"
                )


def sampled(each: Observation) -> Sample:
    """40 x 40 pixels on a grid over the usable ones."""
    usable, c = each.usable, each.correspondence
    lines = [np.flatnonzero(usable.any(axis=1 - axis)) for axis in (0, 1)]
    picked = [np.unique(np.linspace(at[0], at[-1], _GRID).round().astype(int)) for at in lines]
    row, col = (part.ravel() for part in np.meshgrid(*picked, indexing="ij"))
    on = usable[row, col]
    row, col = row[on], col[on]
    if row.size < FEWEST // 2:  # scattered
        row, col = np.nonzero(usable)
        some = np.linspace(0, row.size - 1, min(row.size, _GRID * _GRID)).astype(int)
        row, col = row[some], col[some]
    values = [np.asarray(part[row, col], np.float64) for part in (c.u, c.v, c.sigma_u, c.sigma_v)]
    sigmas = [np.maximum(sigma, _LEAST_SIGMA) for sigma in values[2:]]
    where = row.astype(np.float64), col.astype(np.float64)
    return Sample(each.name, each.target, *where, values[0], values[1], sigmas[0], sigmas[1])


def against_rest(samples: Sequence[Sample], rest: Observation) -> list[Sample]:
    """The samples of balls and plates less the rest capture, where it is usable.

    The noise of the rest capture is common to all K captures that use a pixel. diag(a) + b 1 1^T is at most
    diag(a + K b): the variance of the capture plus K times that of the rest capture is a safe upper bound.
    The sample of the rest capture omits these pixels.
    """
    if not isinstance(rest.target, Rest):
        return list(samples)
    c, usable = rest.correspondence, rest.usable
    posed = {s.name for s in samples if isinstance(s.target, Ball | Plate)}
    counts = np.zeros(usable.shape)
    for sample in samples:
        if sample.name in posed:
            counts[_at(sample)] += 1
    found = []
    for sample in samples:
        some = usable[_at(sample)] if sample.name in posed else counts[_at(sample)] == 0
        few = np.count_nonzero(some) < FEWEST // 2
        if few or sample.name not in posed | {rest.name}:
            found.append(sample)
        elif sample.name == rest.name:
            found.append(sample.picked(some))
        else:
            found.append(_change(sample.picked(some), c, counts, rest.target))
    return found


def _change(sample: Sample, c: Correspondence, counts: Floats, target: Rest) -> Sample:
    at = _at(sample)
    sigmas = {
        name: np.sqrt(
            getattr(sample, name) ** 2 + counts[at] * np.maximum(getattr(c, name)[at], _LEAST_SIGMA) ** 2
        )
        for name in ("sigma_u", "sigma_v")
    }
    return replace(sample, u=sample.u - c.u[at], v=sample.v - c.v[at], reference=target, **sigmas)


def _at(sample: Sample) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    return sample.row.astype(np.intp), sample.col.astype(np.intp)
