"""Effects of a rig or of one capture, each in a module of its own: estimated from a sample of pixels, then
corrected or added to the variance. They never see each other.

    estimate(view) -> Effect | None     None where the sample does not show it at a chance of 1e-6: it then
                                        costs nothing
    variance(view, found) -> (A,)       px^2 of each axis of the plan, added to every pixel
    matrix(found, count) -> (N, N)      of lag alone: levels corrected = matrix @ levels; the decoder folds it
                                        into the weights of the fringes, so that it costs no pass over frames

`lag` and `motion` are effects; `shared` measures noise that pixels have in common.
"""

from collections.abc import Callable
from typing import NamedTuple

from optolever.kernels import F64

from ..noise import Noise, Sample
from ..plan import Plan

__all__ = ["Effect", "View"]


class Effect(NamedTuple):
    """A row of the profile: name, value and its standard deviation (NaN: not known), unit."""

    name: str
    value: float
    sigma: float
    unit: str = ""


class View(NamedTuple):
    """An effect's input.

    plan, noise   of the capture
    sample, wide  lit pixels in runs along rows, linear levels (N, K), NaN: saturated; wide: four times more
    places        (A, K) of a sample by the pixel kernel, pattern px; NaN where a flag is set
    """

    plan: Plan
    noise: Noise
    sample: Sample
    wide: Sample
    places: Callable[[Sample], F64]
