"""reconstruct() on exact correspondences of traced scenes: figures, anchors, masks, rest captures, starts."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optolever import InputError
from optolever.reconstruct import (
    EdgeAnchor,
    HeightFlag,
    PixelAnchor,
    PointAnchor,
    exact_correspondence,
    reconstruct,
)
from optolever.samples.metrics import relative_error
from optolever.scene import Scene, Surface, load, resize, trace
from optolever.scene import dent_from_text as dent


@pytest.mark.parametrize(
    ("preset", "name", "size", "limit"),
    [
        ("paper-simulation", "raised-cosine", 192, 1e-6),
        pytest.param("paper-simulation", "needle", 640, 1e-5, marks=pytest.mark.slow),
        ("paper-simulation", "tilt", 192, 1e-6),
        ("prism48", "gaussian", 192, 1e-6),
        ("monitor-mirror", "gaussian", 192, 1e-6),
    ],
)
def test_default_anchor(exact, preset: str, name: str, size: int, limit: float) -> None:
    """The figures that are asked for at 1637 x 1637, already at a fraction of that."""
    scene, truth, correspondence = exact(preset, name, size, size + 16)
    height = reconstruct(correspondence, scene)
    assert height.diagnostics.converged
    assert (height.good == truth.visible).mean() > 0.999
    assert relative_error(height, truth) < limit
    good = height.good
    np.testing.assert_allclose(height.x[good], truth.x[good], atol=0.01)
    assert np.all(height.sigma[good] > 0)


def test_known_point_reaches_the_quadrature_error(exact) -> None:
    """Fourth order: twice the pixels, a sixteenth of the error."""
    errors = []
    for size in (120, 240):
        scene, truth, correspondence = exact("paper-simulation", "raised-cosine", size, size)
        anchor = PixelAnchor(size // 2, size // 2, float(truth.z[size // 2, size // 2]))
        errors.append(relative_error(reconstruct(correspondence, scene, anchor=anchor), truth))
    assert errors[1] < 1e-8
    assert errors[1] < errors[0] / 10


@pytest.fixture(scope="module")
def bump(exact):
    return exact("paper-simulation", "raised-cosine", 96, 112)


def test_every_kind_of_anchor_finds_the_same_mirror(bump) -> None:
    scene, truth, correspondence = bump
    row, col = 40, 50
    point = np.array([truth.x[row, col], truth.y[row, col], truth.z[row, col]])
    anchors = [
        PixelAnchor(row, col, float(point[2])),
        PointAnchor(*map(float, point)),
        tuple(map(float, point)),
        [EdgeAnchor(sigma=0.01), PointAnchor(*map(float, point))],
    ]
    for anchor in anchors:
        assert relative_error(reconstruct(correspondence, scene, anchor=anchor), truth) < 1e-6


@pytest.mark.daily(2)
@pytest.mark.parametrize("shape", ["disk", "holes", "slit", "dropouts"])
def test_masks(exact, cut, shape: str) -> None:
    rows = cols = 128
    scene, truth, correspondence = exact("paper-simulation", "raised-cosine", rows, cols)
    y, x = np.mgrid[:rows, :cols]
    keep = {
        "disk": np.hypot(y - 64, x - 64) < 50,
        "holes": np.hypot(y - 64, x - 64) > 20,
        "slit": (np.abs(x - 64) > 3) | (np.abs(y - 64) < 2),
        "dropouts": np.random.default_rng(0).random((rows, cols)) > 0.05,
    }[shape]
    anchor = PixelAnchor(64, 60, float(truth.z[64, 60])) if shape == "disk" else "edge"
    height = reconstruct(cut(correspondence, keep), scene, anchor=anchor)
    assert height.diagnostics.converged
    assert (height.good == (keep & truth.visible)).mean() > 0.999
    assert relative_error(height, truth) < 1e-6
    by_argument = reconstruct(correspondence, scene, anchor=anchor, mask=keep)
    np.testing.assert_array_equal(by_argument.z, height.z)


def test_islands_without_an_anchor_are_flagged_and_not_guessed(exact, cut) -> None:
    scene, truth, correspondence = exact("paper-simulation", "raised-cosine", 96, 96)
    y, x = np.mgrid[:96, :96]
    radius = np.hypot(y - 48, x - 48)
    keep = (radius < 15) | (radius > 18)
    height = reconstruct(cut(correspondence, keep), scene)
    inside = radius < 15
    assert np.all(height.flags[inside] == HeightFlag.NO_ANCHOR)
    assert np.isnan(height.z[inside]).all()
    assert np.isnan(height.sigma[inside]).all()
    assert height.diagnostics.lost == inside.sum()
    assert relative_error(height, truth) < 1e-6
    both = reconstruct(
        cut(correspondence, keep), scene, anchor=[EdgeAnchor(), PixelAnchor(48, 48, float(truth.z[48, 48]))]
    )
    assert both.diagnostics.components == 2
    assert both.good[inside].all()
    assert relative_error(both, truth) < 1e-6


def test_rest_capture_takes_off_the_calibration_and_adds_its_noise_and_its_gaps(exact) -> None:
    """The pattern is 0.3 cells off in both captures."""
    scene, truth, correspondence = exact("paper-simulation", "raised-cosine", 96, 96)
    _, _, rest = exact("paper-simulation", "flat", 96, 96)
    flags = rest.flags.copy()
    flags[40, 50] = 1
    rest = replace(rest, flags=flags)
    alone, right = reconstruct(correspondence, scene), reconstruct(correspondence, scene, rest=rest)
    seen, rest = (replace(each, u=each.u + 0.3, v=each.v - 0.3) for each in (correspondence, rest))
    both = reconstruct(seen, scene, rest=rest)
    assert np.nanmax(np.abs(both.z - right.z)) < 1e-9
    assert relative_error(both, truth) < 0.01 * relative_error(reconstruct(seen, scene), truth)
    assert both.flags[40, 50] == 128
    ratio = both.sigma[alone.good & both.good] / alone.sigma[alone.good & both.good]
    np.testing.assert_allclose(ratio, np.sqrt(2), rtol=0.01)


def test_a_dent_over_the_whole_mirror_is_not_made_worse_by_its_sag(exact) -> None:
    """Nothing rests, and nothing sank: 6 nm of 1.3 mm, a hundredth of the least sigma."""
    scene, truth, correspondence = exact("paper-simulation", "raised-cosine", 96, 96)
    _, _, rest = exact("paper-simulation", "flat", 96, 96)
    assert relative_error(reconstruct(correspondence, scene, rest=rest), truth) < 1e-5


@pytest.mark.parametrize("x", [3.0, 30.0])
def test_an_anchor_where_mirror_and_pattern_meet_has_a_notice(x: float) -> None:
    scene = resize(load("prism48"), 60, 80)
    height = reconstruct(
        exact_correspondence(trace(scene, dent("flat", scene))), scene, anchor=(x, 22.0, 0.0)
    )
    notices = [notice for notice in height.notices if "error of the anchors grows" in notice.name]
    assert len(notices) == (x < 0.1 * scene.mirror.length)
    assert all("total_sigma is" in notice.cure for notice in notices)


def test_in_open_air_the_middle_stands_in_for_an_edge_that_is_not_seen() -> None:
    """A concave mirror of R = 3 m whose vertex rests, behind a mask that leaves a disk."""
    scene, radius = resize(load("monitor-mirror"), 60, 80), 3000.0
    bowl = Surface(
        lambda x, y: ((x - 75) ** 2 + (y - 55) ** 2) / (2 * radius),
        lambda x, y: ((x - 75) / radius, (y - 55) / radius),
    )
    truth = trace(scene, bowl)
    row, col = np.mgrid[:60, :80]
    mask = np.hypot(row - 30, col - 40) < 25
    seen = exact_correspondence(truth)
    least = reconstruct(seen, scene, mask=mask)
    assert np.abs(least.z - truth.z)[least.good].max() < 1e-5 * np.nanmax(truth.z)
    assert any("its middle counts as at rest" in each.name for each in least.notices)
    np.testing.assert_array_equal(reconstruct(seen, scene, anchor="middle", mask=mask).z, least.z)
    prism = resize(load("prism48"), 60, 80)
    with pytest.raises(InputError, match="anchor = 'edge': no valid pixel"):
        reconstruct(exact_correspondence(trace(prism, dent("flat", prism))), prism, mask=mask)


def test_against_rest_the_border_stands_in_for_an_edge_that_is_not_seen() -> None:
    """A finger presses the middle of what the camera sees."""
    scene = resize(load("monitor-mirror", exact=True), 60, 80)
    truth = trace(scene, dent("gaussian:peak=0.1,sigma=6", scene))
    row, col = np.mgrid[:60, :80]
    mask = np.hypot(row - 30, col - 40) < 25
    rest = exact_correspondence(trace(scene, dent("flat", scene)))
    found = reconstruct(exact_correspondence(truth), scene, mask=mask, rest=rest)
    error = np.abs(found.z - truth.z)[found.good]
    assert error.max() < 2e-3 * 0.1
    assert (error < 2 * found.total_sigma[found.good]).all()
    assert not found.notices


PRISM = """[mirror]
size_mm = [60, 45]
[pattern]
angle_deg = 48
size = [75, 75]
pitch_mm = 0.6
[camera]
kind = "telecentric"
angle_deg = 48
size = [80, 60]
pitch_mm = [0.5018, 0.75]
[medium]
index = 1.41
"""


@pytest.mark.parametrize("rest", [False, True])
def test_the_sides_of_the_mirror_exchanged_and_a_display_behind_it_are_named(
    rest: bool, tmp_path: Path
) -> None:
    """Camera and display stand where the mirror's length puts them."""
    right = load(_written(tmp_path / "right.toml", PRISM))
    press, still = (exact_correspondence(trace(right, dent(name, right))) for name in ("gaussian", "flat"))

    def said(scene: Scene) -> list[str]:
        found = reconstruct(press, scene, rest=still if rest else None).notices
        return [one.name for one in found if "scene's numbers" in one.name]

    assert not said(right)
    (words,) = said(load(_written(tmp_path / "exchanged.toml", PRISM.replace("[60, 45]", "[45, 60]"))))
    assert "seen elsewhere than by the scene's numbers" in words
    x, y, z = right.pattern.origin
    try:
        below = "".join(said(replace(right, pattern=replace(right.pattern, origin=(x, y, z - 200)))))
    except InputError as error:
        below = str(error)
    assert "no pixel sees the pattern in a flat mirror" in below
    metres = load(_written(tmp_path / "metres.toml", PRISM.replace("[60, 45]", "[0.06, 0.045]")))
    assert any("quarter" in one.name or "elsewhere" in one.name for one in reconstruct(press, metres).notices)


def _written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


@pytest.mark.parametrize("form", ["flat", "gaussian:peak=0.3,sigma=4"])
@pytest.mark.parametrize("noise", [0.02, 0.0])
def test_a_pattern_that_touches_the_mirror_costs_its_pixels_alone(noisy, form: str, noise: float) -> None:
    """The pattern's plane meets the resting mirror in the middle of pixels of one column, just beside it."""
    base = resize(load("prism48", exact=True), 48, 64)
    shift = trace(base, dent("flat", base)).x[24, 57] - 0.002
    scene = replace(base, pattern=replace(base.pattern, origin=base.pattern.origin + np.array([shift, 0, 0])))
    truth = trace(scene, dent(form, scene))
    height = reconstruct(noisy(truth, noise=noise), scene, anchor=PixelAnchor(24, 30, float(truth.z[24, 30])))
    touching = truth.visible & (truth.x < shift + 0.01)
    assert touching.any()
    assert np.all(height.flags[touching] == HeightFlag.SINGULAR)
    assert np.isnan(height.z[touching]).all()
    good = height.good
    assert good.sum() > 0.95 * truth.visible.sum()
    error = np.abs(height.z - truth.z)[good]
    assert np.all(error < 5 * height.sigma[good] + 1e-9 * scene.mirror.length)


def test_a_sigma_as_large_as_the_mirror_is_no_measurement() -> None:
    """Of a mirror 60 mm long, by an anchor that is known to 1 or to 30 mm."""
    scene = resize(load("prism48", exact=True), 24, 32)
    seen = exact_correspondence(trace(scene, dent("flat", scene)))
    for sigma, flagged in ((1.0, False), (30.0, True)):
        height = reconstruct(seen, scene, anchor=PointAnchor(45, 22, 0, sigma=sigma))
        farther = height.sigma > 15
        assert farther.any() == flagged
        assert np.array_equal((height.flags & HeightFlag.SINGULAR) > 0, farther)
