"""Displays that are not flat: oracle is the surface equation itself, met by bisection along the ray."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optolever import InputError
from optolever.reconstruct import PointAnchor, exact_correspondence, reconstruct, slope_map
from optolever.scene import Bow, PatternShape, PointTable, Scene, dent, load, resize, trace

SCENE = resize(load("monitor-mirror", exact=True), 64, 80)


def bow(scene: Scene, size: float = 1.0) -> Bow:
    return Bow.of_pattern(scene.pattern.rows, scene.pattern.cols, 2.0 * size, -1.0 * size, 1.5 * size)


def table(scene: Scene) -> PointTable:
    """In-plane offsets too."""
    u, v = np.meshgrid(np.linspace(-1, scene.pattern.cols, 9), np.linspace(-1, scene.pattern.rows, 7))
    x, y = u.ravel() / scene.pattern.cols, v.ravel() / scene.pattern.rows
    return PointTable(np.stack([u.ravel(), v.ravel()], 1), np.stack([x * y, 0.3 * x, np.sin(3 * x) + y], 1))


@pytest.fixture(params=["bow", "table"])
def shape(request: pytest.FixtureRequest) -> PatternShape:
    return bow(SCENE) if request.param == "bow" else table(SCENE)


def with_shape(scene: Scene, shape: PatternShape | None) -> Scene:
    return replace(scene, pattern=replace(scene.pattern, shape=shape))


def test_traced_places_lie_on_the_ray_and_on_the_surface(shape: PatternShape) -> None:
    scene = with_shape(SCENE, shape)
    seen = trace(scene, dent("gaussian", scene, peak=0.5, sigma=20))
    on = seen.visible
    assert on.mean() > 0.9
    _, d = scene.camera.rays()
    n = seen.normal[on]
    out = d[on] - 2 * (d[on] * n).sum(axis=1, keepdims=True) * n
    p, u, v = scene.pattern, seen.u[on], seen.v[on]
    plane = p.origin + p.pitch * (u[:, None] * p.u_axis + v[:, None] * p.v_axis)
    offset = shape.offset(u, v)
    x = (
        plane
        + offset[:, :1] * p.u_axis
        + offset[:, 1:2] * p.v_axis
        + offset[:, 2:] * np.cross(p.u_axis, p.v_axis)
    )
    away = x - np.stack([seen.x, seen.y, seen.z], -1)[on]
    assert np.abs(np.cross(away, out)).max() < 1e-9  # mm
    assert (away * out).sum(axis=1).min() > 0
    assert np.abs(x - p.point(u, v)).max() < 1e-12


def test_height_behind_a_shaped_pattern(shape: PatternShape) -> None:
    flat, scene = SCENE, with_shape(SCENE, shape)
    seen = trace(scene, dent("gaussian", scene, peak=0.5, sigma=20))
    given = exact_correspondence(seen, 1e-3)
    row, col = 32, 70
    anchor = PointAnchor(seen.x[row, col], seen.y[row, col], seen.z[row, col])
    z = [reconstruct(given, s, anchor=anchor) for s in (scene, flat)]
    errors = [np.nanmax(np.abs((one.z - seen.z)[one.good])) for one in z]
    exact = trace(flat, dent("gaussian", flat, peak=0.5, sigma=20))
    at = PointAnchor(exact.x[row, col], exact.y[row, col], exact.z[row, col])
    alone = reconstruct(exact_correspondence(exact, 1e-3), flat, anchor=at)
    bound = np.nanmax(np.abs((alone.z - exact.z)[alone.good]))
    # a table's creases cost quadrature, as those of a mirror do
    assert errors[0] < (3 * bound + 1e-7 if isinstance(shape, Bow) else 2e-5)
    assert errors[1] > 5e-3  # the same taken as flat
    slopes = slope_map(z[0], given, scene)
    truth = -seen.normal[..., 0] / seen.normal[..., 2]
    assert np.nanmax(np.abs(slopes.slope_x - truth)[z[0].good]) < 1e-6 + (errors[0] > 1e-6) * 1e-6


def test_toml_and_size(tmp_path: Path, shape: PatternShape) -> None:
    scene = with_shape(SCENE, shape)
    scene.save(tmp_path / "s.toml")
    assert load(tmp_path / "s.toml") == scene
    small = resize(scene, 32, 40)
    u, v = np.array([100.0, 30.0]), np.array([60.0, 20.0])
    assert np.allclose(
        small.pattern.point((u + 0.5) / 2 - 0.5, (v + 0.5) / 2 - 0.5), scene.pattern.point(u, v)
    )


@pytest.mark.parametrize(
    ("line", "blamed"),
    [
        ("[pattern.bow]\nb30 = 1", "b30"),
        ("[pattern.bow]\nb20 = 'x'", "b20"),
        ("[pattern.bow]\nhalf_px = [0, 1]", "half_px"),
        ("[pattern.table]\nplaces_px = [[0, 0]]\noffsets_mm = [[0, 0, 0]]", "places"),
        (
            "[pattern.table]\nplaces_px = [[0, 0], [1, 1], [2, 2]]\noffsets_mm = [[0,0,0], [0,0,0], [0,0,0]]",
            "line",
        ),
        (
            "[pattern.table]\nplaces_px = [[0, 0], [1, 1], [2, 0]]\noffsets_mm = [[0, 0, 0], [0, 0, 0]]",
            "points",
        ),
        ("[pattern.table]\nplaces_px = 3\noffsets_mm = 4", "places"),
    ],
)
def test_bad_shapes_are_one_line(tmp_path: Path, line: str, blamed: str) -> None:
    path = tmp_path / "s.toml"
    SCENE.save(path)
    path.write_text(path.read_text() + "\n" + line)
    with pytest.raises(InputError, match=blamed):
        load(path)
