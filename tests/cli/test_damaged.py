"""Damaged and absurd inputs: one line, exit code 2, nothing written, whatever the file claims to be."""

import io
import struct
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from optolever.decode import Correspondence
from optolever.reconstruct import exact_correspondence, reconstruct
from optolever.scene import dent, load, resize, trace

from .conftest import Chain, Refused

Fields = dict[str, Any]


def fields() -> Fields:
    scene = resize(load("prism48", exact=True), 24, 32)
    seen = exact_correspondence(trace(scene, dent("flat", scene)))
    return {name: getattr(seen, name) for name in ("u", "v", "sigma_u", "sigma_v", "flags")}


def written(path: Path, arrays: Fields, change: Any = None) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        for name, value in arrays.items():
            stream = io.BytesIO()
            np.lib.format.write_array(stream, np.asarray(value), allow_pickle=False)
            data = stream.getvalue()
            archive.writestr(f"{name}.npy", change(name, data) if change else data)
    return path


def lying(name: str, data: bytes) -> bytes:
    """A header that claims 10^6 times the rows."""
    return data.replace(b"(24, 32)", b"(24000000, 32)") if name == "u" else data


def unknown_method(path: Path) -> Path:
    data = bytearray(written(path, fields()).read_bytes())
    at = 0
    while (at := data.find(b"PK\x01\x02", at)) >= 0:  # central directory: method at byte 10
        data[at + 10 : at + 12] = struct.pack("<H", 77)
        at += 4
    path.write_bytes(data)
    return path


@pytest.mark.parametrize(
    "damage",
    [
        unknown_method,
        lambda path: written(path, fields(), lying),
        lambda path: written(path, fields() | {"u": np.full((24, 32), "1.0")}),
        lambda path: written(path, fields() | {"u": np.zeros((24, 31))}),
        lambda path: written(path, fields(), lambda name, data: data[: len(data) // 2]),
    ],
)
def test_npz(damage: Any, tmp_path: Path, refused: Refused) -> None:
    path = damage(tmp_path / "c.npz")
    refused(["reconstruct", path, "--scene", "prism48", "--out", tmp_path / "h.npz"], "c.npz")


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("normal", np.zeros((96, 96)), "normal has shape (96, 96)"),
        ("u", np.zeros((0, 96)), "(0, 96)"),
        (None, np.s_[:48], "z has shape (48, 96), the height map (96, 96)"),
    ],
)
def test_truth_of_another_shape(
    name: str | None, value: Any, words: str, chain: Chain, tmp_path: Path, refused: Refused
) -> None:
    with np.load(chain.capture / "truth.npz") as archive:
        arrays = dict(archive)
    changed = {key: array[value] for key, array in arrays.items()} if name is None else {name: value}
    truth = written(tmp_path / "truth.npz", arrays | changed)
    refused([*chain.solve, "--truth", truth, "--out", tmp_path / "h.npz"], "truth.npz", words)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        ({"x": np.ones(1_000_000)}, "fringe_images is uint8 (6, 8, 8), must be uint8 (H, W, 4000004)"),
        ({"x": np.ones(0), "images": np.zeros((6, 8, 4), np.uint8)}, "fringe_periods_x"),
        ({"images": np.zeros((6, 8, 8))}, "float64"),
        ({"masks": np.zeros((2, 6, 8), np.uint8)}, "(2, 6, 8)"),
    ],
)
def test_fields_of_sofast(damage: Fields, words: str, tmp_path: Path, refused: Refused) -> None:
    h5py = pytest.importorskip("h5py")
    given = {"images": np.zeros((6, 8, 8), np.uint8), "masks": np.zeros((6, 8, 2), np.uint8)}
    given |= {"x": np.ones(1), "y": np.ones(1)} | damage
    names = dict(
        zip(given, ("fringe_images", "mask_images", "fringe_periods_x", "fringe_periods_y"), strict=True)
    )
    with h5py.File(tmp_path / "m.h5", "w") as file:
        for name, value in given.items():
            file[f"MeasurementSofastFringe/{names[name]}"] = value
    assert len(refused(["decode", tmp_path / "m.h5", "--out", tmp_path / "c.npz"], words)) < 400


def test_places_far_off_the_pattern_are_not_solved() -> None:
    scene, arrays = resize(load("prism48", exact=True), 24, 32), fields()
    places = np.argwhere(arrays["flags"] == 0)[[200, 300, 400]]
    for (row, col), far in zip(places, (1e38, -1e6, 500.0), strict=True):
        arrays["u"][row, col] = far
    found = reconstruct(Correspondence(**arrays), scene)
    assert all(found.flags[row, col] != 0 for row, col in places)
    assert np.abs(found.z[found.good]).max() < 1e-4
