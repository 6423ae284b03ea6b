"""The error of live heights by the rig's numbers, against rigs that are wrong by as much; a prism's edge."""

import math
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from optolever.decode import decode
from optolever.live import Live, Prepared, prepare
from optolever.patterns import Sequence, sequence
from optolever.projector import capture
from optolever.scene import (
    Accuracy,
    Scene,
    TypedRig,
    adjusted,
    dent_from_text,
    load,
    parameter_values,
    rig_toml,
)

MONITOR = TypedRig((150, 110), (240, 320), 1.0, (180, 240), 686.0, math.radians(30), 500, 400)
PRISM = TypedRig(
    (60, 45), (320, 240), 0.19, (180, 240), 576.0, math.radians(50), 120,
    display_angle=math.radians(48), bezel=2.0, index=1.41,
)  # fmt: skip
Typed = Callable[[TypedRig, float], Scene]


@pytest.fixture
def typed(tmp_path: Path) -> Typed:
    def made(rig: TypedRig, focal: float) -> Scene:
        (tmp_path / "rig.toml").write_text(rig_toml("rig", rig))
        zeros = dict.fromkeys((each.name for each in fields(Accuracy)), 0.0)
        return replace(load(tmp_path / "rig.toml"), accuracy=Accuracy(**zeros | {"focal": focal}))

    return made


def measured(true: Scene, dent: str, *typed: Scene) -> list[tuple[Prepared, float, float]]:
    """By each of these descriptions of the true rig: the prepared one, depth of the dent and its total
    sigma."""
    rows, cols = true.pattern.rows, true.pattern.cols
    dense, fringe = sequence("gray+phase", rows, cols), sequence("crossed", rows, cols, period=10.0)

    def frames(text: str, shown: Sequence, seed: int) -> np.ndarray:
        return capture(true, dent_from_text(text, true), shown, renderer="numpy", seed=seed).frames

    rest, pressed = decode(frames("flat", dense, 0), dense), frames(dent, fringe, 9)[0]
    fringes, found = np.concatenate([frames("flat", fringe, k) for k in range(4)]), []
    for scene in typed:
        prepared = prepare(scene, fringes, rest, fringe)
        reading = Live(prepared).update(pressed)
        found.append((prepared, reading.depth, reading.depth_total_sigma))
    return found


def test_a_focal_length_by_tape_is_in_the_total_sigma_of_a_live_height(typed: Typed) -> None:
    scene = typed(MONITOR, 0.05)
    true = adjusted(scene, {"camera.f": 1.05 * parameter_values(scene)["camera.f"]})
    known = replace(true, accuracy=None)
    (prepared, depth, total), (_, right, noise) = measured(true, "gaussian:peak=0.1,sigma=15", scene, known)
    assert prepared.error == pytest.approx(0.05, rel=0.1)
    assert depth / right - 1 == pytest.approx(0.05, rel=0.15)
    assert math.sqrt(total**2 - noise**2) == pytest.approx(0.05 * depth, rel=0.2)


def test_a_camera_that_sees_beyond_a_prism_measures_all_the_same(typed: Typed) -> None:
    """Where mirror and display meet, in cells without light, the equations are singular."""
    scene = typed(PRISM, 0.0)
    ((_, depth, total),) = measured(scene, "gaussian:peak=0.1,sigma=5", scene)
    assert abs(depth - 0.1) < 4 * total
    assert total < 0.005
