"""The modulus of an elastic layer from height maps under known weights.

Pressure behind a height is proportional to Young's modulus: a map whose force is f for 1 N/mm^2 under a
weight W says E = W / f.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.ndimage

from optolever.contact import forces_on
from optolever.errors import InputError
from optolever.reconstruct import HeightMap
from optolever.scene import Layer

from .arrays import Float

__all__ = ["Weighed", "Weight", "weighed"]

_HALF = 0.5  # of the depth: a contact's area
_SIGNIFICANT = 6.0  # sigma of the height
_SQUARES = 2e-3  # of a force: pressure on squares in place of Hertz' (tests/live/test_weights.py)


@dataclass(frozen=True, slots=True, eq=False)
class Weight:
    """A map of the height less rest, mm, and the weight on its one contact, N, with sigma."""

    height: HeightMap
    newton: float
    sigma: float = 0.0


@dataclass(frozen=True, slots=True)
class Weighed:
    """layer: with the modulus and its sigma; moduli, sigmas: of each map, N/mm^2; chi: rms deviation of the
    moduli from their mean in sigma, NaN of one map."""

    layer: Layer
    moduli: tuple[float, ...]
    sigmas: tuple[float, ...]
    chi: float


def weighed(layer: Layer, weights: Sequence[Weight]) -> Weighed:
    """The layer with the modulus that the weights tell, their mean by inverse variance. Errors of the heights
    count as common to all maps, those of the weights as independent; weights that contradict each other
    widen sigma. InputError of a map without a contact, or a weight that is not above 0."""
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
    """Force of the deepest contact, N, and its sigma: that of the height, common to the contact."""
    grid = height.resample()
    z = np.where(np.isfinite(grid.z), grid.z, 0.0)
    peak = np.unravel_index(int(z.argmax()), z.shape)
    depth, sigma = float(z[peak]), float(grid.sigma[peak])
    if not depth > _SIGNIFICANT * sigma:
        raise InputError(
            f"height map: the deepest point is {depth:.2g} ± {sigma:.2g} mm, must be {_SIGNIFICANT:g} sigma; "
            "press, and give heights less rest (reconstruct --rest)"
        )
    labels, _ = scipy.ndimage.label(z > _HALF * depth)
    rows, cols = np.nonzero(labels == labels[peak])
    circle = (
        grid.x0 + grid.pitch * float(cols.mean()),
        grid.y0 + grid.pitch * float(rows.mean()),
        math.sqrt(rows.size * grid.pitch**2 / math.pi),
    )

    def sampled(values: Float, places: Float, pitch: float) -> Float:
        side = max(1, round(pitch / grid.pitch))
        smooth = scipy.ndimage.uniform_filter(np.nan_to_num(values).astype(np.float64), side)
        at = (places[:, 1] - grid.y0) / grid.pitch, (places[:, 0] - grid.x0) / grid.pitch
        return np.asarray(scipy.ndimage.map_coordinates(smooth, at, order=1, mode="nearest"))

    found = forces_on(unit, [circle], lambda places, pitch: sampled(z, places, pitch))
    moved = found.weights @ sampled(grid.sigma, found.places, found.pitch)
    return float(found.pressure.sum() * found.pitch**2), abs(float(moved[0])) * found.pitch**2
