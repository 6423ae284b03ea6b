"""Errors of heights and of the depth of a dent by errors of the rig's parameters, on a small image."""

from dataclasses import dataclass, replace

import numpy as np

from optolever.arrays import Floats
from optolever.errors import InputError
from optolever.scene import Covariance, Scene

from .predicted import predicted_maps

__all__ = ["Effects", "effects"]


@dataclass(frozen=True, eq=False)
class Effects:
    """Derivatives by the p unknowns of an adjustment: heights (p, n) in n pixels, and depth (p,) of a dent of
    `peak` mm relative to the mirror at rest; mm per unit of the unknown."""

    heights: Floats
    depth: Floats
    peak: float

    def sigmas(self, covariance: Floats) -> tuple[float, float]:
        """Sigma of a height (median over the mirror) and of the depth (mm), by the unknowns' covariance."""
        variance = np.einsum("pn,pq,qn->n", self.heights, covariance, self.heights)
        heights = np.sqrt(np.maximum(variance, 0.0))  # rounding may leave -1e-20
        return float(np.median(heights)), float(np.sqrt(self.depth @ covariance @ self.depth))


def effects(scene: Scene, by: Floats) -> Effects:
    """Effects for a scene with a covariance; by (q, p): derivatives of its parameters by the unknowns. Each
    parameter is perturbed alone, by its sigma."""
    assert scene.covariance is not None
    own = np.diag(scene.covariance.matrix)
    alone = Covariance(scene.covariance.names, np.diag(own))
    small, height, rest = predicted_maps(replace(scene, covariance=alone))
    assert small.covariance is not None
    assert height.calibration is not None
    assert rest.calibration is not None
    unit = np.sqrt(np.diag(small.covariance.matrix) / own)  # of the small scene's numbers
    by_mode = by.T @ (unit[:, None] * np.linalg.pinv(small.covariance.root))
    both = height.good & rest.good
    if not both.any():
        raise InputError("calibration: the adjusted rig sees no mirror; are the captures of their targets?")
    depth = (height.calibration - rest.calibration)[:, both]
    change = (height.z - rest.z)[both]
    deepest = int(np.argmax(change))
    return Effects(by_mode @ height.calibration[:, both], by_mode @ depth[:, deepest], float(change[deepest]))
