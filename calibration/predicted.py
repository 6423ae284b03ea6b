"""What a rig would measure: exact places of a known surface, with the rig's errors, on a small image; errors
of heights and of the depth of a dent by errors of the rig's parameters."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from optolever.arrays import Floats
from optolever.errors import InputError
from optolever.reconstruct import HeightMap, PixelAnchor, budget, exact_correspondence, reconstruct
from optolever.scene import Covariance, Scene, Surface, dent, resize, trace

__all__ = [
    "PREDICTED_DEPTH", "PREDICTED_NOISE", "Effects", "effects", "predicted_budget", "predicted_maps",
    "sigma_at_rest",
]  # fmt: skip

_LINES = 60  # rows of the image
PREDICTED_NOISE = 0.01  # px
PREDICTED_DEPTH, _WIDTH = 1 / 300, 1 / 16  # of the mirror's length: a dent's depth and its sigma


def sigma_at_rest(scene: Scene) -> HeightMap:
    """The mirror z = 0 as this rig would measure it, anchored in the middle of the image: its modes are what
    the rig's errors do to the height."""
    small = _coarse(scene)
    return _measured(small, dent("flat", small), 0.5)


def predicted_maps(scene: Scene) -> tuple[Scene, HeightMap, HeightMap]:
    """The scene on fewer pixels, and two maps as it would measure them: a dent in the middle of the mirror,
    anchored beside it, and the mirror at rest."""
    small = _coarse(scene)
    length = small.mirror.length
    pressed = dent("gaussian", small, peak=PREDICTED_DEPTH * length, sigma=_WIDTH * length)
    return small, _measured(small, pressed, 0.2), _measured(small, dent("flat", small), 0.2)


def predicted_budget(scene: Scene) -> dict[str, dict[str, float]]:
    """Uncertainty of a dent in the middle of the mirror by source, see `reconstruct.budget`."""
    return budget(*predicted_maps(scene)[1:])


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


def _coarse(scene: Scene) -> Scene:
    rows = min(_LINES, scene.camera.rows)
    return resize(scene, rows, max(8, round(rows * scene.camera.cols / scene.camera.rows)))


def _measured(small: Scene, surface: Surface, place: float) -> HeightMap:
    """A surface, anchored where it is, at a share of the image's rows and in the middle of its columns."""
    seen = trace(small, surface)
    visible = np.argwhere(seen.visible)
    if not len(visible):
        raise InputError("this rig sees nothing of the pattern: a capture is not what it is said to be")
    middle = np.array([place, 0.5]) * seen.u.shape
    row, col = visible[np.argmin(np.linalg.norm(visible - middle, axis=1))].tolist()
    anchor = PixelAnchor(row, col, float(seen.z[row, col]))
    return reconstruct(exact_correspondence(seen, PREDICTED_NOISE), small, anchor=anchor)
