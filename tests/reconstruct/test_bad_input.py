"""Bad input to reconstruct(): one line that names the field, the value and the limit."""

from dataclasses import replace

import numpy as np
import pytest

from optolever import InputError
from optolever.reconstruct import PixelAnchor, PointAnchor, method_names, reconstruct
from optolever.scene import load


@pytest.fixture(scope="module")
def case(exact):
    return exact("paper-simulation", "raised-cosine", 24, 32)


def complaint(*arguments, **options) -> str:
    with pytest.raises(InputError) as caught:
        reconstruct(*arguments, **options)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_shape(case) -> None:
    _, _, correspondence = case
    assert "24 x 32" in complaint(correspondence, load("paper-simulation"))


def test_scene_by_its_name(case) -> None:
    assert "scene: is a str, must be a Scene" in complaint(case[2], "paper-simulation")


def test_empty_mask(case) -> None:
    scene, _, correspondence = case
    assert "no pixel" in complaint(correspondence, scene, mask=np.zeros((24, 32), dtype=bool))
    flagged = replace(correspondence, flags=np.ones((24, 32), dtype=np.uint16))
    assert "no pixel" in complaint(flagged, scene)


def test_mask_of_another_shape(case) -> None:
    scene, _, correspondence = case
    assert "(24, 32)" in complaint(correspondence, scene, mask=np.ones((3, 3), dtype=bool))


@pytest.mark.parametrize(("value", "field"), [(np.nan, "sigma_u"), (-1.0, "sigma_v"), (np.inf, "sigma_v")])
def test_sigma(case, value: float, field: str) -> None:
    scene, _, correspondence = case
    sigma = np.full((24, 32), 0.02)
    sigma[3, 4] = value
    message = complaint(replace(correspondence, **{field: sigma}), scene)
    assert field in message
    assert "(3, 4)" in message


def test_one_axis_only(case) -> None:
    scene, _, correspondence = case
    message = complaint(replace(correspondence, v=np.full((24, 32), np.nan)), scene)
    assert "v" in message
    assert "both axes" in message


def test_method(case) -> None:
    scene, _, correspondence = case
    message = complaint(correspondence, scene, method="guess")
    assert all(name in message for name in method_names())


@pytest.mark.parametrize(
    "anchor",
    ["none", "somewhere", [], [None], 7.0, (1.0, 2.0), (1.0, 2.0, "a"), PointAnchor(1.0, 2.0, np.nan)],
)
def test_anchor(case, anchor) -> None:
    scene, _, correspondence = case
    assert "anchor" in complaint(correspondence, scene, anchor=anchor)


def test_anchor_out_of_sight(case) -> None:
    scene, _, correspondence = case
    assert "outside" in complaint(correspondence, scene, anchor=PixelAnchor(100, 3, 0.0))
    assert "outside" in complaint(correspondence, scene, anchor=PointAnchor(80.0, 900.0, 0.0))


def test_no_edge_in_sight(case) -> None:
    scene, _, correspondence = case
    mask = np.zeros((24, 32), dtype=bool)
    mask[:, 10:20] = True
    message = complaint(correspondence, scene, mask=mask)
    assert "edge" in message
    assert "163.7" in message


def test_anchor_on_a_hole(case) -> None:
    scene, _, correspondence = case
    mask = np.ones((24, 32), dtype=bool)
    mask[5:20, 5:25] = False
    assert "anchor" in complaint(correspondence, scene, mask=mask, anchor=PixelAnchor(12, 15, 0.5))


def test_nan_in_an_unflagged_pixel_is_flagged_not_fatal(case) -> None:
    scene, truth, correspondence = case
    u = correspondence.u.copy()
    u[7, 9] = np.nan
    height = reconstruct(replace(correspondence, u=u), scene)
    assert height.flags[7, 9] == 128
    assert np.isnan(height.z[7, 9])
    assert np.isfinite(height.z[height.good]).all()
    assert np.nanmax(np.abs(height.z - truth.z)) < 1e-3


def test_a_camera_far_larger_than_the_correspondence(case) -> None:
    """The sizes are compared before any ray is made: of 65536 x 65536 pixels they are 32 GiB and more."""
    scene, _, correspondence = case
    camera = replace(scene.camera, rows=65536, cols=65536)
    assert "the scene's camera has 65536 x 65536" in complaint(correspondence, replace(scene, camera=camera))


def test_an_anchor_beyond_all_scenes(case) -> None:
    scene, _, correspondence = case
    message = complaint(correspondence, scene, anchor=(1e308, 0.0, 0.0))
    assert "anchor.x = 1e+308: must be finite, at most 1e+09 mm" in message
