"""Damaged and absurd inputs: one line, exit code 2, nothing written, whatever the file claims to be."""

import io
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from optolever import memory
from optolever.decode import Correspondence
from optolever.errors import InputError
from optolever.pictures import read_picture
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
        lambda path: written(path, fields() | {"u": np.full((24, 32), 1j)}),
        lambda path: written(path, fields() | {"u": np.full((24, 32), np.datetime64("2020-01-01"))}),
        lambda path: written(path, fields() | {"u": np.zeros((24, 31))}),
        lambda path: written(path, fields(), lambda name, data: data[: len(data) // 2]),
    ],
)
def test_npz(damage: Any, tmp_path: Path, refused: Refused) -> None:
    path = damage(tmp_path / "c.npz")
    refused(["reconstruct", path, "--scene", "prism48", "--out", tmp_path / "h.npz"], "c.npz")


def test_fields_of_an_npz_count_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path / "c.npz", fields())
    held = sum(value.nbytes for value in fields().values())
    monkeypatch.setattr(memory, "free_memory", lambda: held)
    Correspondence.load(path)
    monkeypatch.setattr(memory, "free_memory", lambda: held - 1)
    with pytest.raises(InputError, match=r"c\.npz: 5 fields, .*GiB"):
        Correspondence.load(path)


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("normal", np.zeros((96, 96)), "normal has shape (96, 96)"),
        ("z", np.zeros((96, 95)), "z has shape (96, 95)"),
        ("u", np.zeros((0, 96)), "(0, 96)"),
        ("visible", np.ones((1, 96, 96), np.bool_), "visible has shape (1, 96, 96)"),
        (None, np.s_[:48], "z has shape (48, 96), the height map (96, 96)"),
        (None, np.s_[None], "(1, 96, 96)"),
    ],
)
def test_truth_of_another_shape(
    name: str | None, value: Any, said: str, chain: Chain, tmp_path: Path, refused: Refused
) -> None:
    with np.load(chain.capture / "truth.npz") as archive:
        arrays = dict(archive)
    changed = {key: array[value] for key, array in arrays.items()} if name is None else {name: value}
    truth = written(tmp_path / "truth.npz", arrays | changed)
    refused([*chain.solve, "--truth", truth, "--out", tmp_path / "h.npz"], "truth.npz", said)


def sofast(path: Path, images: Any, masks: Any, x: Any, y: Any) -> Path:
    h5py = pytest.importorskip("h5py")
    names = ("fringe_images", "mask_images", "fringe_periods_x", "fringe_periods_y")
    with h5py.File(path, "w") as file:
        for name, value in zip(names, (images, masks, x, y), strict=True):
            file[f"MeasurementSofastFringe/{name}"] = value
    return path


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        ({"x": np.ones((1000, 1000))}, "fringe_periods_x has shape (1000, 1000)"),
        ({"x": np.ones(1_000_000)}, "fringe_images is uint8 (6, 8, 8), must be uint8 (H, W, 4000004)"),
        ({"x": np.nextafter(np.zeros(1, np.longdouble), 1)}, "fringe_periods_x"),
        ({"x": np.ones(0), "images": np.zeros((6, 8, 4), np.uint8)}, "fringe_periods_x"),
        ({"images": np.zeros((6, 8, 7), np.uint8)}, "(6, 8, 7)"),
        ({"images": np.zeros((6, 8, 8))}, "float64"),
        ({"masks": np.zeros((2, 6, 8), np.uint8)}, "(2, 6, 8)"),
    ],
)
def test_fields_of_sofast(damage: Fields, said: str, tmp_path: Path, refused: Refused) -> None:
    whole = {
        "images": np.zeros((6, 8, 8), np.uint8),
        "masks": np.zeros((6, 8, 2), np.uint8),
        "x": np.ones(1),
        "y": np.ones(1),
    }
    path = sofast(tmp_path / "m.h5", **(whole | damage))
    assert len(refused(["decode", path, "--out", tmp_path / "c.npz"], said)) < 400


@pytest.mark.parametrize("far", [1e38, -1e6, 500.0])
def test_places_far_off_the_pattern_are_not_solved(far: float) -> None:
    scene, arrays = resize(load("prism48", exact=True), 24, 32), fields()
    row, col = np.argwhere(arrays["flags"] == 0)[200]
    arrays["u"][row, col] = far
    found = reconstruct(Correspondence(**arrays), scene)
    assert found.flags[row, col] != 0
    assert np.abs(found.z[found.good]).max() < 1e-4


def _png(rows: int, cols: int, data: bytes) -> bytes:
    """A PNG whose header claims so many grey pixels; checksums are right."""

    def chunk(kind: bytes, of: bytes) -> bytes:
        return struct.pack(">I", len(of)) + kind + of + struct.pack(">I", zlib.crc32(kind + of))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", cols, rows, 8, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", zlib.compress(data)) + chunk(b"IEND", b"")


@pytest.mark.parametrize("size", [(60000, 60000), (20000, 20000)])
def test_a_picture_that_claims_more_than_it_holds(size: tuple[int, int], tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(_png(*size, bytes(1000)))
    with pytest.raises(InputError, match=rf"a\.png: claims {size[0]}x{size[1]} pixels"):
        read_picture(path)
