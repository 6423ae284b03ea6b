"""Cells that are not square: a DMD's, or an anamorphic video mode's."""

from dataclasses import replace

import numpy as np
import pytest

from optolever import InputError
from optolever.decode import decode
from optolever.patterns import sequence
from optolever.projector import WHITE_NOISE_SENSOR, Footprints, capture, light_of
from optolever.reconstruct import reconstruct
from optolever.scene import Pattern, Sensor, dent, load, resize

TALL = 0.5


def squeezed(rows: int, cols: int):
    """prism48 whose pattern has cells half as tall, and twice as many rows."""
    scene = resize(load("prism48", exact=True), rows, cols)
    pattern = scene.pattern
    return replace(scene, pattern=replace(pattern, aspect=TALL, rows=int(pattern.rows / TALL)))


def test_places_are_steps_along_either_axis() -> None:
    pattern = Pattern((1, 2, 3), (0, 1, 0), (0.6, 0, 0.8), 0.2, 40, 30, aspect=0.7)
    u, v = np.array([3.0, 11.5]), np.array([7.25, 20.0])
    points = np.array([1, 2, 3]) + 0.2 * u[:, None] * [0, 1, 0] + 0.14 * v[:, None] * [0.6, 0, 0.8]
    np.testing.assert_allclose(pattern.point(u, v), points, atol=1e-12)
    np.testing.assert_allclose(pattern.coordinates(points), [u, v], atol=1e-12)
    toward = np.tile(pattern.normal[:, None], 2)
    np.testing.assert_allclose(pattern.landing(points.T - 5 * toward, toward)[:2], [u, v], atol=1e-12)


@pytest.mark.parametrize(
    ("renderer", "stagger", "sensor", "limit"),
    [
        ("numpy", 0.0, WHITE_NOISE_SENSOR, 2e-4),
        ("auto", 0.0, None, 4e-4),
        ("auto", 0.5, WHITE_NOISE_SENSOR, 2e-4),
        ("auto", 0.5, None, 4e-4),
    ],
)
def test_heights_through_cells_that_are_not_square(
    renderer: str, stagger: float, sensor: Sensor | None, limit: float
) -> None:
    """By photon noise, about 2 levels, and by white noise of half a level."""
    scene = squeezed(80, 100)
    scene = replace(scene, pattern=replace(scene.pattern, stagger=stagger), sensor=sensor)
    shown = sequence("gray+phase", scene.pattern.rows, scene.pattern.cols)
    seen = capture(scene, dent("gaussian", scene, peak=0.1, sigma=5), shown, noise=0.5, renderer=renderer)
    height = reconstruct(decode(seen.frames, shown), scene)
    z = dent("gaussian", scene, peak=0.1, sigma=5).height(height.x, height.y)
    assert height.good.mean() > 0.9
    error = (height.z - z)[height.good]
    assert np.sqrt(np.mean(error**2)) < limit
    assert np.sqrt(np.mean(np.square(error / height.sigma[height.good]))) < 1.3


def looking_at(u: np.ndarray, v: np.ndarray, boxes_u: list[float], boxes_v: list[float]) -> Footprints:
    every = [np.tile(np.array(boxes), (len(u), 1)) for boxes in (boxes_u, boxes_v)]
    return Footprints(u, v, np.ones(len(u)), *every)


@pytest.mark.parametrize("name", ["phase", "gray", "lattice"])
def test_staggered_rows_are_cells_beside_each_other(name: str) -> None:
    """A small footprint sees one cell: of even rows that a quarter to the right of u, of odd rows to the
    left. One of two rows sees both halves."""
    shown, rng = sequence(name, 24, 30), np.random.default_rng(0)
    frames = shown.render() / 255
    row, place = rng.integers(4, 19, 200), rng.uniform(5, 24, 200)
    place += 0.02 * np.sign(place - np.rint(place * 4) / 4)  # off the edges of cells
    row[0::2] -= row[0::2] % 2
    cells = [np.rint(place + aside).astype(int) for aside in (0.25, -0.25)]
    tiny = light_of(looking_at(place, row.astype(float), [0.01, 0.01], [0.01, 0.01]), shown, None, 0.0, 0.5)
    expected = np.where(row % 2 == 0, frames[:, row, cells[0]], frames[:, row, cells[1]])
    np.testing.assert_allclose(tiny, expected, atol=1e-5)
    even = row - row % 2
    two = light_of(looking_at(place, even + 0.5, [0.01, 0.01], [0.01, 2.0]), shown, None, 0.0, 0.5)
    np.testing.assert_allclose(
        two, (frames[:, even, cells[0]] + frames[:, even + 1, cells[1]]) / 2, atol=6e-3
    )


def test_renderers_agree_on_staggered_rows() -> None:
    """NumPy's footprints and rays; on the same scene without the stagger they see something else."""
    scene = resize(load("monitor-mirror", exact=True), 30, 40)
    coarse = replace(
        scene.pattern, pitch=4 * scene.pattern.pitch, cols=scene.pattern.cols // 4
    )  # of 4 pixels
    pattern = replace(coarse, rows=scene.pattern.rows // 2, aspect=0.5, stagger=0.5, blur_px=0.2)
    scene = replace(scene, pattern=pattern, sensor=WHITE_NOISE_SENSOR)
    shown, flat = sequence("gray", pattern.rows, pattern.cols), dent("flat", scene)
    numpy, rays = (
        capture(scene, flat, shown, renderer=name).frames.astype(int) for name in ("numpy", "rays")
    )
    inner = np.s_[:, 1:-1, 1:-1]
    assert np.abs(numpy - rays)[inner].max() <= 4
    even = replace(scene, pattern=replace(pattern, stagger=0.0))
    assert np.abs(capture(even, flat, shown, renderer="numpy").frames - numpy)[inner].max() > 20
    assert (capture(scene, flat, shown, renderer="auto").frames == numpy).all()
    with pytest.raises(InputError, match="staggered rows"):
        capture(scene, flat, shown, renderer="gl")
