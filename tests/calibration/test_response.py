"""Response, blur, vignetting and backlight of ray-traced captures: measured, kept, decoded by."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever import InputError
from optolever.calibration import (
    RigResponse,
    load_response,
    measure_response,
    store_response,
    with_better_fit,
)
from optolever.decode import Response, decode
from optolever.patterns import sequence_from_text
from optolever.projector import Capture, capture
from optolever.scene import Display, Scene, Sensor, Surface, dent_from_text, load, resize, trace

from .area_rays import Area, area_frames, trace_area

F64 = NDArray[np.float64]
POSES = ((0.0, 0.0, 0.0), (2.0, 0.07, 0.02), (-2.0, -0.05, 0.07), (1.0, -0.02, -0.08))


class Bent(Display):
    """A display whose light is an S-curve of its levels."""

    def light(self, levels: F64) -> F64:
        x = np.asarray(levels, np.float64) / 255
        return np.asarray(0.01 + 0.99 * (0.3 * x + 0.7 * x * x * (3 - 2 * x)))


DISPLAYS = {"gamma 2.2": Display(2.2, 0.005), "s": Bent()}


def rig(display: str, blur: float) -> Scene:
    scene = resize(load("monitor-mirror", exact=True), 96, 120)
    return replace(scene, pattern=replace(scene.pattern, blur_px=blur), display=DISPLAYS[display])


def captured(scene: Scene, text: str, pose: int = 0, **sensor: Any) -> tuple[Capture, Area]:
    lift, along, across = POSES[pose]
    x0, y0 = 0.5 * scene.mirror.length, 0.5 * scene.mirror.width
    plane = Surface(
        lambda x, y: lift + along * (x - x0) + across * (y - y0),
        lambda x, y: (np.full_like(x, along), np.full_like(y, across)),
    )
    shown = sequence_from_text(text, scene.pattern.rows, scene.pattern.cols)
    seen = trace_area(scene, plane)
    camera = Sensor(**({"offset": 12.0, "exposure": 0.9, "noise": 1.0} | sensor))
    return Capture(area_frames(seen, scene, shown, camera, pose + 10 * len(shown)), shown), seen


def measured(display: str, blur: float, poses: int) -> RigResponse:
    scene = rig(display, blur)
    ramp, _ = captured(scene, "ramp")
    return measure_response(ramp, [captured(scene, "gray+phase", pose)[0] for pose in range(poses)])


@pytest.fixture(scope="module")
def found() -> RigResponse:
    return measured("gamma 2.2", 0.5, 4)


def test_light_of_the_levels_and_blur(found: RigResponse) -> None:
    np.testing.assert_allclose(found.response.light(), (np.arange(256) / 255) ** 2.2, atol=2e-3)
    gamma, misfit = found.gamma
    assert gamma == pytest.approx(2.2, abs=0.01)
    assert misfit < 1e-3
    assert found.black == pytest.approx(0.005, abs=1e-3)
    assert found.response.blur == pytest.approx(0.5, rel=0.02)
    assert found.blur_sigma < 0.01


def test_no_power_law_and_a_sharp_display() -> None:
    found = measured("s", 0.3, 1)
    light = Bent().light(np.arange(256.0))
    np.testing.assert_allclose(found.response.light(), (light - light[0]) / (1 - light[0]), atol=2e-3)
    assert found.gamma[1] > 0.03
    assert found.response.blur == pytest.approx(0.3, rel=0.05)
    assert found.vignetting is None  # one pose tells the product only


def test_vignetting_and_backlight_are_parted(found: RigResponse) -> None:
    assert found.vignetting is not None
    assert found.backlight is not None
    y, x = (2 * (np.arange(n) + 0.5) / n - 1 for n in (96, 120))
    rows, cols = found.backlight.shape
    v, u = (np.indices((rows, cols)) + 0.5) / np.array([rows, cols])[:, None, None]
    emitted = 1 - 0.3 * ((u - 0.3) ** 2 + (v - 0.6) ** 2) / (0.7**2 + 0.6**2)
    for told, true in ((found.vignetting, 1 - 0.25 * (x * x + y[:, None] ** 2)), (found.backlight, emitted)):
        ratio = np.log(told / true)
        assert np.isfinite(ratio).mean() > 0.3
        assert np.nanmax(np.abs(ratio - np.nanmean(ratio))) < 0.02
        assert np.nanmax(told) == 1


@pytest.mark.parametrize(
    ("display", "text", "blur"),
    [
        ("s", "gray+phase", 0.3),
        ("gamma 2.2", "micro-phase", 0.5),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (
                *((display, "gray+phase", 1.0) for display in DISPLAYS),
                *((display, "phase:steps=3", 0.3) for display in DISPLAYS),
                ("gamma 2.2", "gray+phase", 0.3),
                ("s", "micro-phase", 0.5),
            )
        ),
    ],
)
def test_decoded_by_it(display: str, text: str, blur: float) -> None:
    """No worse than without it, and sigma is true (at a blur of .3 cells up to 1.9 times too wide); frames
    inverted as a camera's are worse."""
    scene = rig(display, blur)
    ramp, _ = captured(scene, "ramp")
    response = replace(Response.from_ramp(ramp.frames, ramp.sequence), blur=blur)
    capture, seen = captured(scene, text)
    error, (least, most) = {}, (0.5, 0.047) if blur == 0.3 else (0.8, 0.04)
    for name, given in (("none", None), ("rig", response), ("inverted", replace(response, blur=None))):
        found = decode(capture.frames, capture.sequence, response=given)
        good = found.good & seen.visible
        off = (found.u - seen.u.mean(-1))[good]
        error[name] = np.sqrt(np.mean(off**2)) if good.mean() > 0.9 * seen.visible.mean() else np.inf
        if name == "rig":
            assert least < np.sqrt(np.mean((off / found.sigma_u[good]) ** 2)) < 1.2
    assert error["rig"] < most
    assert error["rig"] < 1.03 * error["none"]
    assert error["rig"] < 0.85 * error["inverted"]


def test_no_sigma_is_wider_with_it_than_without() -> None:
    """Rows of this camera see few places of their cells: that made v's sigma 2.1 times as wide."""
    scene = resize(load("paper-simulation"), 200, 200)
    scene = replace(scene, display=Display(2.2))
    surface = dent_from_text("gaussian", scene)
    truth = trace(scene, surface)

    def taken(text: str, seed: int) -> Capture:
        shown = sequence_from_text(text, scene.pattern.rows, scene.pattern.cols)
        return capture(scene, surface, shown, noise=1.0, seed=seed)

    fringes = taken("gray+phase", 1)
    response = measure_response(taken("ramp", 2), [fringes]).response
    without, known = (decode(fringes.frames, fringes.sequence, response=one) for one in (None, response))
    good = without.good & known.good & truth.visible
    assert good.mean() > 0.97
    for axis in "uv":
        one, other = (
            ((getattr(each, axis) - getattr(truth, axis))[good], getattr(each, f"sigma_{axis}")[good])
            for each in (without, known)
        )
        assert np.median(other[1]) < 1.02 * np.median(one[1])  # a response has an error of its own
        assert np.std(other[0]) < np.std(one[0])
        assert 0.85 < np.sqrt(np.mean(np.square(other[0] / other[1]))) < 1.15


def test_kept_with_the_rig(found: RigResponse, tmp_path: Path) -> None:
    file = tmp_path / "rig.toml"
    scene = rig("gamma 2.2", 0.5)
    scene.save(file)
    with pytest.raises(InputError, match=r"optolever response"):
        load_response(file)
    path = store_response(file, found)
    load(str(file)).save(file)  # the section stays
    again = load_response(file)
    np.testing.assert_array_equal(again.response.light(), found.response.light())
    assert again.response.blur == found.response.blur
    for name in ("gain", "vignetting", "backlight"):
        np.testing.assert_array_equal(getattr(again, name), getattr(found, name))
    path.write_bytes(b"no")
    with pytest.raises(InputError, match=path.name):
        load_response(file)
    store_response(file, measured("gamma 2.2", 0.5, 0))  # a ramp alone has no blur
    assert "nan" not in file.read_text()


def test_bad_input() -> None:
    scene = rig("gamma 2.2", 0.5)
    ramp, _ = captured(scene, "ramp")
    bright, _ = captured(scene, "ramp", exposure=9.0)
    fringes, _ = captured(scene, "gray+phase")
    small = Capture(fringes.frames[:, :50], fringes.sequence)
    coarse, _ = captured(scene, "ramp:count=2")
    for first, others, told in (
        (fringes, [], "shows 2 levels, must show 3"),
        (coarse, [], "shows 2 levels, must show 3"),
        (bright, [], "clip at 255"),
        (Capture(ramp.frames // 250, ramp.sequence), [], "no ramp"),
        (ramp, [small], "pixels, the ramp"),
        (ramp, [captured(scene, "gray")[0]], "no fringes"),
    ):
        with pytest.raises(InputError, match=told):
            measure_response(first, others)


def test_a_response_that_the_frames_contradict_makes_no_sigma_wide() -> None:
    """A camera of gamma 1 that is said to have one of 2.2: a sigma ten times wider becomes that of the frames
    as they are, and of the difference."""
    scene = resize(load("prism48", exact=True), 90, 120)
    scene = replace(scene, pattern=replace(scene.pattern, blur_px=0.5))
    shown = sequence_from_text("phase", scene.pattern.rows, scene.pattern.cols)
    flat = dent_from_text("flat", scene)
    taken, truth = capture(scene, flat, shown, noise=1.0, seed=4), trace(scene, flat)
    levels = np.arange(0.0, 256.0)
    wrong = Response(levels, 255 * (levels / 255) ** 2.2 + 1e-3 * levels)
    with_wrong, plain = (decode(taken.frames, shown, response=one) for one in (wrong, None))
    with_wrong = replace(with_wrong, sigma_u=10 * with_wrong.sigma_u, sigma_v=10 * with_wrong.sigma_v)
    found = with_better_fit(with_wrong, plain)
    assert "fit better without the stated response" in found.notices[-1].name
    good = found.good & truth.visible
    for axis in "uv":
        wide, sigma = (np.median(getattr(one, f"sigma_{axis}")[good]) for one in (with_wrong, found))
        assert sigma < wide / 3
        error = (getattr(found, axis) - getattr(truth, axis))[good] / getattr(found, f"sigma_{axis}")[good]
        assert np.sqrt(np.mean(error**2)) < 1.5
    right = Response(levels, levels)
    assert with_better_fit(decode(taken.frames, shown, response=right), plain).notices == ()
