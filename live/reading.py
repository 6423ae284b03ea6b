"""Reading: the height, contacts and validity of one frame."""

import math
from dataclasses import dataclass

import numpy as np

from optolever.arrays import Cells, Mask
from optolever.notices import Notice
from optolever.records import Comparable, span

from .touches import Force, Touch

__all__ = ["CREPT", "Figures", "Reading"]

DEEP, KNOWN = 5.0, 3.0  # sigma of a dent's height; noise of its cells'
CREPT = 5.0  # sigma of a shift of the image, beyond which the rig has moved


@dataclass(frozen=True, slots=True)
class Figures:
    """Figures for the verdict on a frame.

    light: level over that at rest; contrast: least of the good cells, over that at rest; saturated: share of
    lit pixels; lost: share of the lit cells without height; anchored: share of the anchor's cells that are
    good; curl: mean square circulation around blocks of 8 and 32 cells, in its sigma; left: predicted typical
    change by further steps, in sigma; shift: of the whole picture from rest, along columns and rows, pixels,
    shift_sigma: of either; sinking: of the mirror, mm, and tilt about its edge, rad, of which each would
    shift the picture as much along columns; roll: of the picture, rad, roll_sigma; misfit: rms displacement
    outside the contacts that neither shift, roll nor loads explain, over noise; noise: rms residual, levels;
    steps: of the fit; used: share of the measurable curvature, at 1 the image folds and cells are lost."""

    light: float
    contrast: float
    saturated: float
    lost: float
    anchored: float
    curl: tuple[float, float]
    left: float
    shift: tuple[float, float]
    shift_sigma: float
    sinking: float
    tilt: float
    roll: float
    roll_sigma: float
    misfit: float
    noise: float
    steps: int
    used: float

    @property
    def moved(self) -> float:
        """Size of the shift, pixels."""
        return math.hypot(*self.shift)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Reading(Comparable):
    """One frame. z (R, C): height less rest, mm, its mean over the exposure, less what a camera that moved
    and a load at the mirror's edge do to it; sigma (R, C): its standard deviation, infinite where it is not
    measured; total_sigma (R, C): with the errors of the rig's numbers, and of a sinking or tilt of the whole
    mirror; noise (R, C): the part of sigma that is not common to the map; moved (R, C): the correction that z
    holds: less the effect of the picture's motion, plus the sinking by loads at the edge; good (R, C): where
    it is measured; x, y (R, C): of the mirror point, mm. trusted: the heights may be used; reason: why not,
    else empty; notices: unusual properties of the frame; time: of the frame, s; tareable: it shows the mirror
    at rest, maybe of a rig that has moved; touches: contacts, see `contact.contacts`, none where it is not
    trusted; forces: of these, where the scene names an elastic layer."""

    z: Cells
    sigma: Cells
    total_sigma: Cells
    good: Mask
    x: Cells
    y: Cells
    trusted: bool
    reason: str
    notices: tuple[Notice, ...]
    figures: Figures
    time: float
    noise: Cells
    moved: Cells
    tareable: bool = False
    touches: tuple[Touch, ...] = ()
    forces: tuple[Force, ...] = ()

    @property
    def deepest(self) -> tuple[float, float] | None:
        """Height and sigma, mm, of the deepest cell beyond three times its noise; None: none is beyond
        five sigma."""
        at = self._deepest
        return None if at is None else (float(self.z.flat[at]), float(self.sigma.flat[at]))

    @property
    def depth_total_sigma(self) -> float:
        """Total sigma of the deepest cell, mm; NaN where none is beyond five sigma."""
        return math.nan if self._deepest is None else float(self.total_sigma.flat[self._deepest])

    @property
    def _deepest(self) -> int | None:
        deep = np.where(self.good & (self.z > KNOWN * self.noise), self.z, np.float32(-np.inf))
        return int(deep.argmax()) if (deep > DEEP * self.sigma).any() else None

    @property
    def depth(self) -> float:
        """Height of the deepest cell, mm; NaN where none is beyond five sigma."""
        return self.deepest[0] if self.deepest else math.nan

    def __repr__(self) -> str:
        rows, cols = self.z.shape
        verdict = "trusted" if self.trusted else f"not trusted: {self.reason}"
        lines = [f"Reading at {self.time:.4f} s: {rows} x {cols} cells, {verdict}"]
        lines.append(f"  z {span(self.z, self.good)}, sigma {span(self.sigma, self.good)} mm")
        return "\n".join(lines + [f"  notices: {len(self.notices)}"] * bool(self.notices))
