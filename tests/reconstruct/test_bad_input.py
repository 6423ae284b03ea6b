"""Bad input to reconstruct(): one line that names the field, the value and the limit."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from optolever import InputError
from optolever.decode import Correspondence, SharedNoise
from optolever.reconstruct import HeightMap, PixelAnchor, PointAnchor, reconstruct
from optolever.scene import load

from .conftest import exact_case

SHAPE = (24, 32)
SIMULATION = load("paper-simulation", exact=True)


@pytest.fixture(scope="module")
def case(exact):
    return exact("paper-simulation", "raised-cosine", *SHAPE)


def spoilt(value: float) -> np.ndarray:
    sigma = np.full(SHAPE, 0.02)
    sigma[3, 4] = value
    return sigma


def box(rows: slice, cols: slice) -> np.ndarray:
    inside = np.zeros(SHAPE, dtype=bool)
    inside[rows, cols] = True
    return inside


#: Of another size.
SMALL: Correspondence = exact_case("paper-simulation", "flat", 20, 24)[2]

#: Fields of the correspondence, arguments of reconstruct, words that the message holds.
BAD: list[tuple[dict[str, Any], dict[str, Any], tuple[str, ...]]] = [
    ({}, {"scene": SIMULATION}, ("24 x 32",)),
    ({}, {"scene": "paper-simulation"}, ("scene: 'paper-simulation', must be a scene.Scene",)),
    # sizes are compared before any ray is made: of 65536 x 65536 pixels they are 32 GiB and more
    ({}, {"scene": replace(SIMULATION, camera=replace(SIMULATION.camera, rows=65536, cols=65536))},
     ("the scene's camera has 65536 x 65536",)),
    ({}, {"mask": np.zeros(SHAPE, dtype=bool)}, ("no pixel",)),
    ({"flags": np.ones(SHAPE, dtype=np.uint16)}, {}, ("no pixel",)),
    ({}, {"mask": np.ones((3, 3), dtype=bool)}, ("(24, 32)",)),
    ({"sigma_u": spoilt(np.nan)}, {}, ("sigma_u", "(3, 4)")),
    ({"sigma_v": spoilt(-1.0)}, {}, ("sigma_v", "(3, 4)")),
    ({"sigma_v": spoilt(np.inf)}, {}, ("sigma_v", "(3, 4)")),
    ({"v": np.full(SHAPE, np.nan)}, {}, ("v", "both axes")),
    ({}, {"rest": SMALL}, ("rest", "24 x 32")),
    *(({}, {"anchor": anchor}, ("anchor",)) for anchor in
      ("none", "somewhere", [], [None], 7.0, (1.0, 2.0), (1.0, 2.0, "a"), PointAnchor(1.0, 2.0, np.nan))),
    ({}, {"anchor": PixelAnchor(100, 3, 0.0)}, ("outside",)),
    ({}, {"anchor": PointAnchor(80.0, 900.0, 0.0)}, ("outside",)),
    ({}, {"anchor": (1e308, 0.0, 0.0)}, ("anchor.x = 1e+308: must be finite, from -1e+09 to 1e+09 mm",)),
    ({}, {"mask": box(slice(None), slice(10, 20))}, ("edge", "163.7")),
    ({}, {"mask": ~box(slice(5, 20), slice(5, 25)), "anchor": PixelAnchor(12, 15, 0.5)}, ("anchor",)),
]  # fmt: skip


@pytest.mark.parametrize(("fields", "arguments", "words"), BAD)
def test_refused(case, fields: dict[str, Any], arguments: dict[str, Any], words: tuple[str, ...]) -> None:
    scene, _, correspondence = case
    with pytest.raises(InputError) as caught:
        reconstruct(replace(correspondence, **fields), **{"scene": scene, **arguments})
    assert all(word in str(caught.value) for word in words)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("contacts", "5", "contacts is 5, must be a list"),
        ("contacts", '[{"x": []}]', "contacts[0].x is [], must be a number"),
        ("diagnostics", '{"method": 5}', "diagnostics.method is 5, must be text"),
        ("diagnostics", "[", "diagnostics is no JSON"),
        ("notices", ["no json"], "notices is no JSON"),
        ("notices", ['{"name": "a", "size": null}'], "notices[0].size is None, must be a number"),
        ("flags", np.zeros(SHAPE), "flags is float64 of shape (24, 32), must be an array of whole numbers"),
        ("sigma", np.zeros((24, 31)), "sigma has shape (24, 31), must be H (24) x W (32)"),
        ("modes", np.zeros((2, 24)), "modes has shape (2, 24), must be r x rows x cols"),
        ("modes_step", 1.5, "modes_step is 1.5, must be a whole number"),
        ("own", 3, "own is 3, must be 0 to 0"),
        ("z", np.full(SHAPE, -1e38), "z is 1e+38, must be at most 1e+18 in size"),
        ("x", np.full(SHAPE, np.nan), "x is nan at pixel (0, 0), which has no flag"),
        ("y", np.full(SHAPE, np.inf), "y is inf at pixel (0, 0), which has no flag"),
        ("z", np.full(SHAPE, np.nan), "z is nan at pixel (0, 0), which has no flag"),
        ("modes_step", np.nan, "modes_step is nan, must be a whole number"),
        ("own", np.inf, "own is inf, must be a whole number"),
        ("displacement", 0.0, "displacement has shape (), must be m x 2 x 3"),
    ],
)
def test_a_damaged_height_map_names_file_and_field(name: str, value: Any, words: str, tmp_path: Path) -> None:
    good = HeightMap(*np.zeros((3, *SHAPE)), np.ones(SHAPE), np.zeros(SHAPE, np.uint16))
    good.save(tmp_path / "h.npz")
    assert HeightMap.load(tmp_path / "h.npz") == good
    with np.load(tmp_path / "h.npz") as stored:
        np.savez(tmp_path / "bad.npz", **{**stored, name: np.array(value)})
    with pytest.raises(InputError, match="^" + re.escape(f"{tmp_path / 'bad.npz'}: ")) as caught:
        HeightMap.load(tmp_path / "bad.npz")
    assert words in str(caught.value)


@pytest.mark.parametrize("name", ["u", "amplitude"])
def test_a_correspondence_stored_in_half_precision_is_reconstructed(case, name: str, tmp_path: Path) -> None:
    scene, _, exact = case
    lens = SharedNoise(0, 0, 0, 0, 1, 1, lens_u=0.1, lens_v=0.1)
    correspondence = replace(exact, amplitude=np.full(SHAPE, 80.7, np.float32), shared_noise=lens)
    correspondence.save(tmp_path / "c.npz")
    with np.load(tmp_path / "c.npz") as stored:
        np.savez(tmp_path / "half.npz", **{**stored, name: stored[name].astype(np.float16)})
    rounded = getattr(correspondence, name).astype(np.float16).astype(np.float32)
    expected = reconstruct(replace(correspondence, **{name: rounded}), scene)
    assert reconstruct(Correspondence.load(tmp_path / "half.npz"), scene) == expected


def test_nan_in_an_unflagged_pixel_is_flagged_not_fatal(case) -> None:
    scene, truth, correspondence = case
    u = correspondence.u.copy()
    u[7, 9] = np.nan
    height = reconstruct(replace(correspondence, u=u), scene)
    assert height.flags[7, 9] == 128
    assert np.isnan(height.z[7, 9])
    assert np.isfinite(height.z[height.good]).all()
    assert np.nanmax(np.abs(height.z - truth.z)) < 1e-3
