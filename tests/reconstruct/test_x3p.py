"""X3P: what the standard asks of the container, and that a program by others reads our heights."""

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

from optolever import InputError
from optolever.reconstruct import Grid

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
