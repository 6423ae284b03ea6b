"""Dents: gradients against differences, rest at the camera's edge, defaults, names, text, motion, relief."""

import pickle

import cv2
import numpy as np
import pytest

from optolever import InputError
from optolever.scene import dent, dent_from_text, dent_names, load, resize, trace

NAMES = tuple(name for name in dent_names() if name != "relief")
PRESETS = ("paper-simulation", "prism48", "monitor-mirror")


@pytest.fixture(params=PRESETS)
def scene(request):
    return load(request.param)


@pytest.fixture
def picture(tmp_path):
    """A white disc, left of the middle, in the upper half of a black image."""
    image = np.zeros((200, 300), np.uint8)
    cv2.circle(image, (100, 60), 30, 255, -1)
    cv2.imwrite(str(tmp_path / "disc.png"), image)
    return tmp_path / "disc.png"


def points(scene, count=2000, seed=3):
    rng = np.random.default_rng(seed)
    return rng.uniform(0, scene.mirror.length, count), rng.uniform(0, scene.mirror.width, count)


@pytest.mark.parametrize("name", dent_names())
def test_rest_at_the_cameras_edge(name, scene, picture):
    """Height and slope are zero at x = L0, where a reconstruction takes its anchor; tilt's height only."""
    surface = dent(name, scene, **({"path": str(picture)} if name == "relief" else {}))
    y = np.linspace(0, scene.mirror.width, 50)
    x = np.full_like(y, scene.mirror.length)
    surface = pickle.loads(pickle.dumps(surface))  # as to another process
    limit = 1e-9 if name == "relief" else 1e-14
    assert np.abs(surface.height(x, y)).max() < limit
    if name != "tilt":
        assert np.abs(surface.gradient(x, y)).max() < limit


def test_text_means_the_same_as_the_call(scene):
    text, called = "gaussian:peak=0.4, sigma=7,x=30", dent("gaussian", scene, peak=0.4, sigma=7.0, x=30.0)
    x, y = points(scene, 20)
    for written in (dent_from_text(text, scene), dent(text, scene)):
        assert written.formula == called.formula
        assert np.array_equal(written.height(x, y), called.height(x, y))
    with pytest.raises(InputError, match="'peak' is given twice"):
        dent(text, scene, peak=0.2)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("bump", r"dent 'bump': unknown, must be one of flat, tilt, raised-cosine"),
        ("gaussian:depth=1", r"unknown parameter 'depth': must be one of peak, x, y, sigma"),
        ("flat:peak=1", r"unknown parameter 'peak': must be one of \(none\)"),
        ("gaussian:peak=deep", r"peak is 'deep', must be a number"),
        ("gaussian:peak", r"'peak', must be parameter=value"),
        ("gaussian:peak=1,peak=2", r"peak is given twice"),
        ("gaussian:peak=nan", r"peak = nan: must be finite"),
        ("gaussian:sigma=0", r"sigma = 0\.0: must be greater than 0"),
        ("ball:peak=-1", r"peak = -1\.0: must be greater than 0"),
        ("needle:decay=-3", r"decay = -3\.0: must be greater than 0"),
        ("relief", r"'path' is missing"),
        ("relief:path=/nowhere.png", r"/nowhere\.png: no such file"),
        ("relief:smooth=-1,path=x", r"smooth.* = -1\.0: must be at least 0"),
    ],
)
def test_bad_dents_end_in_one_line(text, message):
    with pytest.raises(InputError, match=message):
        dent_from_text(text, load("prism48"))


def test_relief_has_the_images_shape(picture):
    """Columns along x, rows along y, white = peak: the disc's top, and its place on the mirror."""
    scene = load("prism48")
    surface = dent("relief", scene, path=str(picture), peak=0.4, smooth=0.3)
    x, y = 100.5 / 300 * 60, 60.5 / 200 * 45
    assert surface.height(np.array(x), np.array(y)) == pytest.approx(0.4, rel=2e-3)
    assert abs(surface.height(np.array(60 - x), np.array(y))) < 1e-3
    assert abs(surface.height(np.array(x), np.array(45 - y))) < 1e-3
    assert surface.grid is not None
    small = resize(scene, 40, 50)
    assert trace(small, surface).visible.mean() > 0.5
