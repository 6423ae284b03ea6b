"""Effects of a rig or of one capture, each in a module of its own: estimated from a sample of pixels, then
corrected or added to the variance. They never see each other.

    correct(view) -> Correction | None     None where the sample does not show it at a chance of 1e-6: it then
                                           costs nothing

`lag` corrects levels, `motion`, `leak` and `stripes` add to the variance of places, `shared` measures what
pixels have in common.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from optolever.kernels import F64

from ..correspondence import SharedNoise
from ..noise import Noise, Sample
from ..plan import Plan

__all__ = ["Correction", "Effect", "View"]


class Effect(NamedTuple):
    """A row of the profile: name, value and its standard deviation (NaN: not known), unit."""

    name: str
    value: float
    sigma: float
    unit: str = ""


class Correction(NamedTuple):
    """Of one effect: its rows of the profile; variance of the places, px^2, (A,) axes of the
    plan or () all of them; matrix (N, N): levels corrected = matrix @ levels, which the decoder folds into
    the weights of the fringes; noise that pixels have in common."""

    effects: tuple[Effect, ...]
    variance: F64 = np.zeros(())
    matrix: F64 | None = None
    shared: SharedNoise | None = None


class View(NamedTuple):
    """An effect's input.

    plan, noise   of the capture
    sample, wide  lit pixels in runs along rows, linear levels (N, K), NaN: saturated; wide: four times more
    places        (A, K) of a sample by the pixel kernel, pattern px; NaN where a flag is set
    lens          standard deviation of half the second moment of a lens that is not given, px^2
    """

    plan: Plan
    noise: Noise
    sample: Sample
    wide: Sample
    places: Callable[[Sample], F64]
    lens: float
