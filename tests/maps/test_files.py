"""Heights in files of other programs: round trips, a DATX as Zygo lays it out, damaged files."""

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from optolever import InputError
from optolever.cli import run
from optolever.maps import READABLE, REGULAR, read_grid
from optolever.reconstruct import HeightMap

Floats = NDArray[np.float64]
PITCH, X0, Y0 = 0.25, -1.5, 2.0
#: Largest error of a format, mm: float32, nine digits, the finest step of heights up to 1 mm.
ERROR = {".tif": 1e-7, ".tiff": 1e-7, ".sdf": 1e-9, ".wft": 1e-9, ".dat": 2e-9}
PLACED = {".x3p", ".csv", ".npy"}


def disc() -> Floats:
    row, col = np.mgrid[:31, :31]
    z = 1e-3 * np.random.default_rng(4).standard_normal((31, 31)) + 0.1 * (col - 3) / 31
    z[np.hypot(row - 15, col - 15) > 15] = np.nan
    return np.asarray(z)


@pytest.mark.parametrize("suffix", REGULAR)
def test_what_is_written_is_read(tmp_path: Path, suffix: str) -> None:
    path, z = tmp_path / f"g{suffix}", disc()
    REGULAR[suffix](path, z, PITCH, X0, Y0)
    found = read_grid(path)
    np.testing.assert_allclose(found.z, z, rtol=0, atol=ERROR.get(suffix, 1e-12))
    assert found.pitch == pytest.approx(PITCH, rel=1e-6)
    assert (found.x0, found.y0) == pytest.approx((X0, Y0) if suffix in PLACED else (0, 0))


def test_a_wft_file_is_a_wavefront_of_both_ways_from_the_lowest_row_on(tmp_path: Path) -> None:
    z = disc()
    REGULAR[".wft"](tmp_path / "g.wft", z, PITCH, 0.0, 0.0)
    lines = (tmp_path / "g.wft").read_text().splitlines()
    assert lines[:2] == ["31", "31"]
    assert float(lines[2 + 15]) == pytest.approx(2 * z[30, 15] / 550e-6, rel=1e-6)
    assert lines[-4:] == ["outside ellipse 15 15 15 15", "DIAM 7.5", "ROC 0", "Lambda 550"]


def test_a_zygo_mx_file_is_read(tmp_path: Path) -> None:
    """Fringes, as MetroPro's successor stores them: scale, obliquity and wavelength (m) make them metres."""
    h5py = pytest.importorskip("h5py")
    z = disc()
    with h5py.File(tmp_path / "g.datx", "w") as tree:
        fringes = np.where(np.isnan(z), 1e30, z / (0.5 * 632.8e-6))
        surface = tree.create_dataset("Data/Surface/{id}", data=fringes)
        surface.attrs["No Data"] = [1e30]
        surface.attrs["Unit"] = np.array([b"Fringes"])
        surface.attrs["Interferometric Scale Factor"] = [0.5]
        surface.attrs["Obliquity Factor"] = [1.0]
        surface.attrs["Wavelength"] = [632.8e-9]
        kind = np.dtype([("Category", "S16"), ("BaseUnit", "S16"), ("Parameters", "f8", (4,))])
        for axis in "XY":
            surface.attrs[f"{axis} Converter"] = np.array(
                [(b"LateralCat", b"Pixels", (0, PITCH * 1e-3, 0, 0))], kind
            )
    found = read_grid(tmp_path / "g.datx")
    np.testing.assert_allclose(found.z, z, atol=1e-12)
    assert found.pitch == pytest.approx(PITCH)


def test_an_x3p_file_of_integers_and_a_mask_is_read(tmp_path: Path) -> None:
    """ISO 25178-72: a bit a point, 1 where it is valid, the lowest bit first; nm, from 20 um on."""
    z, links = disc(), "</PointDataLink><ValidPointsLink>bindata/valid.bin</ValidPointsLink>"
    REGULAR[".x3p"](tmp_path / "g.x3p", z, PITCH, X0, Y0)
    document = (
        zipfile.ZipFile(tmp_path / "g.x3p").read("main.xml").decode().replace("</PointDataLink>", links)
    )
    head, axis = document.split("<CZ><AxisType>A</AxisType><DataType>D</DataType>")
    kind = "<CZ><AxisType>A</AxisType><DataType>L</DataType><Increment>1e-9</Increment><Offset>2e-5</Offset>"
    with zipfile.ZipFile(tmp_path / "mask.x3p", "w") as file:
        file.writestr("main.xml", head + kind + axis)
        file.writestr("bindata/data.bin", np.round(1e6 * np.nan_to_num(z - 0.02)).astype("<i4").tobytes())
        file.writestr("bindata/valid.bin", np.packbits(np.isfinite(z), bitorder="little").tobytes())
    found = read_grid(tmp_path / "mask.x3p")
    np.testing.assert_allclose(found.z, z, rtol=0, atol=0.51e-6)
    assert (found.x0, found.y0, found.pitch) == pytest.approx((X0, Y0, PITCH))


def test_heights_are_of_mm(tmp_path: Path) -> None:
    """No heights are integers in a TIFF, whose unit is unknown, and those of another unit in tifffile's
    description, or in the first line of a CSV."""
    scale: dict[str, Any] = {"resolution": (40, 40), "resolutionunit": "CENTIMETER"}
    path, z = tmp_path / "g.tif", np.nan_to_num(disc()).astype(np.float32)
    tifffile.imwrite(path, z, **scale)
    np.testing.assert_array_equal(read_grid(path).z, z)
    tifffile.imwrite(path, (1e6 * z).astype(np.uint16), metadata=None, **scale)
    with pytest.raises(InputError, match="uint16, their unit unknown; scale them to floats in mm"):
        read_grid(path)
    tifffile.imwrite(path, z, metadata={"unit": "um"}, **scale)
    with pytest.raises(InputError, match="float32, their unit um; scale them to floats in mm"):
        read_grid(path)
    table = tmp_path / "g.csv"
    table.write_text("# heights in um; pitch 1.0\n1,2\n3,4\n")
    with pytest.raises(InputError, match=r"g\.csv: heights in um, must be in mm; scale them"):
        read_grid(table)


def test_zernike_terms_are_of_the_circle_that_is_named(tmp_path: Path) -> None:
    """Amplitudes of defocus, astigmatism and coma at the rim of a circle in a map that goes on."""
    x, y = np.meshgrid(np.arange(-40, 41.0), np.arange(-30, 31.0))
    u, v = (x - 3) / 25, (y + 2) / 25
    given = {"Defocus": 0.3, "Primary Astigmatism 00°": 0.1, "Primary Coma X": 0.2, "Primary Coma Y": 0.07}
    square = u**2 + v**2
    parts = 2 * square - 1, u**2 - v**2, (3 * square - 2) * u, (3 * square - 2) * v
    z = 1e-3 * sum(size * part for size, part in zip(given.values(), parts, strict=True))
    REGULAR[".csv"](tmp_path / "g.csv", z, 1.0, -40.0, -30.0)
    words = "form {}/g.csv --remove piston --aperture circle:radius=25,x=3,y=-2 --zernike 3:norm=amplitude"
    assert run([*words.format(tmp_path).split(), "--json", str(tmp_path / "f.json")]) == 0
    found = json.loads((tmp_path / "f.json").read_text())["zernike"]
    assert found["radius_mm"] == 25
    for name, term in found["coefficients_mm"].items():
        own = 1e-3 * given.get(name.partition(" ")[2], 0.0)
        assert "Piston" in name or term["value"] == pytest.approx(own, abs=1e-9), name


@pytest.mark.parametrize("suffix", [each for each in READABLE if each != ".datx"])
def test_a_damaged_file_is_one_line(tmp_path: Path, suffix: str) -> None:
    """Cut, or with bytes changed: a line that names the file, or a map of the same size."""
    path = tmp_path / f"g{suffix}"
    REGULAR[suffix](path, disc(), PITCH, X0, Y0)
    whole, rng, said = path.read_bytes(), np.random.default_rng(1), list[str]()
    for kind in range(40):
        spoilt = bytearray(whole[: rng.integers(1, len(whole))] if kind % 2 else whole)
        for at in rng.integers(0, min(len(spoilt), 900), 6):
            spoilt[at] = rng.integers(0, 256)
        path.write_bytes(spoilt)
        try:
            found = read_grid(path)
        except InputError as error:
            said.append(str(error))
        else:
            assert not np.isinf(found.z).any()
    assert len(said) > 5
    assert all(str(path) in each and "\n" not in each for each in said)


def test_what_form_and_export_write_is_read_and_exported_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """A map, its residual in a circle, grids of both as .npz and of other programs, a mean of maps."""
    monkeypatch.chdir(tmp_path)
    row, col = np.mgrid[:40, :50] * 1.0
    z = 1e-4 * ((col - 25) ** 2 + (row - 20) ** 2) + 1e-3 * np.sin(col / 5)
    HeightMap(col, row, z, 0 * z, np.zeros(z.shape, np.uint16)).save("h.npz")
    assert run(["export", "h.npz", "h.wft"]) == 2
    assert "`form --aperture circle --out FILE.wft`" in capfd.readouterr().err
    for words in (
        "form h.npz --aperture circle --out r.wft",
        "form h.npz --aperture circle --out r.npz",
        "export r.npz again.wft",
        "export h.npz g.npz g.x3p --pitch 1",
        "export g.npz g.csv",
        "export g.csv again.npy",
        "form g.npz h.npz --remove paraboloid --out mean.npz",
        "export mean.npz mean.sdf",
        "form g.x3p --nominal g.csv --out none.npz",
        "form g.x3p --remove paraboloid --json f.json",
    ):
        assert run(words.split()) == 0, words
    np.testing.assert_allclose(read_grid(Path("g.csv")).z, z, atol=1e-8)
    np.testing.assert_array_equal(read_grid(Path("again.npy")).z, read_grid(Path("g.csv")).z)
    left, mean = read_grid(Path("r.wft")).z, HeightMap.load("mean.npz")
    np.testing.assert_allclose(read_grid(Path("again.wft")).z, left, atol=1e-8)
    assert 3e-4 < np.nanstd(left) < 8e-4
    assert np.nanmax(np.abs(HeightMap.load("none.npz").z)) < 1e-7
    assert json.loads(Path("f.json").read_text())["numbers"]["focal"]["value"] == pytest.approx(
        2500, rel=0.02
    )
    assert 3e-4 < np.std(mean.z[mean.good]) < 8e-4
