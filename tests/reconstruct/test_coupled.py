"""reconstruct() on exact correspondences of traced scenes: figures, anchors, masks, symmetry."""

from dataclasses import replace

import numpy as np
import pytest

from optolever.decode import Correspondence
from optolever.reconstruct import (
    DistanceAnchor,
    EdgeAnchor,
    HeightFlag,
    HeightMap,
    PixelAnchor,
    PointAnchor,
    reconstruct,
)
from optolever.scene import Scene, TelecentricCamera, load, resize, trace
from optolever.scene import dent_from_text as dent


def relative_rms(height: HeightMap, truth: np.ndarray) -> float:
    """rms height error over the good pixels / peak depth."""
    error = (height.z - truth)[height.good]
    return float(np.sqrt(np.mean(error**2)) / np.nanmax(np.abs(truth)))


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
    assert relative_rms(height, truth.z) < limit
    good = height.good
    np.testing.assert_allclose(height.x[good], truth.x[good], atol=0.01)
    assert np.all(height.sigma[good] > 0)


def test_known_point_reaches_the_quadrature_error(exact) -> None:
    """Fourth order: twice the pixels, a sixteenth of the error."""
    errors = []
    for size in (120, 240):
        scene, truth, correspondence = exact("paper-simulation", "raised-cosine", size, size)
        anchor = PixelAnchor(size // 2, size // 2, float(truth.z[size // 2, size // 2]))
        errors.append(relative_rms(reconstruct(correspondence, scene, anchor=anchor), truth.z))
    assert errors[1] < 1e-8
    assert errors[1] < errors[0] / 10


@pytest.fixture(scope="module")
def bump(exact):
    return exact("paper-simulation", "raised-cosine", 96, 112)


def test_every_kind_of_anchor_finds_the_same_mirror(bump) -> None:
    scene, truth, correspondence = bump
    row, col = 40, 50
    origins, directions = scene.camera.rays_at(row, col)
    point = np.array([truth.x[row, col], truth.y[row, col], truth.z[row, col]])
    distance = float((point - origins) @ directions)
    anchors = [
        PixelAnchor(row, col, float(point[2])),
        PointAnchor(*map(float, point)),
        tuple(map(float, point)),
        DistanceAnchor(row, col, distance),
        [EdgeAnchor(sigma=0.01), PointAnchor(*map(float, point))],
    ]
    for anchor in anchors:
        assert relative_rms(reconstruct(correspondence, scene, anchor=anchor), truth.z) < 1e-6


def test_points_between_pixels_serve_as_anchors(bump) -> None:
    scene, _, correspondence = bump
    surface = dent("raised-cosine", scene)
    truth = trace(scene, surface).z
    x, y = 61.23, 70.77
    anchor = PointAnchor(x, y, float(surface.height(np.array([x]), np.array([y]))[0]))
    assert relative_rms(reconstruct(correspondence, scene, anchor=anchor), truth) < 1e-6


def test_a_wrong_anchor_excites_the_free_mode_alone(bump) -> None:
    """At 45 degrees and small slopes the free mode is h = C x."""
    scene, _, _ = bump
    truth = trace(scene, dent("flat", scene))
    flat = Correspondence(
        truth.u, truth.v, *np.full((2, *truth.u.shape), 0.02), (~truth.visible).astype(np.uint16)
    )
    row, col = 48, 56
    height = reconstruct(flat, scene, anchor=PixelAnchor(row, col, 1e-3))
    expected = 1e-3 * height.x / height.x[row, col]
    np.testing.assert_allclose(height.z, expected, atol=2e-6)


def test_fixed_point_agrees(bump) -> None:
    scene, truth, correspondence = bump
    slow = reconstruct(correspondence, scene, method="fixed-point")
    fast = reconstruct(correspondence, scene)
    assert slow.diagnostics.converged
    assert len(slow.diagnostics.steps) > len(fast.diagnostics.steps)
    difference = (slow.z - fast.z)[slow.good & fast.good]
    assert np.sqrt(np.mean(difference**2)) < 1e-6 * np.nanmax(truth.z)


def turned(scene: Scene, correspondence: Correspondence, kind: str) -> tuple[Scene, Correspondence]:
    """The same physics with the camera's pixels numbered otherwise."""
    camera = scene.camera
    assert isinstance(camera, TelecentricCamera)
    last = camera.origin + (camera.cols - 1) * camera.pitch[0] * camera.u_axis
    if kind == "half turn":
        far = last + (camera.rows - 1) * camera.pitch[1] * camera.v_axis
        new = replace(camera, origin=far, u_axis=-camera.u_axis, v_axis=-camera.v_axis)
        turn = 2
    else:
        new = replace(
            camera,
            origin=last,
            u_axis=camera.v_axis,
            v_axis=-camera.u_axis,
            pitch=camera.pitch[::-1].copy(),
            rows=camera.cols,
            cols=camera.rows,
        )
        turn = 1
    names = ("u", "v", "sigma_u", "sigma_v", "flags")
    fields = {name: np.rot90(getattr(correspondence, name), turn).copy() for name in names}
    return replace(scene, camera=new), Correspondence(**fields)


@pytest.mark.parametrize(("kind", "turn"), [("half turn", 2), ("quarter turn", 1)])
@pytest.mark.parametrize("holes", [False, True])
def test_a_turned_camera_sees_the_same_mirror(bump, noisy, kind: str, turn: int, holes: bool) -> None:
    scene, truth, _ = bump
    correspondence = noisy(truth, noise=0.02, seed=5)
    if holes:
        flags = np.where(np.random.default_rng(1).random(truth.u.shape) < 0.03, 1, correspondence.flags)
        correspondence = replace(correspondence, flags=flags.astype(np.uint16))
    other_scene, other = turned(scene, correspondence, kind)
    straight = reconstruct(correspondence, scene)
    turned_map = reconstruct(other, other_scene)
    for name in ("z", "sigma"):
        first, second = np.rot90(getattr(straight, name), turn), getattr(turned_map, name)
        np.testing.assert_array_equal(np.isnan(first), np.isnan(second))
        good = np.isfinite(first)
        error = np.abs(first - second)[good] / np.rot90(straight.sigma, turn)[good]
        assert error.max() < 0.05


def test_metres_instead_of_millimetres(bump) -> None:
    scene, truth, correspondence = bump
    camera, pattern, mirror = scene.camera, scene.pattern, scene.mirror
    k = 1e-3
    small = replace(
        scene,
        mirror=replace(mirror, length=k * mirror.length, width=k * mirror.width),
        pattern=replace(pattern, origin=k * pattern.origin, pitch=k * pattern.pitch),
        camera=replace(camera, origin=k * camera.origin, pitch=k * camera.pitch),
    )
    straight, scaled = reconstruct(correspondence, scene), reconstruct(correspondence, small)
    assert np.nanmax(np.abs(scaled.z / k - straight.z)) < 1e-9 * np.nanmax(truth.z)
    np.testing.assert_allclose(scaled.sigma / k, straight.sigma, rtol=1e-6)


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
    assert relative_rms(height, truth.z) < 1e-6
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
    assert relative_rms(height, truth.z) < 1e-6
    both = reconstruct(
        cut(correspondence, keep), scene, anchor=[EdgeAnchor(), PixelAnchor(48, 48, float(truth.z[48, 48]))]
    )
    assert both.diagnostics.components == 2
    assert both.good[inside].all()
    assert relative_rms(both, truth.z) < 1e-6


def test_a_wild_pixel_is_flagged(exact) -> None:
    scene, _, correspondence = exact("paper-simulation", "raised-cosine", 96, 96)
    u = correspondence.u.copy()
    u[40, 30] -= 20
    height = reconstruct(replace(correspondence, u=u), scene)
    assert height.flags[40, 30] & HeightFlag.CURL
    assert np.count_nonzero(height.flags & HeightFlag.CURL) <= 5


def test_float32_input(exact) -> None:
    scene, truth, c = exact("paper-simulation", "raised-cosine", 96, 96)
    single = Correspondence(
        *(part.astype(np.float32) for part in (c.u, c.v, c.sigma_u, c.sigma_v)), flags=c.flags
    )
    height = reconstruct(single, scene)
    assert height.z.dtype == np.float64
    assert relative_rms(height, truth.z) < 2e-5


def test_coarse_start_is_only_a_start(noisy) -> None:
    """Large enough for a coarser grid: the same answer to the tolerance, in few steps."""
    scene = resize(load("paper-simulation"), 300, 320)
    truth = trace(scene, dent("needle", scene))
    height = reconstruct(noisy(truth), scene)
    assert height.diagnostics.converged
    assert len(height.diagnostics.steps) <= 3
    assert relative_rms(height, truth.z) < 5e-5


def test_exact_data_may_say_so(bump) -> None:
    """Sigma of zero keeps the weights of the scene."""
    scene, truth, correspondence = bump
    zero = np.zeros_like(correspondence.sigma_u)
    height = reconstruct(replace(correspondence, sigma_u=zero, sigma_v=zero), scene)
    assert height.good.mean() > 0.99
    assert relative_rms(height, truth.z) < 1e-5
