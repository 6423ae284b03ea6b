"""A press against a rest capture: exchanged ones, pixels that rest lacks; the nearest usable anchor."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lab.live.world import BALL
from optolever import InputError
from optolever.decode import Correspondence, Flag
from optolever.reconstruct import contacts, reconstruct
from optolever.scene import Scene, load, resize, trace
from optolever.scene import dent_from_text as dent

from .conftest import correspondence_of, pressed_half_space

SCENE = resize(load("prism48", exact=True), 60, 80)


def _seen(depth: float, seed: int, x: float = 30.0) -> Correspondence:
    """Under a ball; depth 0: at rest."""
    return pressed_half_space(SCENE, ((BALL, x, 22.0, 4.0, depth),) if depth else (), 0.01, seed)[0]


def test_press_and_rest_exchanged_and_pixels_that_rest_lacks() -> None:
    press, rest = _seen(0.05, 1), _seen(0.0, 2)
    flags = rest.flags.copy()
    flags[:, :3] |= np.uint16(Flag.DARK)
    right = reconstruct(press, SCENE, rest=rest)
    assert not any("below" in str(each) or "no coordinates" in str(each) for each in right.notices)
    turned = reconstruct(rest, SCENE, rest=press)
    (said,) = [str(each) for each in turned.notices if "exchanged" in str(each)]
    assert "reconstruct --rest" in said
    touched = reconstruct(press, SCENE, rest=_seen(0.03, 2, x=42.0))
    (said,) = [str(each) for each in touched.notices if "shows a contact" in str(each)]
    assert "take everything off the mirror" in said
    lacking = reconstruct(press, SCENE, rest=replace(rest, flags=flags))
    (said,) = [str(each) for each in lacking.notices if "no coordinates" in str(each)]
    assert "columns 0 to 2" in said


def test_an_anchor_that_cannot_be_used_names_the_nearest_that_can() -> None:
    press = _seen(0.05, 1)
    inside = np.zeros(press.u.shape, np.bool_)
    inside[10:30, 10:30] = True
    with pytest.raises(InputError, match="the nearest is at ") as refused:
        reconstruct(press, SCENE, anchor=(50.0, 40.0, 0.0), mask=inside)
    x, y = (float(part) for part in str(refused.value).partition("--anchor ")[2].split(",")[:2])
    assert reconstruct(press, SCENE, anchor=(x, y, 0.0), mask=inside).good.any()


DRIFTING = """[mirror]
size_mm = [150.0, 110.0]
[pattern]
size = [1920, 1080]
pitch_mm = 0.2767
origin_mm = [20.5, -210.5, 331.0]
u_axis = [0.0, 1.0, 0.0]
v_axis = [-0.8, 0.0, -0.6]
[camera]
kind = "pinhole"
size = [80, 64]
focal_px = 332.0
position_mm = [{}, {}, {}]
look_at_mm = [{}, 55.0, 0.0]
"""


@pytest.mark.parametrize("hours", [0, 10, 18])
def test_a_camera_that_drifts_beyond_its_prior_hides_no_contact(hours: int, tmp_path: Path) -> None:
    """By 6 um and 2 um of aim an hour: what motion leaves is no far field of the dent."""

    def rig(after: int) -> Scene:
        path = tmp_path / f"{after}.toml"
        numbers = 375 + 0.003 * after, 55 + 0.001 * after, 400 + 0.005 * after, 81.64 + 0.002 * after
        path.write_text(DRIFTING.format(*numbers))
        return load(path)

    def seen(scene: Scene, name: str, seed: int) -> Correspondence:
        return correspondence_of(trace(scene, dent(name, scene)), 0.02, 0.02, seed)

    press = seen(rig(hours), "gaussian:peak=0.02,sigma=10,x=70,y=50", hours)
    (found,) = contacts(reconstruct(press, rig(0), rest=seen(rig(0), "flat", 99)))
    assert abs(found.depth - 0.02) < 2 * found.depth_sigma < 0.02
