"""The virtual sensor: GLSL against NumPy float64, and both against brute force with many rays per pixel."""

from dataclasses import replace

import moderngl
import numpy as np
import pytest
from numpy.typing import NDArray

from optolever import InputError
from optolever.patterns import Frame, Sequence
from optolever.projector import WHITE_NOISE_SENSOR, capture
from optolever.samples.metrics import rms
from optolever.scene import (
    Medium,
    Scene,
    Surface,
    dent,
    dent_names,
    preset_names,
    resize,
    surface_from_array,
    trace,
)
from optolever.scene import load as load_preset

from .oracle import part, supersampled

DENTS = [name for name in dent_names() if name != "relief"]
SIZE = 96
SHAPES = (
    Frame("white"), Frame("gray", "u", bit=2), Frame("gray", "v", bit=0),
    Frame("phase", "u", period_px=8.0, shift=0.7), Frame("phase", "v", period_px=16.0, shift=2.0),
    Frame("lattice", period_px=11.0, width_px=2.5), Frame("crossed", period_px=9.0),
)  # fmt: skip


def shown(scene: Scene) -> Sequence:
    """A frame of each way to look up, for the scene's pattern."""
    return Sequence(SHAPES, scene.pattern.rows, scene.pattern.cols)


def levels(frames: NDArray[np.uint16]) -> NDArray[np.float64]:
    """16-bit values in 8-bit levels."""
    return frames.astype(np.float64) * (255 / 65535)


def height_array(scene: Scene) -> Surface:
    pitch = scene.mirror.length / 69
    x, y = np.meshgrid(np.arange(70) / 69, np.arange(60) / 59)
    z = np.exp(-40 * ((x - 0.4) ** 2 + (y - 0.5) ** 2)) + 0.5 * np.sin(3 * x) * np.cos(5 * y)
    return surface_from_array(0.004 * scene.mirror.length * z, 0.0, 0.0, pitch)


def load(name: str) -> Scene:
    """A preset without photon noise: light is compared."""
    return replace(load_preset(name), sensor=WHITE_NOISE_SENSOR)


@pytest.mark.daily(10)
@pytest.mark.parametrize("preset", ["paper-simulation", "monitor-mirror"])
@pytest.mark.parametrize("name", [*DENTS, "array"])
def test_frames_by_glsl_are_numpys(gl: moderngl.Context, name: str, preset: str) -> None:
    scene = resize(load(preset), SIZE, SIZE)
    surface = height_array(scene) if name == "array" else dent(name, scene)
    visible = trace(scene, surface).visible
    one, other = (
        levels(capture(scene, surface, shown(scene), renderer=renderer, bits=16).frames)
        for renderer in ("gl", "numpy")
    )
    assert visible.mean() > 0.9
    assert np.count_nonzero((np.abs(one - other)[0] > 1) & ~visible) <= 2  # in white
    for index in range(len(SHAPES)):
        assert rms((one - other)[index][visible]) < 0.5, SHAPES[index]


@pytest.mark.daily(4)
@pytest.mark.parametrize("preset", preset_names())
@pytest.mark.parametrize("name", ["flat", "raised-cosine", "gaussian", "ball"])
def test_coordinates_are_not_biased(gl: moderngl.Context, preset: str, name: str) -> None:
    """Rows at full width, where coordinates are largest: float32 must not favour a direction."""
    whole = load(preset)
    scene = replace(whole, camera=part(whole.camera, whole.camera.rows // 3, 0, 24, whole.camera.cols))
    shifts = 0.5 * np.pi * np.arange(4)
    fringes = [Frame("phase", axis, period_px=8.0, shift=shift) for axis in "uv" for shift in shifts]
    pattern = Sequence((Frame("white"), *fringes), scene.pattern.rows, scene.pattern.cols)
    seen = [
        capture(scene, dent(name, whole), pattern, renderer=renderer, bits=16).frames.astype(np.float64)
        for renderer in ("gl", "numpy")
    ]
    lit = np.minimum(seen[0][0], seen[1][0]) > 0.9 * seen[1][0].max()
    assert lit.mean() > 0.2
    for first in (1, 5):
        one, other = (np.tensordot(np.exp(1j * shifts), each[first : first + 4], 1)[lit] for each in seen)
        found = np.angle(one / other) * 8.0 / (2 * np.pi)
        assert abs(found.mean()) < 3e-6
        assert rms(found) < 3e-5


def detail(name: str, blur: float, turn: float, row: int) -> tuple[Scene, Surface]:
    """12 x 10 pixels of the full-size scene from a row on, the pattern turned in its plane (rad)."""
    whole = load("paper-simulation")
    u_axis, v_axis = whole.pattern.u_axis, whole.pattern.v_axis
    u_axis, v_axis = (
        np.cos(turn) * u_axis + np.sin(turn) * v_axis,
        np.cos(turn) * v_axis - np.sin(turn) * u_axis,
    )
    pattern = replace(whole.pattern, u_axis=u_axis, v_axis=v_axis, blur_px=blur)
    return replace(whole, pattern=pattern, camera=part(whole.camera, row, 900, 10, 12)), dent(name, whole)


@pytest.mark.daily(4)
@pytest.mark.parametrize(
    ("name", "blur", "turn", "row"),
    [
        ("raised-cosine", 0.5, 0.0, 700),
        ("raised-cosine", 0.5, 0.0, 0),
        ("needle", 0.5, 0.0, 700),
        ("gaussian", 1.5, 0.0, 700),
        ("gaussian", 0.5, 0.5, 700),
        ("raised-cosine", 0.0, 0.0, 700),
        ("raised-cosine", 0.0, 0.5, 700),
    ],
)
def test_frames_are_those_of_many_rays(renderer: str, name: str, blur: float, turn: float, row: int) -> None:
    """On a dent's flank, and at the border, which dims the light. Of sharp patterns rays converge slowly."""
    scene, surface = detail(name, blur, turn, row)
    seen = levels(capture(scene, surface, shown(scene), renderer=renderer, bits=16).frames)
    rays, limit, some = (8, 0.2, SHAPES) if blur else (48, 0.6, SHAPES[:5])
    expected = 16 + 216.75 * supersampled(scene, surface, shown(scene), rays)
    for index, frame in enumerate(some):
        assert rms(seen[index] - expected[index]) < limit, frame
    assert np.ptp(expected[3]) > 100


@pytest.mark.daily(3)
@pytest.mark.parametrize("degrees", [40.0, 44.0, 44.9, 46.0])
def test_fresnel_dims_below_the_critical_angle(renderer: str, degrees: float) -> None:
    """White on a flat mirror at 45 degrees is as bright as Fresnel's formulas with complex cosines say."""
    small = resize(load("paper-simulation"), 24, 24)
    index = 1.0 / np.sin(np.radians(degrees))  # so that 45 degrees is above or below the critical angle
    scene = replace(small, medium=Medium(index))
    seen = levels(capture(scene, dent("flat", scene), shown(scene), renderer=renderer, bits=16).frames)
    cosine = np.cos(np.pi / 4)
    beyond = np.sqrt(complex(1 - index**2 * (1 - cosine**2)))
    s = abs((index * cosine - beyond) / (index * cosine + beyond)) ** 2
    p = abs((cosine - index * beyond) / (cosine + index * beyond)) ** 2
    np.testing.assert_allclose(seen[0, 8:16, 8:16], 16 + 216.75 * 0.5 * (s + p), atol=0.02)


def test_off_the_pattern_and_off_the_mirror_it_is_dark(renderer: str) -> None:
    whole = resize(load("paper-simulation"), 48, 48)
    short = replace(whole, pattern=replace(whole.pattern, cols=20))
    wide = replace(short, camera=part(short.camera, -6, 0, 48, 48))
    frames = capture(wide, dent("flat", wide), shown(wide), renderer=renderer).frames
    visible = trace(wide, dent("flat", wide)).visible
    assert 0.2 < visible.mean() < 0.8
    assert (frames[:, ~visible] == 16).all()
    assert (frames[0][visible] > 16).all()


def test_motion_during_the_exposure_averages(renderer: str) -> None:
    small = resize(load("paper-simulation"), 32, 32)
    scene = replace(small, sensor=replace(WHITE_NOISE_SENSOR, frame_s=0.1, shutter_s=0.08, bits=16))

    def moving(seconds: float) -> Surface:
        return dent("gaussian", scene, x=60.0 + 80.0 * seconds)

    brief = shown(scene)
    brief = replace(brief, frames=brief.frames[3:5])
    seen = capture(scene, moving, brief, renderer=renderer, samples=4).frames.astype(float)
    for index in range(2):
        instants = 0.1 * index + 0.08 * np.array([-0.375, -0.125, 0.125, 0.375])
        stills = [capture(scene, moving(t), brief, renderer=renderer).frames[index] for t in instants]
        np.testing.assert_allclose(seen[index], np.mean(stills, axis=0), atol=1.5)


def test_bad_parameters_are_refused() -> None:
    scene = resize(load("paper-simulation"), 16, 16)
    for changes, words in (
        ({"noise": -1.0}, r"noise.*-1\.0.*at least 0"),
        ({"noise": float("nan")}, "noise.*nan"),
        ({"bits": 7}, "bits.*7.*8 and 16"),
        ({"samples": 0}, "samples.*0"),
        ({"sequence": Sequence(SHAPES, 10, 12)}, r"sequence: made for 10x12 pixels.*16x12"),
    ):
        given = {"sequence": shown(scene), "renderer": "numpy", **changes}
        with pytest.raises(InputError, match=words):
            capture(scene, dent("flat", scene), **given)  # type: ignore[arg-type]


@pytest.mark.parametrize("renderer", ["numpy", "auto"])
def test_a_pixel_sees_where_its_light_comes_from(renderer: str) -> None:
    """Reflectance falls off within pixels: phases by their centres alone are 0.011 px off."""
    scene = resize(load("paper-prototype"), 24, 48)
    scene = replace(scene, pattern=replace(scene.pattern, blur_px=1.0))
    surface, shifts, period = dent("gaussian", scene), np.array([0.0, 2.1, 4.2]), 4.5
    fringes = [Frame("phase", "u", period_px=period, shift=shift) for shift in shifts]
    shown = Sequence((Frame("white"), *fringes), scene.pattern.rows, scene.pattern.cols)
    truth = supersampled(scene, surface, shown, 12)
    seen = (capture(scene, surface, shown, renderer=renderer, bits=16).frames / 257.0 - 16) / 216.75
    inner = np.zeros(truth.shape[1:], np.bool_)
    inner[1:-1, 1:-1] = (np.minimum(truth[0], seen[0]) > 0.02)[1:-1, 1:-1]
    inverse = np.linalg.pinv(np.stack([np.ones(3), np.cos(shifts), np.sin(shifts)], axis=1))
    waves = [np.tensordot(inverse[1] + 1j * inverse[2], each[1:], 1) for each in (seen, truth)]
    off = np.angle(waves[0] / waves[1])[inner] * period / (2 * np.pi)
    assert np.sqrt(np.mean(off**2)) < 0.004
