"""Whether the decoder can read the blur of a display's cells off the coordinates, which gather at cells."""

import math

import numpy as np

from .view import Floats, View

__all__ = ["tells_stairs"]

#: As in the decoder: pixels of a run, runs that are looked at; mean phasor up to which one samples the cells
#: evenly; gradient (cells) below which it is flat; sinc of it from which on it tells anything; sum of their
#: squares, and standard errors above zero, from which on all of them do.
RUN, RUNS, EVEN, FLAT, TOLD, WEIGHT, SURE = 32, 512, 0.3, 0.05, 0.15, 1.0, 4.0


def tells_stairs(view: View, axis: str, left: float, noise: Floats) -> bool:
    """Whether stairs of the cells' fundamental `left` stand out of the noise (cells, (H, W)) of an axis."""
    sides = [side[view.visible] for side in view.widths[axis]]
    gradient = max(sides, key=lambda side: float(np.median(side)))
    model = np.sinc(gradient)
    even = (_phasor(gradient) < EVEN) & (_phasor(2 * gradient) < EVEN) & (gradient > FLAT)
    share = np.where(even & (np.abs(model) > TOLD), model**2, 0.0)
    weight = RUNS * float(np.mean(share))
    usual = float(np.median(noise[view.visible]))
    deviation = 2 * math.pi * usual / math.sqrt(2 * RUN)
    return weight >= WEIGHT and left >= SURE * deviation / math.sqrt(weight)


def _phasor(step: Floats) -> Floats:
    """|mean| of a run's phasors of step turns each."""
    low = np.sin(np.pi * step)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.abs(np.sin(RUN * np.pi * step) / (RUN * low))
    return np.where(np.abs(low) > 1e-9, mean, 1.0)
