"""The form of the mirror at rest: closed form, TOML, parameters, and the anchor that it is."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optolever import InputError
from optolever.reconstruct import exact_correspondence, reconstruct
from optolever.scene import Covariance, RestForm, Scene, Surface, load, resize, trace, without_rest_form

FORM = np.array([0.012, -0.007, 0.009, 0.004, 0.003, -0.002, 0.005])  # mm


@pytest.fixture
def scene() -> Scene:
    rig = resize(load("prism48", exact=True), 90, 120)
    matrix = np.diag([1e-8, 4e-8, 1e-8])
    known = Covariance(("rest.L20", "pattern.z", "rest.L02"), matrix, sources=("all",), parts=matrix[None])
    return replace(rig, covariance=known, rest_form=RestForm(FORM))


def height(x, y, scene):  # type: ignore[no-untyped-def]
    """The same, written out."""
    s, t = 2 * x / scene.mirror.length - 1, 2 * y / scene.mirror.width - 1
    p2, p3 = (lambda a: 1.5 * a**2 - 0.5), (lambda a: 2.5 * a**3 - 1.5 * a)
    shapes = [p2(s), s * t, p2(t), p3(s), p2(s) * t, s * p2(t), p3(t)]
    return sum(c * shape for c, shape in zip(FORM, shapes, strict=True))


def sagging(scene: Scene) -> Surface:
    def gradient(x, y):  # type: ignore[no-untyped-def]
        return height(x + 1e-30j, y, scene).imag / 1e-30, height(x, y + 1e-30j, scene).imag / 1e-30

    return Surface(lambda x, y: height(x, y, scene), gradient)


def test_form_and_day_of_a_calibration_are_kept_in_the_rig(scene: Scene, tmp_path: Path) -> None:
    assert scene.covariance is not None
    dated = replace(scene, covariance=replace(scene.covariance, date="2026-11-28"))
    dated.save(tmp_path / "rig.toml")
    assert load(tmp_path / "rig.toml") == dated
    text = (tmp_path / "rig.toml").read_text()
    assert "date = 2026-11-28\n" in text
    (tmp_path / "rig.toml").write_text(text.replace("2026-11-28", '"28.11.2026"'))
    with pytest.raises(InputError, match=r"calibration\.date = '28\.11\.2026': must be a date"):
        load(tmp_path / "rig.toml")
    (tmp_path / "rig.toml").write_text(text.replace("0.012", "nan"))
    with pytest.raises(InputError, match="rest_form_mm"):
        load(tmp_path / "rig.toml")


def test_the_default_anchor_lies_on_it(scene: Scene) -> None:
    """A rest capture of 20 um of sag gives the sag, not an edge at 0; its sigma holds the form's."""
    seen = trace(scene, sagging(scene))
    given = exact_correspondence(seen, 1e-3)
    found = reconstruct(given, scene)
    far = found.good & (seen.x > 6)
    assert np.abs(found.z - seen.z)[far].max() < 2e-5
    plain = reconstruct(given, without_rest_form(scene))
    assert np.abs(plain.z - seen.z)[far].max() > 5e-3
    edge = far & (seen.x > 0.95 * scene.mirror.length)
    assert np.median(found.calibration_sigma[edge]) > np.median(plain.calibration_sigma[edge]) + 5e-5


@pytest.mark.slow
def test_heights_against_a_rest_capture_are_above_it(scene: Scene) -> None:
    given = exact_correspondence(trace(scene, sagging(scene)), 1e-3)
    found = reconstruct(given, scene, rest=given, accept=True)
    assert np.abs(found.z[found.good]).max() < 1e-6
