"""Cells that are not square: a DMD's, or an anamorphic video mode's."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optolever import InputError
from optolever.decode import decode
from optolever.patterns import sequence, sequence_from_text
from optolever.projector import Footprints, capture, light_of
from optolever.reconstruct import reconstruct
from optolever.scene import Pattern, adjusted, dent, load, resize

from ..conftest import ROOT

TALL = 0.5
CASE = ROOT.parent / "shared" / "cases" / "29"


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


@pytest.mark.parametrize(("renderer", "stagger"), [("numpy", 0.0), ("auto", 0.0), ("auto", 0.5)])
def test_heights_through_cells_that_are_not_square(renderer: str, stagger: float) -> None:
    scene = squeezed(80, 100)
    scene = replace(scene, pattern=replace(scene.pattern, stagger=stagger))
    shown = sequence("gray+phase", scene.pattern.rows, scene.pattern.cols)
    seen = capture(scene, dent("gaussian", scene, peak=0.1, sigma=5), shown, noise=0.5, renderer=renderer)
    height = reconstruct(decode(seen.frames, shown), scene)
    z = dent("gaussian", scene, peak=0.1, sigma=5).height(height.x, height.y)
    assert height.good.mean() > 0.9
    error = (height.z - z)[height.good]
    assert np.sqrt(np.mean(error**2)) < 2e-4
    assert np.sqrt(np.mean(np.square(error / height.sigma[height.good]))) < 1.3


def test_a_file_holds_both_numbers(tmp_path: Path) -> None:
    scene = squeezed(20, 30)
    scene.save(tmp_path / "rig.toml")
    assert "pitch_mm = [" in (tmp_path / "rig.toml").read_text()
    again = load(str(tmp_path / "rig.toml"), exact=True).pattern
    assert (again.pitch, again.aspect) == pytest.approx((scene.pattern.pitch, TALL), rel=1e-12)
    with pytest.raises(InputError, match="aspect"):
        replace(scene.pattern, aspect=0.0)


def test_the_middle_stays_where_the_pattern_turns() -> None:
    scene = squeezed(20, 30)
    middle = [0.5 * (n - 1) for n in (scene.pattern.cols, scene.pattern.rows)]
    turned = adjusted(scene, {"pattern.rz": 0.3, "pattern.pitch": 0.1}).pattern
    np.testing.assert_allclose(turned.point(*middle), scene.pattern.point(*middle), atol=1e-12)


@pytest.mark.skipif(not CASE.is_dir(), reason="the cases are not here")
def test_a_dmd_is_described() -> None:
    pattern = load(str(CASE / "rig.toml")).pattern
    assert (pattern.pitch, pattern.aspect) == pytest.approx((0.0108, 0.5))


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


def test_a_blurred_fringe_on_staggered_rows() -> None:
    """Closed form: the fringe through sinc and Gaussian, a quarter of a cell to either side, in shares of the
    rows that alternate with the blurred square wave of their parity."""
    shown, blur, rng = sequence_from_text("phase:periods=10,steps=4", 40, 40), 0.6, np.random.default_rng(1)
    u, v = rng.uniform(10, 30, 300), rng.uniform(10, 30, 300)
    seen = light_of(looking_at(u, v, [0.01, 0.01], [0.01, 0.01]), shown, None, blur, 0.5)
    odd = np.arange(1, 8, 2)
    waves = np.cos(np.pi * odd[:, None] * v) * np.exp(-0.5 * (np.pi * blur * odd[:, None]) ** 2)
    parity = (4 / np.pi) * ((-1.0) ** ((odd - 1) / 2) / odd) @ waves
    checked = 0
    for frame, light in zip(shown.frames, seen, strict=True):
        if frame.axis != "u" or frame.kind != "phase":
            continue
        f = 1 / frame.period_px
        size = 0.5 * np.sinc(f) * np.exp(-2 * (np.pi * blur * f) ** 2)
        levels = shown.tables()[0][shown.frames.index(frame)] / 255
        wave = np.exp(-2j * np.pi * f * np.arange(40)) @ (levels - levels.mean()) / 20
        sides = [0.5 + 2 * size * (wave * np.exp(2j * np.pi * f * (u + s))).real for s in (0.25, -0.25)]
        expected = (1 + parity) / 2 * sides[0] + (1 - parity) / 2 * sides[1]
        np.testing.assert_allclose(light, expected, atol=4e-3)
        checked += 1
    assert checked == 4


def test_renderers_agree_on_staggered_rows() -> None:
    """NumPy's footprints and rays; on the same scene without the stagger they see something else."""
    scene = resize(load("monitor-mirror", exact=True), 30, 40)
    coarse = replace(
        scene.pattern, pitch=4 * scene.pattern.pitch, cols=scene.pattern.cols // 4
    )  # of 4 pixels
    pattern = replace(coarse, rows=scene.pattern.rows // 2, aspect=0.5, stagger=0.5, blur_px=0.2)
    scene = replace(scene, pattern=pattern)
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


def test_a_file_holds_the_stagger(tmp_path: Path) -> None:
    scene = squeezed(20, 30)
    replace(scene, pattern=replace(scene.pattern, stagger=0.5)).save(tmp_path / "rig.toml")
    assert load(str(tmp_path / "rig.toml")).pattern.stagger == 0.5
    with pytest.raises(InputError, match=r"stagger: 0\.7, must be -0\.5 to 0\.5"):
        replace(scene.pattern, stagger=0.7)
