"""Heights in the formats of other programs, read back by those programs; files of heights and their size."""

import importlib.util
import json
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from optolever import InputError
from optolever.cli import run
from optolever.reconstruct import (
    GRID_FORMATS,
    HEIGHT_FORMATS,
    Grid,
    HeightMap,
    exact_correspondence,
    reconstruct,
)
from optolever.scene import dent, load, resize, trace

ROWS, COLS = 20, 30
#: Opens a file by a program named on its command line; prints what it read, in that program's own units.
READER = """
import importlib.metadata, json, sys, types
import numpy as np

program, path = sys.argv[1:]
told = {}
if program == "SurfaceTopography":
    from SurfaceTopography import open_topography
    surface = open_topography(path).topography()
    data = np.ma.filled(surface.heights().astype(float), np.nan).T
    told = {"unit": surface.unit, "step": surface.physical_sizes[0] / data.shape[1]}
elif program == "surfalize":
    from surfalize import Surface
    surface = Surface.load(path)
    data, told = surface.data, {"unit": "µm", "step": surface.step_x}
elif program == "prysm":
    # prysm asks setuptools' former module for its own version
    module = types.ModuleType("pkg_resources")
    module.get_distribution = importlib.metadata.distribution
    sys.modules["pkg_resources"] = module
    from prysm.io import read_zygo_dat
    found = read_zygo_dat(path)
    data, told = found["phase"], {"unit": "nm", "step": found["meta"]["lateral_resolution"] * 1e9}
else:
    import trimesh
    mesh = trimesh.load(path)
    data = np.asarray(mesh.vertices)
    if hasattr(mesh, "faces"):
        up = float(mesh.face_normals[:, 2].min())
        told = {"faces": len(mesh.faces), "area": float(mesh.area), "up": up}
json.dump(told | {"data": [[None if np.isnan(v) else v for v in row] for row in data.tolist()]}, sys.stdout)
"""
PER_MM = {"m": 1e-3, "mm": 1.0, "µm": 1e3, "nm": 1e6}


def read(program: str, path: Path) -> dict[str, Any]:
    """What a program reads in a file: in a process of its own, since importing it warns."""
    if importlib.util.find_spec(program) is None:
        pytest.skip(f"{program} is not installed (extra dev)")
    command = [sys.executable, "-W", "ignore", "-c", READER, program, str(path)]
    told: dict[str, Any] = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    return told


@pytest.fixture
def grid() -> Grid:
    z = 0.3 * np.random.default_rng(4).standard_normal((5, 7))
    z[2, 3] = np.nan
    return Grid(z, np.full(z.shape, 0.01), x0=-1.5, y0=2.0, pitch=0.25)


@pytest.fixture
def plane() -> HeightMap:
    """z = 0.1 x - 0.2 y + 1 on a skewed grid, one bad pixel."""
    row, col = np.mgrid[:ROWS, :COLS].astype(float)
    x, y = 0.5 * (COLS - col) + 0.1 * row, 0.4 * row
    flags = np.zeros((ROWS, COLS), np.uint16)
    flags[5, 6] = 2048
    return HeightMap(x, y, 0.1 * x - 0.2 * y + 1, 0.01 + 0.001 * x, flags)


@pytest.mark.parametrize(
    ("suffix", "program", "atol_mm"),
    [
        (".x3p", "SurfaceTopography", 1e-12),
        (".x3p", "surfalize", 1e-12),
        (".sdf", "SurfaceTopography", 1e-9),
        (".sdf", "surfalize", 1e-9),
        (".dat", "SurfaceTopography", 2e-9),
        (".dat", "prysm", 3e-8),  # prysm holds it as float32
    ],
)
def test_a_grid_is_read_by_others(
    grid: Grid, tmp_path: Path, suffix: str, program: str, atol_mm: float
) -> None:
    path = tmp_path / f"g{suffix}"
    grid.export(path)
    told = read(program, path)
    scale = PER_MM[told["unit"]]
    assert told["step"] == pytest.approx(0.25 * scale, rel=1e-6)
    np.testing.assert_allclose(np.array(told["data"], float) / scale, grid.z, rtol=0, atol=atol_mm)


@pytest.mark.parametrize("suffix", [".ply", ".stl", ".xyz"])
def test_a_mesh_is_read_by_trimesh(plane: HeightMap, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"h{suffix}"
    plane.export(path)
    told = read("trimesh", path)
    points = np.array(told["data"])
    np.testing.assert_allclose(points[:, 2], 0.1 * points[:, 0] - 0.2 * points[:, 1] + 1, atol=2e-6)
    assert len(np.unique(np.round(points, 3), axis=0)) == ROWS * COLS - 1
    if suffix != ".xyz":
        whole = 2 * (ROWS - 1) * (COLS - 1) - 6
        assert told["faces"] == whole
        assert told["area"] == pytest.approx(whole * 0.5 * 0.5 * 0.4 * np.sqrt(1 + 0.1**2 + 0.2**2), rel=1e-4)
    if suffix == ".stl":
        assert told["up"] > 0.9


def test_unknown_suffixes_are_refused_and_the_known_ones_named(
    plane: HeightMap, grid: Grid, tmp_path: Path, refused: Any
) -> None:
    for record, formats in ((plane, HEIGHT_FORMATS), (grid, GRID_FORMATS)):
        with pytest.raises(InputError) as caught:
            record.export(tmp_path / "h.obj")
        assert all(suffix in str(caught.value) for suffix in formats)
    plane.save(tmp_path / "h.npz")
    refused(["export", tmp_path / "h.npz", tmp_path / "h.obj"], "h.obj: suffix '.obj'", *HEIGHT_FORMATS)


def test_export_by_the_command_line(plane: HeightMap, tmp_path: Path, refused: Any) -> None:
    plane.save(tmp_path / "h.npz")
    files = [tmp_path / f"out{suffix}" for suffix in HEIGHT_FORMATS if suffix != ".wft"]
    assert run(["export", str(tmp_path / "h.npz"), *map(str, files), "--pitch", "0.5"]) == 0
    assert all(path.stat().st_size > 500 for path in files)
    np.testing.assert_allclose(Grid.load(tmp_path / "out.npz").z, plane.resample(0.5).z, atol=1e-6)
    assert tifffile.imread(tmp_path / "out.tif").shape == plane.resample(0.5).z.shape
    plane.export(tmp_path / "pixels.tif")
    assert tifffile.imread(tmp_path / "pixels.tif").shape == (ROWS, COLS)
    refused(["export", tmp_path / "h.npz", tmp_path / "out.wft"], "no disc", "--aperture circle")


def test_figures_as_csv(plane: HeightMap, tmp_path: Path) -> None:
    plane.save(tmp_path / "h.npz")
    names = ["form", tmp_path / "h.npz", "--remove", "tilt", "--json"]
    for suffix in (".json", ".csv"):
        assert run([*map(str, names), str(tmp_path / f"f{suffix}")]) == 0
    header, *lines = (tmp_path / "f.csv").read_text().splitlines()
    figures = dict(line.split(",", 1) for line in lines)
    found: Mapping[str, Any] = json.loads((tmp_path / "f.json").read_text())
    assert header == "figure,value"
    assert float(figures["numbers.tilt_x.value"]) == found["numbers"]["tilt_x"]["value"]
    assert float(figures["rms_mm"]) == found["rms_mm"]


@pytest.mark.parametrize("masked", [False, True])
def test_modes_lie_on_a_coarse_grid_in_the_file_and_on_all_pixels_when_read(
    tmp_path: Path, masked: bool
) -> None:
    """A ragged mask, too: nodes of the grid lie where nothing is known."""
    rig = resize(load("monitor-mirror"), 205, 260)
    seen = exact_correspondence(trace(rig, dent("gaussian", rig)))
    mask = None
    if masked:
        row, col = np.mgrid[:205, :260]
        mask = (np.hypot(row - 100, 0.8 * (col - 130)) < 90) & ~((np.abs(row - 120) < 2) & (col > 100))
    height = reconstruct(seen, rig, anchor=(75.0, 60.0, 0.5), mask=mask)
    height.save(tmp_path / "h.npz")
    again = HeightMap.load(tmp_path / "h.npz")
    modes, found = height.calibration, again.calibration
    assert modes is not None
    assert found is not None
    assert found.shape == modes.shape
    with np.load(tmp_path / "h.npz") as file:
        assert file["modes"].shape[1:] == (103, 130)
        assert file["z"].dtype == np.float32
    assert (np.isfinite(found) == np.isfinite(modes)).all()
    scale = np.sqrt(np.nanmean(np.square(modes, dtype=np.float64), axis=(1, 2)))
    assert (np.nanmax(np.abs(found - modes), axis=(1, 2)) < 1e-3 * scale).all()
    np.testing.assert_allclose(again.z, height.z, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("pitch", [0.0, -1.0, np.nan, 1e-6])
def test_resample_refuses(plane: HeightMap, pitch: float) -> None:
    with pytest.raises(InputError, match="pitch"):
        plane.resample(pitch)


def test_nothing_to_write(tmp_path: Path) -> None:
    empty = np.full((3, 3), np.nan)
    with pytest.raises(InputError, match="no good point"):
        Grid(empty, empty, 0.0, 0.0, 1.0).export(tmp_path / "h.x3p")
    assert not list(tmp_path.iterdir())
