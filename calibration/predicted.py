"""What a rig would measure: exact places of a known surface, with the rig's errors, on a small image."""

from __future__ import annotations

import numpy as np

from optolever.errors import InputError
from optolever.reconstruct import HeightMap, PixelAnchor, budget, exact_correspondence, reconstruct
from optolever.scene import Scene, Surface, dent, resize, trace

__all__ = [
    "PREDICTED_DEPTH", "PREDICTED_NOISE", "predicted_budget", "predicted_maps", "sigma_at_rest",
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
