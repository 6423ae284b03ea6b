"""Changes between two scenes: what `adjusted` takes, exactly, after turns of any part."""

from dataclasses import replace

import numpy as np
import pytest

from optolever.scene import Face, Scene, adjusted, load, parameter_changes, parameter_values, resize


def behind_a_face() -> Scene:
    scene = resize(load("monitor-mirror"), 40, 50)
    normal = np.cross(scene.camera.u_axis, scene.camera.v_axis)
    face = Face(scene.camera.origin + 50 * normal, normal, 1.4)
    return replace(scene, camera=replace(scene.camera, face=face))


@pytest.mark.parametrize(
    "scene", [load("prism48"), load("monitor-mirror"), behind_a_face()], ids=["prism", "air", "face"]
)
def test_changes_are_what_adjusted_takes(scene: Scene) -> None:
    rng = np.random.default_rng(0)
    for _ in range(3):
        values = parameter_values(scene)
        pose = {name: 0.2 * rng.standard_normal() for name in values if name.split(".")[1][0] in "xyzr"}
        given = {name: value * rng.uniform(0.9, 1.1) for name, value in values.items()} | pose
        other = adjusted(scene, given)
        found = parameter_changes(scene, other)
        assert found == pytest.approx(given, abs=1e-11, rel=1e-11)
        back = adjusted(other, parameter_changes(other, scene))
        assert back.pattern.origin == pytest.approx(scene.pattern.origin, abs=1e-10)
        assert back.camera.u_axis == pytest.approx(scene.camera.u_axis, abs=1e-13)
