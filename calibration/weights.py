"""The modulus of an elastic layer from height maps under known weights.

Pressure behind a height is proportional to Young's modulus: a map whose force is f for 1 N/mm^2 under a
weight W says E = W / f.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from optolever.contact import Surface, contacts, regions
from optolever.errors import InputError
from optolever.reconstruct import HeightMap
from optolever.scene import Layer

__all__ = ["Weighed", "Weight", "weighed"]

_SQUARES = 2e-3  # of a force: pressure on squares in place of Hertz' (tests/calibration/test_weights.py)


@dataclass(frozen=True, slots=True, eq=False)
class Weight:
    """A map of the height less rest, mm, and the weight on its one contact, N, with sigma."""

    height: HeightMap
    newton: float
    sigma: float = 0.0


@dataclass(frozen=True, slots=True)
class Weighed:
    """The elastic modulus by known weights. layer: with the modulus and its sigma; moduli, sigmas: of each
    map, N/mm^2; chi: rms deviation of the moduli from their mean in sigma, NaN of one map."""

    layer: Layer
    moduli: tuple[float, ...]
    sigmas: tuple[float, ...]
    chi: float


def weighed(layer: Layer, weights: Sequence[Weight]) -> Weighed:
    """The layer with the modulus that known weights measure: the mean over the maps, weighted by inverse
    variance. Errors of the heights count as common to all maps, those of the weights as independent; weights
    that contradict each other widen sigma. InputError of a map without a contact, or a weight that is not
    above 0."""
    unit = replace(layer, youngs_modulus_mpa=1.0, youngs_modulus_sigma_mpa=0.0)
    moduli, by_height, by_weight = (np.zeros(len(weights)) for _ in range(3))
    for k, weight in enumerate(weights):
        if not (0 < weight.newton < math.inf and 0 <= weight.sigma < math.inf):
            raise InputError(
                f"weight: {weight.newton:g} ± {weight.sigma:g} N, must be above 0, sigma at least 0"
            )
        force, sigma = _force(unit, weight.height)
        moduli[k] = weight.newton / force
        by_height[k] = moduli[k] * math.hypot(sigma / force, _SQUARES)
        by_weight[k] = weight.sigma / force
    sigmas = np.hypot(by_height, by_weight)
    share = sigmas**-2 / np.sum(sigmas**-2)
    mean = float(share @ moduli)
    freedom = len(weights) - 1
    chi = math.sqrt(np.sum(((moduli - mean) / sigmas) ** 2) / freedom) if freedom else math.nan
    sigma = math.hypot(share @ by_height, float(np.linalg.norm(share * by_weight)))
    found = replace(
        layer, youngs_modulus_mpa=mean, youngs_modulus_sigma_mpa=sigma * (max(1.0, chi) if freedom else 1.0)
    )
    return Weighed(found, tuple(moduli.tolist()), tuple(sigmas.tolist()), chi)


def _force(unit: Layer, height: HeightMap) -> tuple[float, float]:
    """Force on the deepest contact, N, and its sigma: that of the height, common to the contact."""
    surface = Surface(height.x, height.y, height.z, height.sigma, height.good)
    found = contacts(surface, regions(surface)[:1], unit)
    if not found:
        raise InputError(
            "height map: no point is deeper than six sigma of its height; "
            "press, and give heights less rest (reconstruct --rest)"
        )
    return found[0].force or math.nan, found[0].force_sigma or math.nan
