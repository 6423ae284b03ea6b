"""Scenes in TOML: the smallest one, round trips, and one line for every way to get it wrong."""

import math
from dataclasses import replace

import numpy as np
import pytest

from optolever import InputError
from optolever.scene import (
    Display,
    Face,
    Medium,
    PinholeCamera,
    Sensor,
    TelecentricCamera,
    dent,
    load,
    preset_names,
    resize,
    trace,
)

MINIMAL = """\
[mirror]
size_mm = [60, 45]
[pattern]
angle_deg = 45
size = [425, 450]
pitch_mm = 0.1
[camera]
angle_deg = 45
size = [100, 75]
pitch_mm = [0.42, 0.6]
"""
RIG = """\
name = "rig"
[mirror]
size_mm = [60, 45]
[pattern]
size = [425, 450]
pitch_mm = 0.1
origin_mm = [1, 2, 3]
u_axis = [0.6, 0, 0.8]
v_axis = [0, 0.998, 0]
[camera]
kind = "pinhole"
size = [100, 75]
focal_px = [110, 120]
distortion = [0.1, 0, 0, 0, 0]
position_mm = [10, 20, 300]
look_at_mm = [30, 20, 0]
"""


@pytest.fixture
def read(tmp_path):
    """load, of a text."""

    def reader(text):
        (tmp_path / "s.toml").write_text(text)
        return load(tmp_path / "s.toml")

    return reader


def test_the_smallest_scene_is_small_and_works(read):
    assert len(MINIMAL.splitlines()) <= 12
    scene = read(MINIMAL)
    assert scene.name == "s"
    assert scene.medium is scene.display is scene.sensor is scene.dent is None
    assert scene.pattern.blur_px == 0
    assert trace(scene, dent("flat", scene)).visible.mean() > 0.95


def test_prism_shorthand_is_the_paper_s_geometry(read):
    scene = read(MINIMAL.replace("angle_deg = 45\nsize = [425", "angle_deg = 50\nsize = [425"))
    a = math.radians(50)
    assert np.allclose(scene.pattern.point(-0.5, -0.5), 0, atol=1e-15)
    assert np.allclose(scene.pattern.point(9.5, -0.5), [math.cos(a), 0, math.sin(a)], atol=1e-14, rtol=0)
    assert np.allclose(scene.pattern.point(-0.5, 9.5), [0, 1, 0], atol=1e-14, rtol=0)
    assert isinstance(scene.camera, TelecentricCamera)
    assert np.allclose(scene.camera.rays_at(-0.5, -0.5)[0], [60, 0, 0], atol=1e-14, rtol=0)


def test_pinhole_looks_at_its_target(read):
    camera = read(RIG).camera
    assert isinstance(camera, PinholeCamera)
    origin, direction = camera.rays_at(37.0, 49.5)
    assert np.allclose(origin, [10, 20, 300])
    assert np.allclose(direction, np.array([20, 0, -300]) / math.hypot(20, 300), atol=1e-15, rtol=0)
    lower = camera.rays_at(38.0, 49.5)[1] - direction
    assert np.allclose(lower[[0, 2]], 0, atol=1e-4)
    assert lower[1] > 0  # rows run along +y


def variants():
    plain, rig = load("prism48"), load("monitor-mirror")
    face = Face((100, 50, 200), (0.1, 0.2, -1), 1.41, 1.1)
    yield from (load(name) for name in preset_names())
    yield resize(load("paper-simulation"), 123, 321)
    yield replace(rig, camera=replace(rig.camera, face=face), name='with "quotes" and é')
    yield replace(
        plain, display=Display(2.2, 0.01), sensor=Sensor(bits=12, noise=0.7, gain_e=40, flicker=0.1)
    )
    yield replace(plain, medium=Medium(1.5, 1.33), dent=None)


@pytest.mark.parametrize("scene", list(variants()), ids=lambda s: s.name.split()[0])
def test_what_is_saved_loads_back_equal(scene, tmp_path):
    path = tmp_path / "scene.toml"
    scene.save(path)
    assert load(path) == scene
    assert [entry.name for entry in tmp_path.iterdir()] == ["scene.toml"]
    load(path).save(tmp_path / "again.toml")
    assert (tmp_path / "again.toml").read_text() == path.read_text()


def test_face_takes_the_mediums_index(read):
    face = "[camera.face]\npoint_mm = [50, 0, 10]\nnormal = [1, 0, 1]\n"
    scene = read(MINIMAL + face + "[medium]\nindex = 1.4\n")
    assert scene.camera.face == Face((50, 0, 10), (1, 0, 1), 1.4)
    with pytest.raises(InputError, match=r"camera\.face\.index is missing"):
        read(MINIMAL + face)


def test_a_panel_with_a_bezel_starts_away_from_the_edge(read):
    """The face of 45 deg rises along (1, 0, 1)/sqrt 2: 2 mm along it, 3 mm across."""
    moved = read(MINIMAL.replace("size = [425", "offset_mm = [2, 3]\nsize = [425")).pattern
    assert np.allclose(moved.point(-0.5, -0.5), [math.sqrt(2), 3, math.sqrt(2)], atol=1e-14, rtol=0)
    along = read(MINIMAL.replace("size = [425", "offset_mm = 2\nsize = [425")).pattern
    assert np.allclose(along.point(-0.5, -0.5), [math.sqrt(2), 0, math.sqrt(2)], atol=1e-14, rtol=0)


def test_a_face_by_its_angle_stands_on_the_cameras_edge(read):
    """It holds the line x = L0, z = 0 and the direction (-cos, 0, sin) in which it rises."""
    face = read(MINIMAL + "[camera.face]\nangle_deg = 50\nindex = 1.4\n").camera.face
    a = math.radians(50)
    for point in ([60, 0, 0], [60, 7, 0], [60 - math.cos(a), 0, math.sin(a)]):
        assert abs((np.array(point) - face.point) @ face.normal) < 1e-14
    assert face.normal[2] > 0


def test_a_focal_length_in_mm_with_the_pixels_pitch(read):
    lens = RIG.replace("focal_px = [110, 120]", "focal_mm = 25\npixel_pitch_mm = [0.005, 0.01]")
    assert read(lens).camera.focal.tolist() == [5000, 2500]
    with pytest.raises(InputError, match=r"camera\.focal_px: excluded by other keys"):
        read(lens + "focal_px = 3\n")
    with pytest.raises(InputError, match=r"camera\.pixel_pitch_mm is missing"):
        read(lens.replace("pixel_pitch_mm = [0.005, 0.01]", ""))


def test_a_telecentric_camera_may_look_at_a_point(read):
    text = (
        MINIMAL.rpartition("angle_deg = 45\n")[0] + "position_mm = [30, 20, 100]\nlook_at_mm = [30, 20, 0]\n"
    )
    camera = read(text + "size = [101, 75]\npitch_mm = [0.4, 0.6]\n").camera
    origin, direction = camera.rays_at(37.0, 50.0)
    assert np.allclose(origin, [30, 20, 100], atol=1e-12)
    assert np.allclose(direction, [0, 0, -1])


#: A scene, a change of it or a line behind it, words of the answer.
MISTAKES = r"""
RIG | pitch_mm = 0.1 -> pitch = 0.1 | pitch is unknown, must be pattern.pitch_mm
RIG | look_at_mm -> look_at | look_at is unknown, must be camera.look_at_mm
RIG | focal_px = [110, 120] -> focal_length = 25 | is unknown, must be camera.focal_mm
RIG | focal_px = [110, 120] -> pitch_mm = 0.005 | is unknown, must be camera.pixel_pitch_mm
RIG | position_mm -> positon_mm | is unknown, must be camera.position_mm
RIG | [camera] -> [camera.face]\nangle = 45\nindex = 1.4\n[camera] | is unknown, must be camera.face.angle_deg
RIG | [camera] -> [medium]\nn = 1.49\n[camera] | is unknown, must be medium.index
RIG | [camera] -> [medum]\nindex = 1.49\n[camera] | is unknown, must be medium
 | -> | mirror is missing, must be given
 | -> x | not readable as TOML
 | -> mirror = 3 | mirror = 3: must be a table
MINIMAL | size_mm -> size | mirror.size is unknown, must be mirror.size_mm
MINIMAL | -> colour = 1 | camera.colour is unknown, must be one of origin_mm, u_axis, v_axis, pitch_mm, size
MINIMAL | -> [light] | light is unknown, must be one of name, dent, exact, mirror
MINIMAL | [60, 45] -> [60] | mirror.size_mm = [60]: must be [length, width]
MINIMAL | [60, 45] -> [60, 0] | mirror.size_mm = 0: must be greater than 0
MINIMAL | [60, 45] -> [60, nan] | mirror.size_mm = nan: must be finite
MINIMAL | [60, 45] -> [1e308, 45] | mirror.size_mm = 1e+308: must be at most 1e+09
MINIMAL | [60, 45] -> [true, 45] | mirror.size_mm = True: must be a number
MINIMAL | pitch_mm = 0.1 -> pitch_mm = 1e-9 | pattern.pitch_mm = 1e-09: must be at least 1e-06
MINIMAL | pitch_mm = 0.1 -> pitch_mm = 1e-4 | = 0.0001: must be at least 0.001 mm | multiply metres by 1000
MINIMAL | pitch_mm = 0.1 -> pitch_mm = 100 | makes the display 45 m large | divide micrometres by 1000
RIG | [0.6, 0, 0.8] -> [0.6, 0, 7.998] | its length is 8.02, must be 1 within 1 % | divide its numbers by 8.02
MINIMAL | -> [layer]\nyoungs_modulus_mpa = 2e5 | layer.youngs_modulus_mpa = 200000: | divide Pa by 1000000
MINIMAL | -> LAYER thickness_mm = 0.012 | = 0.012: must be 0.05 to 1000 | multiply metres by 1000
MINIMAL | -> LAYER youngs_modulus_sigma_mpa = 2 | sigma_mpa = 2: must be at most the modulus, 0.2
MINIMAL | [425, 450] -> [425.5, 450] | pattern.size = 425.5: must be a whole number
MINIMAL | [425, 450] -> [0, 450] | pattern.size = 0: must be 1 to 65536
MINIMAL | [425, 450] -> 425 | pattern.size = 425: must be [cols, rows]
MINIMAL | angle_deg = 45 -> angle_deg = 90 | pattern.angle_deg = 90: must be less than 90
MINIMAL | [pattern] -> [pattern]\norigin_mm = [0, 0, 0] | excluded by other keys of [pattern]; leave it out
MINIMAL | [pattern] -> [pattern]\nblur_px = -1 | pattern.blur_px = -1: must be at least 0
MINIMAL | [camera] -> [camera]\nkind = 'fisheye' | camera.kind = 'fisheye': must be 'tele
MINIMAL | [camera] -> [camera]\nkind = 3 | camera.kind = 3: must be a text
MINIMAL | [camera] -> [camera]\nfocal_px = 3 | camera.focal_px: is of kind = 'pinhole'
MINIMAL | [camera] -> camera = 3\n[x] | x is unknown, must be one of name
MINIMAL | -> [medium] | medium.index is missing
MINIMAL | -> [medium]\nindex = 0 | medium.index = 0: must be greater than 0
MINIMAL | -> [display]\nblack = 1 | display.black = 1: must be less than 1
MINIMAL | -> [sensor]\nshutter_s = 1 | sensor.shutter_s = 1: must be at most frame_s
MINIMAL | -> [sensor]\nbits = 7 | sensor.bits = 7: must be 8 to 16
MINIMAL | -> [sensor]\niso = 100 | sensor.iso is unknown, must be one of bits, noise
MINIMAL | [mirror] -> dent = 'hole'\n[mirror] | dent 'hole': unknown, must be one of flat
MINIMAL | [mirror] -> name = ''\n[mirror] | name = '': must be a text that is not empty
RIG | v_axis = [0, 0.998, 0] -> v_axis = [1, 0, 0] | pattern.v_axis = | perpendicular to u_axis
RIG | v_axis = [0, 0.998, 0] -> v_axis = [0, 0, 0] | pattern.v_axis = | must not be zero
RIG | v_axis = [0, 0.998, 0]\n -> | pattern.v_axis is missing
RIG | look_at_mm = [30, 20, 0] -> look_at_mm = [10, 20, 300] | camera.look_at_mm = | must differ
RIG | -> row_axis = [20, 0, -300] | camera.row_axis = | must not be parallel
RIG | [0.1, 0, 0, 0, 0] -> [0.1] | camera.distortion = [0.1]: must be 5 numbers
RIG | [0.1, 0, 0, 0, 0] -> [-9, 0, 0, 0, 0] | camera.distortion = | two points of the view to one pixel
RIG | look_at_mm = [30, 20, 0]\n -> | camera.u_axis is missing | or rotation_deg, of a camera look_at_mm
"""


@pytest.mark.parametrize("row", MISTAKES.strip("\n").splitlines())
def test_every_mistake_ends_in_one_line_with_the_file(row, read):
    base, change, *words = row.split(" | ")
    scene = {"MINIMAL": MINIMAL, "RIG": RIG}.get(base, "")
    layer = "[layer]\nyoungs_modulus_mpa = 0.2\n"
    old, new = (part.replace(r"\n", "\n").replace("LAYER ", layer) for part in f" {change} ".split("->"))
    with pytest.raises(InputError) as caught:
        read(scene.replace(old.strip(" "), new.strip(" ")) if old.strip(" ") else scene + new.strip(" "))
    assert all(word in str(caught.value) for word in ("s.toml: ", *words))


def test_a_file_that_is_not_there_or_no_text(tmp_path):
    with pytest.raises(
        InputError, match=r"scene 'paper': no such file, and no preset \(presets: monitor-mirror"
    ):
        load("paper")
    with pytest.raises(InputError, match="is a folder, must be a file"):
        load(tmp_path)
    (tmp_path / "b.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"b\.toml: not readable as TOML"):
        load(tmp_path / "b.toml")
