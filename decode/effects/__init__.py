"""Effects of a rig or of one capture, each in a module of its own: estimated from a sample of pixels, then
corrected or added to the variance. They never see each other.

    estimate(view) -> Effect | None     None where the sample does not show it at a chance of 1e-6: it then
                                        costs nothing
    variance(view, found) -> (A,)       px^2 of each axis of the plan, added to every pixel
    matrix(found, count) -> (N, N)      of lag alone: levels corrected = matrix @ levels; the decoder folds it
                                        into the weights of the fringes, so that it costs no pass over frames

`lag`, `motion` and `cells` (sharp ones) are effects; `shared` measures noise that pixels have in common.
"""

from collections.abc import Callable
from typing import NamedTuple, Protocol

from optolever.kernels import F64

from ..frames import Light, Settings
from ..noise import Noise, Sample
from ..plan import Plan

__all__ = ["Effect", "Module", "View"]


class Effect(NamedTuple):
    """A row of the profile: name, value and its standard deviation (NaN: not known), unit."""

    name: str
    value: float
    sigma: float
    unit: str = ""


class View(NamedTuple):
    """An effect's input.

    plan, light, noise, settings  of the capture; light: all frames (N, H, W) with their tables
    sample, wide  lit pixels in runs along rows, linear levels (N, K), NaN: saturated; wide: four
                 times more
    place, variance  (A, K) of the sample by the pixel kernel, pattern px, px^2; NaN where a flag is set
    places   the same of another sample
    """

    plan: Plan
    light: Light
    noise: Noise
    settings: Settings
    sample: Sample
    wide: Sample
    place: F64
    variance: F64
    places: Callable[[Sample], tuple[F64, F64]]


class Module(Protocol):
    """A module of this folder."""

    def estimate(self, view: View) -> Effect | None:
        """None: not significant."""

    def variance(self, view: View, found: Effect) -> F64:
        """px^2 (A,)."""
