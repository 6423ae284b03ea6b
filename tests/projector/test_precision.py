"""float32 in the shaders: rounding must not favour a direction, for averages over an image would show it."""

from dataclasses import replace

import moderngl
import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.patterns import sequence
from optolever.scene import Scene, Surface, dent, load, preset_names, trace

from .oracle import part, shader_traced

ROWS = 24
BIAS_PX = 3e-6
RMS_PX = 3e-5


def strip(name: str) -> Scene:
    """Rows of a preset's image at full width, where coordinates are as large as they get."""
    whole = load(name)
    return replace(whole, camera=part(whole.camera, whole.camera.rows // 3, 0, ROWS, whole.camera.cols))


def errors(scene: Scene, surface: Surface) -> NDArray[np.float64]:
    """(2, n): u and v of the shader less those of float64, where both see."""
    seen = shader_traced(scene, surface, sequence("gray", scene.pattern.rows, scene.pattern.cols))
    truth = trace(scene, surface)
    both = (seen[..., 2] > 0) & truth.visible
    assert np.count_nonzero((seen[..., 2] > 0) != truth.visible) <= 2
    assert both.mean() > 0.2
    return np.stack([(seen[..., 0] - truth.u)[both], (seen[..., 1] - truth.v)[both]])


@pytest.mark.daily(4)
@pytest.mark.parametrize("preset", preset_names())
@pytest.mark.parametrize("name", ["flat", "raised-cosine", "gaussian", "ball"])
def test_coordinates_are_not_biased(gl: moderngl.Context, preset: str, name: str) -> None:
    found = errors(strip(preset), dent(name, load(preset)))
    assert np.abs(found.mean(axis=1)).max() < BIAS_PX
    assert np.sqrt(np.mean(found**2)) < RMS_PX
