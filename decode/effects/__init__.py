"""Effects of a rig or of one capture, each in a module of its own: estimated from a sample of pixels, then
corrected or added to the variance. They never see each other.

An effect's `estimate(view)` returns None where the sample does not show it at a chance of 1e-6: it then costs
nothing. Beside it a module has one of

    matrix(estimate, count) -> (N, N)   levels corrected = matrix @ levels (lag); the decoder folds it into
                                        the weights of the fringes, so that it costs no pass over the frames
    variance(view, estimate) -> (A,)    px^2 of each axis of the plan, added to every pixel (cells, motion)
    shared(view) -> SharedNoise         noise that pixels have in common
"""

from typing import NamedTuple, Protocol

from optolever.kernels import F64

from ..frames import Light
from ..noise import Noise, Sample
from ..plan import Plan

__all__ = ["Effect", "Estimate", "View"]


class Estimate(NamedTuple):
    """A row of the profile: name, value and its standard deviation (NaN: not known), unit."""

    name: str
    value: float
    sigma: float
    unit: str = ""


class View(NamedTuple):
    """An effect's input.

    plan, light, noise  of the capture; light: all frames (N, H, W) with their tables
    sample   lit pixels in runs along rows, linear levels (N, K), NaN: saturated
    place, variance  (A, K) of the sample by the pixel kernel, pattern px, px^2; NaN where a flag is set
    """

    plan: Plan
    light: Light
    noise: Noise
    sample: Sample
    place: F64
    variance: F64


class Effect(Protocol):
    """A module of this folder."""

    def estimate(self, view: View) -> Estimate | None:
        """None: not significant."""
