"""float32 in the shaders: rounding must not favour a direction, for averages over an image would show it."""

from dataclasses import replace

import moderngl
import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.patterns import sequence
from optolever.projector.rays import resting_rays
from optolever.scene import Scene, Surface, dent, load, preset_names, surface_from_array, trace

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


@pytest.mark.parametrize("preset", preset_names())
@pytest.mark.parametrize("name", ["flat", "raised-cosine", "gaussian", "ball"])
def test_coordinates_are_not_biased(gl: moderngl.Context, preset: str, name: str) -> None:
    found = errors(strip(preset), dent(name, load(preset)))
    assert np.abs(found.mean(axis=1)).max() < BIAS_PX
    assert np.sqrt(np.mean(found**2)) < RMS_PX


@pytest.mark.parametrize("preset", ["paper-simulation", "monitor-mirror"])
def test_a_mirror_far_from_rest(gl: moderngl.Context, preset: str) -> None:
    """10 mm below: every ray lands elsewhere, and what float32 adds is that much longer."""
    whole = load(preset)
    step = whole.mirror.length / 40
    x, y = np.meshgrid(np.arange(41) * step, np.arange(41) * step)
    height = 10.0 + 0.3 * np.cos(3 * x / whole.mirror.length) * np.cos(4 * y / whole.mirror.length)
    found = errors(strip(preset), surface_from_array(height, 0.0, 0.0, step))
    assert np.abs(found.mean(axis=1)).max() < BIAS_PX
    assert np.sqrt(np.mean(found**2)) < RMS_PX


def edge_on(scene: Scene, tilted: Surface, turn: float) -> Scene:
    """The pattern at `turn` (rad) to the central ray off the resting mirror, 80 mm away along the tilted."""
    camera = part(scene.camera, ROWS // 2, scene.camera.cols // 2, 1, 1)
    direction = resting_rays(replace(scene, camera=camera), np.zeros(1), np.zeros(1)).directions[0]
    seen = trace(replace(scene, camera=camera), tilted)
    normal = seen.normal[0, 0]
    aim = np.array([seen.x[0, 0], seen.y[0, 0], seen.z[0, 0]])
    aim += 80.0 * (direction - 2.0 * (direction @ normal) * normal)
    resting = direction * np.array([1.0, 1.0, -1.0])
    across = np.array([0.0, 1.0, 0.0])
    u_axis = np.cos(turn) * resting + np.sin(turn) * np.cross(across, resting)
    u_axis /= np.linalg.norm(u_axis)
    v_axis = across - u_axis[1] * u_axis
    v_axis /= np.linalg.norm(v_axis)
    pattern = scene.pattern
    origin = aim - 0.5 * pattern.pitch * (pattern.cols * u_axis + pattern.rows * v_axis)
    return replace(scene, pattern=replace(pattern, origin=origin, u_axis=u_axis, v_axis=v_axis))


@pytest.mark.parametrize("preset", ["paper-simulation", "monitor-mirror"])
@pytest.mark.parametrize("turn", [0.0, 1e-9, -0.05])
def test_a_pattern_that_the_resting_mirror_does_not_show(
    gl: moderngl.Context, preset: str, turn: float
) -> None:
    """Resting rays along the pattern's plane give no place to start from; at a glance float32 has 3e-4 px."""
    scene = strip(preset)
    tilted = dent("tilt", scene, slope=0.2)
    found = errors(edge_on(scene, tilted, turn), tilted)
    assert np.sqrt(np.mean(found**2)) < 3e-4
