"""Projectors unlike what the sequence says: the error bars have to know, and a notice has to say so."""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from optolever.decode import Correspondence, decode
from optolever.patterns import sequence_from_text

from .found import Found
from .hard_case import LIMIT, Case
from .hard_edges import LIT, against_truth
from .layered import Deviation, Layer, World, inside, light, sampled

Floats = NDArray[np.float32]

UNLIKE_CODES = (
    "gray+phase",
    "phase",
    "phase:steps=3,periods=8.73782/8.05745/8",
    "micro-phase",
    "gray",
)
NOISE = 1.0  # rms levels
BEYOND = 0.01  # share of the unflagged pixels that may be off by more than 5 sigma
WIDTH = 4.0  # median sigma over the rms error, at most


#: Deviations; of those of the first list silent errors, width of sigma and a notice are asked for.
JUDGED = {
    "gamma 2.2": Deviation(gamma=2.2),
    "gamma 1.5": Deviation(gamma=1.5),
    "flicker 2 %": Deviation(flicker=0.02),
}
LOOKED_AT = {
    "lag 5 %": Deviation(lag=0.05),
    "lag 20 %": Deviation(lag=0.2),
    "ghost 4 %": Deviation(ghost=0.04),
    "ghost 10 %": Deviation(ghost=0.1),
}
UNLIKE = {"as described": Deviation(), **JUDGED, **LOOKED_AT}


def unlike_cases(size: tuple[int, int]) -> Iterator[Case]:
    """Every deviation with every code, before a smooth wall."""
    for name in UNLIKE:
        limit, share = ("", BEYOND) if name in JUDGED else ("no figure is asked for", LIMIT)
        for code in UNLIKE_CODES:
            make = partial(unlike_found, name, code, size)
            yield Case("unlike", name, code, size, make, NOISE, "uint8", limit, share)


def smooth_world(size: tuple[int, int]) -> World:
    """A tilted, bent wall that fills the image; nearly the whole pattern is seen."""
    rows, cols = size
    pattern = (round(0.9 * rows) + 24, round(0.9 * cols) + 24)
    reach = 0.5 * math.hypot(rows, cols)
    wall = Layer(None, 1.0, (0.05 / reach, -0.1 / reach), 0.3 / reach**2, (0.6, 1.0))
    disparity, baseline = 40.0, 0.3
    origin = (
        0.5 * (pattern[1] - 1) + 1.05 * disparity * math.cos(baseline),
        0.5 * (pattern[0] - 1) + 1.05 * disparity * math.sin(baseline),
    )
    return World(size, pattern, (wall,), 0.9, origin, disparity, baseline)


def unlike_found(name: str, code: str, size: tuple[int, int]) -> Found:
    """Decode what such a projector shows; errors, width of sigma, notices."""
    world, rng = smooth_world(size), np.random.default_rng(11)
    sequence, centre = sequence_from_text(code, *world.pattern), sampled(world, 1)
    fine = sampled(world)
    clean = light(world, fine, sequence, UNLIKE[name], rng)
    noise = NOISE * rng.standard_normal(clean.shape, np.float32)
    seen = decode(np.clip(np.rint(clean + noise), 0, 255).astype(np.uint8), sequence)
    u, v = inside(centre.u), inside(centre.v)
    judged = inside(np.asarray(centre.lit & (centre.projected >= LIT)))
    found = against_truth(seen, u, v, judged)
    width = _width(seen, found, u, v)
    if name not in JUDGED:
        return replace(found, width=width)
    # bits are black and white: a gamma does nothing to them
    unsaid = np.abs(clean - light(world, fine, sequence)).max() > NOISE / 10
    return replace(
        found,
        width=width,
        width_limit=WIDTH,
        notices=len(getattr(seen, "notices", ())) if unsaid else None,
    )


def _width(seen: Correspondence, found: Found, u: Floats, v: Floats) -> float:
    """Median sigma over the rms error of the unflagged pixels, of the axis where that is larger."""
    use = found.expected & (found.flags == 0)
    if not use.any():
        return math.nan
    axes = ((seen.u - u, seen.sigma_u), (seen.v - v, seen.sigma_v))
    return max(
        float(np.median(sigma[use]) / np.sqrt(np.mean(np.square(error[use])))) for error, sigma in axes
    )
