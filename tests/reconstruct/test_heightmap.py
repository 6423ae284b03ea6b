"""HeightMap: its files."""

import json
from pathlib import Path

import numpy as np
import pytest
import tifffile

from optolever import InputError
from optolever.reconstruct import Diagnostics, HeightMap

ROWS, COLS = 20, 30


@pytest.fixture
def plane() -> HeightMap:
    """z = 0.1 x - 0.2 y + 1 on a skewed grid, one bad pixel."""
    row, col = np.mgrid[:ROWS, :COLS].astype(float)
    x, y = 0.5 * (COLS - col) + 0.1 * row, 0.4 * row
    z = 0.1 * x - 0.2 * y + 1
    flags = np.zeros((ROWS, COLS), dtype=np.uint16)
    flags[5, 6] = 2048
    return HeightMap(x, y, z, 0.01 + 0.001 * x, flags, Diagnostics("coupled", steps=(0.1, 1e-6), defect=0.6))


def test_npz_without_diagnostics(plane: HeightMap, tmp_path: Path) -> None:
    np.savez(tmp_path / "h.npz", x=plane.x, y=plane.y, z=plane.z, sigma=plane.sigma, flags=plane.flags)
    assert HeightMap.load(tmp_path / "h.npz").diagnostics.method == "unknown"


def test_broken_npz(plane: HeightMap, tmp_path: Path) -> None:
    np.savez(
        tmp_path / "shape.npz", x=plane.x, y=plane.y, z=plane.z, sigma=plane.sigma[:3], flags=plane.flags
    )
    with pytest.raises(InputError, match="shape"):
        HeightMap.load(tmp_path / "shape.npz")


def test_tiff(plane: HeightMap, tmp_path: Path) -> None:
    plane.save_tiff(tmp_path / "h.tif")
    image = tifffile.imread(tmp_path / "h.tif")
    assert image.dtype == np.float32
    assert np.isnan(image[5, 6])
    good = plane.good
    np.testing.assert_allclose(image[good], plane.z[good], rtol=1e-6)


def read_ply(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles, by the header alone."""
    head, body = path.read_bytes().split(b"end_header\n", 1)
    lines = head.decode().splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    counts = {line.split()[1]: int(line.split()[2]) for line in lines if line.startswith("element")}
    names = [line.split()[2] for line in lines if line.startswith("property float")]
    vertex = np.dtype([(name, "<f4") for name in names])
    vertices = np.frombuffer(body, vertex, counts["vertex"])
    face = np.dtype([("count", "u1"), ("corners", "<i4", 3)])
    faces = np.frombuffer(body, face, counts["face"], offset=vertices.nbytes)
    assert vertices.nbytes + faces.nbytes == len(body)
    assert np.all(faces["count"] == 3)
    return vertices, faces["corners"]


def test_ply(plane: HeightMap, tmp_path: Path) -> None:
    plane.save_ply(tmp_path / "h.ply")
    vertices, triangles = read_ply(tmp_path / "h.ply")
    assert len(vertices) == ROWS * COLS - 1
    assert len(triangles) == 2 * (ROWS - 1) * (COLS - 1) - 6
    assert triangles.min() == 0
    assert triangles.max() == len(vertices) - 1
    np.testing.assert_allclose(
        vertices["z"], 0.1 * vertices["x"] - 0.2 * vertices["y"] + 1, rtol=1e-5, atol=1e-6
    )
    corners = np.stack([vertices["x"], vertices["y"]], axis=1)[triangles]
    edges = np.diff(corners, axis=1)
    areas = 0.5 * np.abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0])
    np.testing.assert_allclose(areas, 0.5 * 0.5 * 0.4, rtol=1e-4)


@pytest.mark.parametrize("pitch", [0.0, -1.0, np.nan, 1e-6])
def test_resample_refuses(plane: HeightMap, pitch: float) -> None:
    with pytest.raises(InputError, match="pitch"):
        plane.resample(pitch)


def test_diagnostics_are_plain_json(plane: HeightMap) -> None:
    assert json.loads(plane.diagnostics.to_json())["steps"] == [0.1, 1e-6]
