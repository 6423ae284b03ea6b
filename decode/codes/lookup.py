"""Look-ups of known levels: stripes, spots; micro-phase, free grey values."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.patterns import Sequence

from ..frames import Light
from ..noise import Noise, Sample
from ..plan import AxisPlan, Plan

__all__ = ["Lines", "lookup_rows", "prepare"]

F32 = NDArray[np.float32]


class Lines(NamedTuple):
    """Output of one axis for rows of an image, each (R, W): place and variance (pattern px, px^2), amplitude and
    offset (levels), error (probability of a wrong place), chi2 (sum of squares over noise) float32; flags int32."""

    place: F32
    variance: F32
    amplitude: F32
    offset: F32
    error: F32
    chi2: F32
    flags: NDArray[np.int32]


def prepare(
    sequence: Sequence,
    plan: Plan,
    axis: AxisPlan,
    light: Light,
    sample: Sample,
    noise: Noise | None,
    blur: float | None,
    on_cells: bool,
) -> Any:
    """Table of an axis, from its description and a sample; noise None: not known, from the table's residuals.
    Has `.dof` (of chi2) and `.jump` (largest difference of neighbours, px)."""
    raise NotImplementedError


def lookup_rows(light: Light, noise: Noise, table: Any, start: int, stop: int, out: Lines) -> None:
    """Decode rows start..stop of the frames into out, which has stop - start rows."""
    raise NotImplementedError
