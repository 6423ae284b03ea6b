"""HeightMap's files; X3P as the standard asks, and read by a program by others."""

import hashlib
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

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


@pytest.mark.parametrize("pitch", [0.0, -1.0, np.nan, 1e-6])
def test_resample_refuses(plane: HeightMap, pitch: float) -> None:
    with pytest.raises(InputError, match="pitch"):
        plane.resample(pitch)


@pytest.fixture
def grid() -> Grid:
    rng = np.random.default_rng(4)
    z = rng.standard_normal((5, 7))
    z[2, 3] = np.nan
    return Grid(z, np.full(z.shape, 0.01), x0=-1.5, y0=2.0, pitch=0.25)


def test_container(grid: Grid, tmp_path: Path) -> None:
    grid.export(tmp_path / "h.x3p")
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


def test_nothing_to_write(tmp_path: Path) -> None:
    empty = np.full((3, 3), np.nan)
    with pytest.raises(InputError, match="no good point"):
        Grid(empty, empty, 0.0, 0.0, 1.0).export(tmp_path / "h.x3p")
    assert not list(tmp_path.iterdir())
