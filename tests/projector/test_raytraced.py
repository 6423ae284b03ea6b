"""Rays through pixels' areas: against closed forms of a flat mirror, and against brute force."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import ndtr

from optolever.patterns import Frame, Sequence
from optolever.projector import (
    AreaTrace,
    Lighting,
    VirtualSensor,
    area_frames,
    area_light,
    trace_area,
)
from optolever.scene import Scene, Sensor, dent, load, resize, trace

from .oracle import supersampled

Float = NDArray[np.float64]

FRAMES = (
    Frame("white"),
    Frame("gray", "u", bit=0),
    Frame("gray", "v", bit=1),
    Frame("phase", "u", period_px=8.0, shift=0.7),
    Frame("phase", "v", period_px=5.5, shift=2.0),
)


def rig(name: str = "paper-simulation", size: int = 24, blur: float = 0.5) -> Scene:
    scene = resize(load(name), size, size)
    return replace(scene, pattern=replace(scene.pattern, blur_px=blur))


def shown(scene: Scene, *frames: Frame) -> Sequence:
    return Sequence(frames or FRAMES, scene.pattern.rows, scene.pattern.cols)


@pytest.fixture(scope="module")
def flat() -> AreaTrace:
    scene = rig()
    return trace_area(scene, dent("flat", scene))


def box_mean(levels: Float, at: Float, width: Float, blur: float) -> Float:
    """Mean over boxes (P,) of cells (K,), dark around them, blurred: int ndtr = x ndtr(x) + its density."""
    cells = np.arange(levels.size)

    def below(x: Float) -> Float:
        if blur == 0.0:
            return np.maximum(x, 0.0)
        return np.asarray(x * ndtr(x / blur) + blur * np.exp(-0.5 * (x / blur) ** 2) / np.sqrt(2 * np.pi))

    high, low = (at + sign * width / 2 for sign in (1, -1))
    share = sum(
        sign * (below(high[:, None] - cells - edge) - below(low[:, None] - cells - edge))
        for sign, edge in ((1, -0.5), (-1, 0.5))
    )
    return np.asarray(share @ levels / width)


@pytest.mark.daily(1)
@pytest.mark.parametrize(("blur", "tolerance"), [(0.0, 1 / 36), (0.3, 1.2e-3), (1.0, 4e-5)])
def test_a_flat_mirror_averages_cells_over_a_box(blur: float, tolerance: float) -> None:
    """Telecentric, no dent: every pixel sees the same box, along u by columns and along v by rows."""
    scene = rig(blur=blur)
    frames = shown(scene)
    area = trace_area(scene, dent("flat", scene))
    light = area_light(area, frames)
    table_u, table_v = frames.tables()
    centre = trace(scene, dent("flat", scene))
    u, v = centre.u[0], centre.v[:, 0]
    for index in range(len(frames)):
        along = box_mean(table_u[index] / 255.0, u, np.abs(np.gradient(u)), blur)
        down = box_mean(table_v[index] / 255.0, v, np.abs(np.gradient(v)), blur)
        assert np.abs(light[index] - down[:, None] * along).max() < tolerance


@pytest.mark.daily(1)
@pytest.mark.parametrize("name", ["monitor-mirror", "prism48"])
def test_a_dent_is_the_mean_of_many_rays(name: str) -> None:
    """Pinhole with distortion, total reflection lost: 12 x 12 rays of another program."""
    scene = rig(name, 20)
    surface = dent("gaussian", scene)
    frames = shown(scene)
    light = area_light(trace_area(scene, surface), frames)
    assert np.abs(light - supersampled(scene, surface, frames, 12)).max() < 1.2e-3


def test_pixels_at_the_border_see_a_part() -> None:
    scene = rig()
    cut = replace(scene.pattern, cols=scene.pattern.cols // 2)
    area = trace_area(replace(scene, pattern=cut), dent("flat", scene))
    assert not (area.visible & area.partly).any()
    inside = area.centre.u <= cut.cols - 0.5
    assert (area.visible <= inside).all()
    assert 0 < area.partly.sum() <= 2 * scene.camera.rows
    u, _ = area.mean()
    assert np.nanmax(u) <= cut.cols - 0.5
    assert np.isnan(u[~area.visible & ~area.partly]).all()
    beside = area_light(area, shown(area.scene))[0][~(area.visible | area.partly)]
    assert (beside < 0.5).all()
    assert (beside > 0).any()  # through the blur


def test_the_virtual_sensor_by_rays(monkeypatch: pytest.MonkeyPatch) -> None:
    """In strips and frame by frame, the frames of one trace of the whole area."""
    monkeypatch.setattr("optolever.projector.raytraced._TRACED", 60)
    scene = rig()
    surface, sequence = dent("ridge", scene, angle_deg=30.0), shown(scene)
    sensor = Sensor(offset=16.0, exposure=216.75 / 255)
    whole = area_frames(trace_area(scene, surface), sequence, sensor)
    with VirtualSensor(replace(scene, sensor=sensor), surface, sequence, renderer="rays") as virtual:
        np.testing.assert_array_equal(virtual.capture().frames, whole)
        np.testing.assert_array_equal(virtual.grab(3), whole[3])


def test_lighting_dims_corners_and_the_display(flat: AreaTrace) -> None:
    frames = shown(flat.scene, Frame("white"))
    plain = area_light(flat, frames)[0]
    vignetted = area_light(flat, frames, Lighting(vignetting=0.5))[0] / plain
    assert vignetted[0, 0] == pytest.approx(1 - 0.5 * (23 / 24) ** 2, abs=5e-3)
    assert vignetted.max() == pytest.approx(1.0, abs=2e-3)
    uneven = area_light(flat, frames, Lighting(backlight=0.3, brightest=(0.0, 0.0)))[0] / plain
    assert uneven.max() == pytest.approx(1.0, abs=0.01)
    assert uneven.min() == pytest.approx(0.7, abs=0.03)


def test_dark_current_has_the_shot_noise_of_as_much_light(flat: AreaTrace) -> None:
    frames = shown(flat.scene, Frame("black"))
    sensor = Sensor(bits=16, offset=20.0, exposure=0.5, gain_e=4.0)
    dark = area_frames(flat, frames, sensor, Lighting(dark=10.0)) / 257.0
    assert dark.mean() == pytest.approx(30.0, abs=0.2)
    assert dark.var() == pytest.approx(10.0 / 4.0, rel=0.15)


@pytest.mark.parametrize("blur", [0.0, 0.6])
def test_frames_along_both_axes(blur: float) -> None:
    """Crossed fringes against brute force, whose own error is 1 / 24 without blur."""
    scene = rig("prism48", 20, blur)
    surface, frames = dent("gaussian", scene), shown(scene, Frame("crossed", period_px=7.0))
    area = trace_area(scene, surface)
    light = area_light(area, frames)
    assert np.abs(light - supersampled(scene, surface, frames, 12)).max() < (0.04 if blur == 0 else 1.2e-3)
