"""Damaged and absurd inputs: one line, exit code 2, nothing written, whatever the file claims to be."""

import io
import struct
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from optolever.cli import run
from optolever.decode import Correspondence
from optolever.errors import InputError
from optolever.patterns import sequence_from_text
from optolever.reconstruct import reconstruct
from optolever.scene import dent, load, resize, trace

Fields = dict[str, Any]


def refused(args: list[str], capfd: pytest.CaptureFixture[str]) -> str:
    """The one line of a command that must end with 2."""
    assert run(args) == 2
    lines = capfd.readouterr().err.strip().splitlines()
    assert len(lines) == 1, lines
    return lines[0]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("binary:cell=false", "cell is False"),
        ("phase:counts=false", "counts is False"),
        ("stripe:step=false", "step is False"),
        ("stripe:step=1e-9", "step is 1e-09"),
        ("phase:steps=1000000", "steps is 1000000"),
        ("phase:steps=3.5", "steps is 3.5"),
        ("ramp:count=100000000", "count is 100000000"),
        ("gray:inverses=0.5", "inverses is 0.5"),
        ("phase:steps=4,steps=5", "steps is given twice"),
        ("phase:periods=16/0", "periods is (16, 0)"),
        ("phase:periods=1e999", "periods is inf"),
        ("gray+phase:period=-8", "period is -8"),
    ],
)
def test_parameters_of_sequences(text: str, said: str) -> None:
    with pytest.raises(InputError, match=r"must|twice") as error:
        sequence_from_text(text, 48, 64)
    assert said in str(error.value)


@pytest.mark.parametrize("size", ["20000x20000", "65536x65536"])
def test_sizes_that_no_memory_holds(size: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    sequence = ["--sequence", "phase:steps=64,periods=9/10/11"]
    said = refused(
        ["capture", "--scene", "paper-simulation", "--size", size, *sequence, "--out", str(tmp_path / "c")],
        capfd,
    )
    assert "GiB" in said
    assert not (tmp_path / "c").exists()


def test_an_exposure_without_end(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    text = Path("scene/presets/prism48.toml").read_text(encoding="utf-8")
    scene = tmp_path / "scene.toml"
    scene.write_text(text + "\n[sensor]\nexposure = 1e308\n" if "[sensor]" not in text else text)
    assert "exposure" in refused(["sensor", "--scene", str(scene), "--out", str(tmp_path / "s")], capfd)


def test_names_of_a_sweep(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    grid = tmp_path / "grid.toml"
    for scenes, sequences, dents in (
        ("nosuch", "gray", "flat"),
        ("prism48", "nosuch", "flat"),
        ("prism48", "gray", "nosuch"),
    ):
        grid.write_text(f'scenes = ["{scenes}"]\nsequences = ["{sequences}"]\ndents = ["{dents}"]\n')
        assert "nosuch" in refused(
            ["sweep", str(grid), "--workers", "0", "--out", str(tmp_path / "o")], capfd
        )


def fields() -> Fields:
    scene = resize(load("prism48"), 24, 32)
    seen = trace(scene, dent("flat", scene))
    sigma = np.full(seen.u.shape, 0.01)
    flags = np.where(seen.visible, 0, 128).astype(np.uint16)
    return {"u": seen.u, "v": seen.v, "sigma_u": sigma, "sigma_v": sigma.copy(), "flags": flags}


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


def encrypted(path: Path) -> Path:
    data = bytearray(written(path, fields()).read_bytes())
    for signature, offset in ((b"PK\x01\x02", 8), (b"PK\x03\x04", 6)):
        at = 0
        while (at := data.find(signature, at)) >= 0:
            data[at + offset] |= 1
            at += 4
    path.write_bytes(data)
    return path


@pytest.mark.parametrize(
    "damage",
    [
        unknown_method,
        encrypted,
        lambda path: written(path, fields(), lying),
        lambda path: written(path, fields() | {"u": np.full((24, 32), "1.0")}),
        lambda path: written(path, fields() | {"u": np.full((24, 32), 1j)}),
        lambda path: written(path, fields() | {"u": np.full((24, 32), np.datetime64("2020-01-01"))}),
        lambda path: written(path, fields() | {"u": np.zeros((24, 31))}),
        lambda path: written(path, fields(), lambda name, data: data[: len(data) // 2]),
    ],
)
def test_npz(damage: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path, out = damage(tmp_path / "c.npz"), tmp_path / "h.npz"
    said = refused(["reconstruct", str(path), "--scene", "prism48", "--out", str(out)], capfd)
    assert "c.npz" in said
    assert not out.exists()


def test_hdf5_that_claims_more_than_it_holds(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "m.h5"
    with h5py.File(path, "w") as file:
        for name in ("fringe_images", "mask_images", "fringe_periods_x", "fringe_periods_y"):
            shape = (40000, 40000, 16)
            file.create_dataset(f"MeasurementSofastFringe/{name}", shape, "u1", chunks=(1000, 1000, 1))
    assert "claims" in refused(["decode", str(path), "--out", str(tmp_path / "c.npz")], capfd)


@pytest.mark.parametrize("far", [1e38, -1e6, 500.0])
def test_places_far_off_the_pattern_are_not_solved(far: float) -> None:
    scene, arrays = resize(load("prism48"), 24, 32), fields()
    row, col = np.argwhere(arrays["flags"] == 0)[200]
    arrays["u"][row, col] = far
    found = reconstruct(Correspondence(**arrays), scene)
    assert found.flags[row, col] != 0
    assert np.abs(found.z[found.good]).max() < 1e-4
