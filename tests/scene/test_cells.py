"""Cells that are not square: a DMD's, or an anamorphic video mode's."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optolever import InputError
from optolever.decode import decode
from optolever.patterns import sequence
from optolever.projector import capture
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


@pytest.mark.parametrize("renderer", ["numpy", "auto"])
def test_heights_through_cells_that_are_not_square(renderer: str) -> None:
    scene = squeezed(80, 100)
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
