"""Drawn rigs from frames to height: what errors of neighbouring pixels have in common shows in their sum."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from scipy import ndimage

from optolever.decode import Correspondence
from optolever.errors import InputError
from optolever.reconstruct import reconstruct
from optolever.scene import Trace

from .found import Found, found_height
from .hard_case import Case
from .hard_drawn import rig_case, rig_of, seen_area

__all__ = ["height_cases"]


def height_cases(draws: int, first: int = 0) -> Iterator[Case]:
    """`draws` rigs; a number's rig, its frames and their noise are those of `rig_case`."""
    for number in range(first, first + draws):
        decoded = rig_case(number)
        yield replace(decoded, part="height", name=f"rig {number}", make=partial(_found, number))


def _found(number: int) -> Found:
    rig, code, sensor = rig_of(number)
    seen, area, _ = seen_area(rig.scene, rig.surface, code, sensor, number, rig.lighting)
    height = reconstruct(seen, rig.scene, anchor=_known_point(seen, area.centre))
    return replace(found_height(height, area.centre, 1.0), unit="mm")


def _known_point(seen: Correspondence, truth: Trace) -> tuple[float, float, float]:
    """The true place (mm) on the mirror of the good pixel that is farthest from any that is not."""
    inside = ndimage.distance_transform_cdt(np.pad(seen.good & truth.visible, 1))[1:-1, 1:-1]
    if not inside.any():
        raise InputError("no pixel is good")
    at = np.unravel_index(int(inside.argmax()), inside.shape)
    return float(truth.x[at]), float(truth.y[at]), float(truth.z[at])
