"""Heights of single frames against an independent renderer's truth: error, sigma, the past."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lab.live.world import BALL, GAUSS, expose
from optolever import InputError
from optolever.decode import Flag
from optolever.design import sensor_maps
from optolever.live import Live, Prepared, Reading, prepare, tared
from optolever.patterns import sequence
from optolever.scene import dent, trace

from .conftest import Dents, Rest, Shot, Truth

SMOOTH = [
    ((GAUSS, 26.0, 22.5, 8.0, 0.05),),
    ((GAUSS, 34.0, 21.0, 8.0, 0.3),),
    ((GAUSS, 30.0, 22.5, 3.0, 0.05),),
    ((GAUSS, 25.0, 15.0, 4.0, 0.06), (GAUSS, 38.0, 30.0, 5.0, 0.08)),
]
CONTACTS = [((BALL, 28.0, 20.0, 4.0, 0.05),), ((BALL, 31.0, 22.0, 4.0, 0.07),)]
#: mm of noise that a frame of 240 x 320 pixels leaves; mm of the picture's motion that a dent of a third of
#: the mirror hides.
FLOOR, HIDDEN = 1.5e-4, 0.002


def _errors(reading: Reading, true: Any) -> tuple[Any, Any]:
    error = (reading.z - true)[reading.good]
    return error, error / reading.sigma[reading.good]


def test_the_independent_renderer_agrees_with_the_trace(rest: Rest) -> None:
    exact = trace(rest.scene, dent("gaussian:peak=0.05,sigma=6,x=30,y=22.5", rest.scene))
    u, v, z, x, _ = rest.world.truth(((GAUSS, 30.0, 22.5, 6.0, 0.05),))
    inner = exact.visible & (x < 53.9)
    for ours, theirs in ((u, exact.u), (v, exact.v), (z, exact.z)):
        assert np.abs(ours - theirs)[inner].max() < 1e-9


@pytest.mark.parametrize("dents", [*SMOOTH, *CONTACTS])
def test_heights_are_right_within_sigma(prepared: Prepared, shot: Shot, truth: Truth, dents: Dents) -> None:
    """Of contacts the window spans twice the millimetres that it spans at 480 x 640."""
    live, ratios = Live(prepared), []
    for seed in range(6):
        reading = live.update(shot(dents, seed))
        error, ratio = _errors(reading, truth(dents))
        assert reading.trusted, reading.reason
        assert reading.good.mean() > 0.97
        ratios.append(np.mean(np.square(ratio)))
        if dents in SMOOTH:
            assert np.median(np.abs(error)) < (HIDDEN if dents[0][3] > 5 else 3 * FLOOR)
            assert np.mean(np.abs(ratio) > 5) < 0.01
        else:
            inner = reading.good & (reading.x > 6)  # towards x = 0 noise grows without bound
            assert (reading.z - truth(dents))[inner].std() < 5e-3 * dents[0][4]
            assert np.abs(error).max() < 0.1 * dents[0][4]
    # an error is a few modes: six frames hold them to 30 %
    assert (0.3 if dents in SMOOTH else 0.5) < np.sqrt(np.mean(ratios)) < 1.5


@pytest.mark.parametrize("radius", [4.0, 5.0])
def test_the_range_said_beforehand_is_that_of_a_ball(rest: Rest, prepared: Prepared, radius: float) -> None:
    """The deepest contact with a height in every cell, by rendered frames; a reading has the share used."""
    said, rng = sensor_maps(rest.scene).numbers()[f"ball_{radius:g}mm_depth_mm"], np.random.default_rng(1)
    live = Live(prepared)
    assert live.update(expose(rest.world.lights((), rest.fringe)[0], rng)).figures.used < 0.02
    for share in (0.4, 0.9, 1.15):
        light = rest.world.lights(((BALL, 30.0, 22.5, radius, share * said),), rest.fringe)[0]
        figures = live.update(expose(light, rng)).figures
        assert (figures.lost > 0, figures.used > 1) == (share > 1, share > 1)


@pytest.mark.parametrize("before", [SMOOTH[0], ((GAUSS, 30.0, 22.0, 2.0, 0.3),)])
def test_the_past_does_not_matter(prepared: Prepared, shot: Shot, before: Dents) -> None:
    """After another dent, or one with a hole, a frame has the same height to the last bit; so has a release,
    in which nothing remains."""
    fresh, after = Live(prepared), Live(prepared)
    for dents in (SMOOTH[1], ()):
        frame = shot(dents, 3)
        after.update(shot(before, 1))
        one, other = fresh.update(frame), after.update(frame)
        assert np.array_equal(one.z, other.z)
        assert np.array_equal(one.sigma, other.sigma)
        assert len(other.touches) == len(dents)


def test_a_prepared_rig_comes_back_from_its_file(prepared: Prepared, shot: Shot, tmp_path: Path) -> None:
    prepared.save(tmp_path / "prepared.npz")
    loaded = Prepared.load(tmp_path / "prepared.npz")
    frame = shot(SMOOTH[0], 1)
    assert Live(loaded).update(frame) == Live(prepared).update(frame)
    assert loaded.layer == prepared.layer


def test_pixels_that_the_rest_map_lacks_are_left_out(rest: Rest, shot: Shot, truth: Truth) -> None:
    flags = rest.rest_map.flags.copy()
    flags[60:110, 100:160] |= Flag.DARK.value
    own = prepare(rest.scene, rest.frames, replace(rest.rest_map, flags=flags), rest.fringe)
    reading = Live(own).update(shot(SMOOTH[0], 1))
    _, ratio = _errors(reading, truth(SMOOTH[0]))
    assert not reading.good[38:47, 58:72].any()  # a window reaches some cells in
    assert reading.good.mean() > 0.9
    assert 0.25 < np.sqrt(np.mean(np.square(ratio))) < 2


def test_a_frame_at_rest_that_is_torn_is_left_out(rest: Rest, shot: Shot, truth: Truth) -> None:
    frames = rest.frames.copy()
    frames[2, :120] = 200
    own = prepare(rest.scene, frames, rest.rest_map, rest.fringe)
    assert ("Frames at rest unlike the others, of 8", 1) in [(one.name, one.size) for one in own.notices]
    _, ratio = _errors(Live(own).update(shot(SMOOTH[0], 1)), truth(SMOOTH[0]))
    assert 0.3 < np.sqrt(np.mean(np.square(ratio))) < 2


def test_a_touch_between_map_and_frames_at_rest_is_said(rest: Rest, shot: Shot) -> None:
    frames = np.stack([shot(((GAUSS, 20.0, 20.0, 3.0, 0.07),), seed) for seed in range(8)])
    said, half_space = prepare(rest.scene, frames, rest.rest_map, rest.fringe).notices
    assert "fringe is elsewhere than by rest_map" in said.name
    assert "forces are of a half-space" in half_space.name


def test_what_does_not_fit_is_one_line(rest: Rest, prepared: Prepared) -> None:
    wrong = sequence("gray+phase", rest.scene.pattern.rows, rest.scene.pattern.cols)
    for frames, shown, cell, words in (
        (rest.frames, wrong, 2, "one crossed fringe"),
        (rest.frames[:1], rest.fringe, 2, "two or more frames"),
        (rest.frames, rest.fringe, 3, "cell = 3: must be one of"),
        (rest.frames[:, :120], rest.fringe, 2, r"rest_frames: \(120, 320\) pixels"),
    ):
        with pytest.raises(InputError, match=words):
            prepare(rest.scene, frames, rest.rest_map, shown, cell=cell)
    other = sequence("crossed", rest.scene.pattern.rows, rest.scene.pattern.cols, period=12.0)
    for frames, shown in ((rest.frames, other), (rest.frames[:, ::-1], rest.fringe)):
        with pytest.raises(InputError, match=r"where rest_map puts it|does not converge"):
            prepare(rest.scene, frames, rest.rest_map, shown)
    coarse = replace(rest.rest_map, sigma_v=np.full_like(rest.rest_map.sigma_v, 18.0))
    with pytest.raises(InputError, match=r"rest_map: 0 % .* known to 0.25 of the fringe's period"):
        prepare(rest.scene, rest.frames, coarse, rest.fringe)
    for few in (np.zeros((240, 320), np.uint8), np.zeros((0, 240, 320), np.uint8)):
        with pytest.raises(InputError, match=r"frames: .* must be \(N, 240, 320\), one or more"):
            tared(prepared, few)
    with pytest.raises(InputError, match=r"frame: uint8 of \(4, 4\)"):
        Live(prepared).update(np.zeros((4, 4), np.uint8))
