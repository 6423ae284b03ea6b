"""HeightMap's files; X3P as the standard asks, and read by a program by others."""

import hashlib
import importlib.util
import json
import subprocess
import sys
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import tifffile

from optolever import InputError
from optolever.reconstruct import Diagnostics, Grid, HeightMap

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


READER = """
import json, sys
import numpy as np
from SurfaceTopography import open_topography
surface = open_topography(sys.argv[1]).topography()
heights = np.ma.filled(surface.heights().astype(float), np.nan)
json.dump({"unit": surface.unit, "sizes": surface.physical_sizes, "shape": heights.shape,
           "heights": [None if np.isnan(v) else v for v in heights.ravel().tolist()]}, sys.stdout)
"""


@pytest.fixture
def grid() -> Grid:
    rng = np.random.default_rng(4)
    z = rng.standard_normal((5, 7))
    z[2, 3] = np.nan
    return Grid(z, np.full(z.shape, 0.01), x0=-1.5, y0=2.0, pitch=0.25)


def test_container(grid: Grid, tmp_path: Path) -> None:
    grid.save_x3p(tmp_path / "h.x3p")
    with zipfile.ZipFile(tmp_path / "h.x3p") as archive:
        document, data = archive.read("main.xml"), archive.read("bindata/data.bin")
        assert archive.read("md5checksum.hex").split()[0].decode() == hashlib.md5(document).hexdigest()
    root = ElementTree.fromstring(document)
    assert root.tag == "{http://www.opengps.eu/2008/ISO5436_2}ISO5436_2"
    assert [child.tag for child in root] == ["Record1", "Record2", "Record3", "Record4"]

    def text(path: str) -> str:
        found = root.findtext(path)
        assert found is not None, path
        return found

    assert text("Record3/DataLink/MD5ChecksumPointData") == hashlib.md5(data).hexdigest()
    assert [text(f"Record3/MatrixDimension/Size{axis}") for axis in "XYZ"] == ["7", "5", "1"]
    assert [text(f"Record1/Axes/C{axis}/AxisType") for axis in "XYZ"] == ["I", "I", "A"]
    assert float(text("Record1/Axes/CX/Increment")) == pytest.approx(0.25e-3)
    assert float(text("Record1/Axes/CX/Offset")) == pytest.approx(-1.5e-3)
    assert float(text("Record1/Axes/CY/Offset")) == pytest.approx(2e-3)
    stored = np.frombuffer(data, "<f8").reshape(5, 7)
    np.testing.assert_allclose(stored, grid.z * 1e-3)


def test_read_by_surface_topography(grid: Grid, tmp_path: Path) -> None:
    """In a process of its own: importing it warns."""
    if importlib.util.find_spec("SurfaceTopography") is None:
        pytest.skip("SurfaceTopography is not installed (extra dev)")
    grid.save_x3p(tmp_path / "h.x3p")
    command = [sys.executable, "-W", "ignore", "-c", READER, str(tmp_path / "h.x3p")]
    read = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    assert read["unit"] == "m"
    assert read["sizes"] == pytest.approx([7 * 0.25e-3, 5 * 0.25e-3])
    heights = np.array(read["heights"], dtype=float).reshape(read["shape"])  # (x, y)
    np.testing.assert_allclose(heights.T, grid.z * 1e-3, rtol=1e-12)


def test_nothing_to_write(tmp_path: Path) -> None:
    empty = np.full((3, 3), np.nan)
    with pytest.raises(InputError, match="no good point"):
        Grid(empty, empty, 0.0, 0.0, 1.0).save_x3p(tmp_path / "h.x3p")
    assert not list(tmp_path.iterdir())
