"""The paper's study: PAPER.md's table comes out of it, its simulation is exact, its frames tell the same
story.
"""

import json

import numpy as np
import pytest

from optolever.experiments import PaperStudy
from optolever.experiments.paper.line import Line, lattice_points, pixel_points, seen_points
from optolever.experiments.paper.rows import capture_positions, prism_geometry
from optolever.scene import dent, load, resize, trace

SCENE = resize(load("paper-simulation", exact=True), 101, 150)


def test_pixel_points_are_those_of_the_traced_scene() -> None:
    """Two-dimensional equations against the three-dimensional ray tracer, along the dent's middle."""
    surface = dent("raised-cosine", SCENE)
    line = Line(surface, prism_geometry(SCENE), SCENE.mirror.width / 2)
    row, cols = SCENE.camera.rows // 2, np.arange(150.0)
    points = pixel_points(line, capture_positions(SCENE, row, cols), 1)
    seen = trace(SCENE, surface)
    m = (seen.u[row, ::-1] + 0.5) * SCENE.pattern.pitch
    np.testing.assert_allclose(points.l, seen.x[row, ::-1], atol=1e-9)
    np.testing.assert_allclose(points.d, seen.z[row, ::-1], atol=1e-9)
    np.testing.assert_allclose(points.m, m, atol=1e-8)


def test_seen_points_know_the_truth_off_the_middle() -> None:
    surface, geometry = dent("gaussian", SCENE), prism_geometry(SCENE)
    seen, row, cols = trace(SCENE, surface), 30, np.arange(0, 150, 7)
    w = capture_positions(SCENE, row, cols.astype(float))
    points = seen_points(surface, geometry, -w, w, seen.y[row, cols])
    np.testing.assert_allclose(points.d, seen.z[row, cols][::-1], atol=1e-9)
    assert np.all(np.diff(points.l) > 0)


def test_a_cusp_hides_lattice_lines() -> None:
    """Rays by the reflection law turn away at the cusp: the lines between are in no pixel."""
    line = Line(dent("needle", SCENE), prism_geometry(SCENE), SCENE.mirror.width / 2)
    points = lattice_points(line, 64, 1)
    assert 40 < points.m.size < 64
    assert points.m.size + round(np.max(np.diff(points.m)) / np.min(np.diff(points.m))) - 1 == 64


@pytest.mark.parametrize(
    ("law", "sign", "gamma", "printed"),
    [
        ("reflection", 1, False, ("0.235", "0.66", "0.32")),
        ("reflection", 1, True, ("0.029", "0.28", "0.145")),
        ("print", -1, False, ("0.645", "0.32", "0.34")),
        ("print", -1, True, ("0.033", "0.035", "0.0030")),
    ],
)
def test_published_table(
    study: PaperStudy, law: str, sign: int, gamma: bool, printed: tuple[str, ...]
) -> None:
    """PAPER.md's, to half a unit of its last printed digit (.6445 is printed there as .65)."""
    row = study.find(case="smooth", data="exact", law=law, method="lattice", sign=sign, gamma=gamma)
    assert row.points == 64
    for found, digits in zip((row.drops, row.rises, row.mean), printed, strict=True):
        assert abs(found - float(digits)) <= 0.51 * 10.0 ** -len(digits.partition(".")[2])


def test_frames_tell_what_exact_data_tell(study: PaperStudy) -> None:
    """Drops on the lattice: noise and rendering change the third digit, not the story."""
    for case in ("smooth", "pencil"):
        exact, frames = (
            study.find(case=case, data=data, law="reflection", method="lattice", sign=1, gamma=True)
            for data in ("exact", "frames")
        )
        if exact.points == frames.points:
            assert frames.drops == pytest.approx(exact.drops, rel=0.1)


def test_dense_beats_the_recursion(study: PaperStudy) -> None:
    for case in ("smooth", "needle", "pencil"):
        dense = study.find(case=case, data="exact", method="dense")
        paper = study.find(case=case, data="exact", law="reflection", method="pixels", sign=1, gamma=True)
        assert dense.field < paper.field / 10


def test_study_is_plain(study: PaperStudy) -> None:
    plain = json.loads(json.dumps(study.to_dict()))
    assert len(plain["rows"]) == len(study.rows)
    assert plain["settings"]["cases"]["smooth"]["dent"] == "raised-cosine"
