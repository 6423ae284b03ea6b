"""A nominal surface after its rigid best fit; profiles and spectra: against closed forms."""

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever import InputError
from optolever.cli import run
from optolever.metrology import fit_nominal, load_nominal, profile, spectrum
from optolever.reconstruct import Diagnostics, Grid, HeightMap, integrate

Floats = NDArray[np.float64]
ERROR = 2e-4  # mm: what the measured mirror has and the nominal one has not


def design(x: Floats, y: Floats) -> Floats:
    """A mirror without symmetry: astigmatism, coma, a ripple."""
    u, v = x / 40, y / 40
    return np.asarray(
        0.8 * u * u - 0.5 * v * v + 0.2 * u * u * u + 0.15 * u * v * v + 0.02 * np.sin(4 * u + 3 * v)
    )


def fault(x: Floats, y: Floats) -> Floats:
    return np.asarray(ERROR * np.exp(-((x - 5) ** 2 + (y + 8) ** 2) / 50))


def rotation(x: float, y: float, z: float) -> Floats:
    """By the matrix exponential of a turn vector (rad): Rodrigues' formula."""
    angle = float(np.sqrt(x * x + y * y + z * z))
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) / angle
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)


def nominal_grid(pitch: float = 0.5) -> Grid:
    axis = np.arange(-50, 50 + pitch / 2, pitch)
    x, y = np.meshgrid(axis, axis)
    return Grid(design(x, y), np.zeros(x.shape), -50.0, -50.0, pitch)


def as_map(x: Floats, y: Floats, z: Floats) -> HeightMap:
    return HeightMap(x, y, z, np.zeros(z.shape), np.zeros(z.shape, np.uint16))


def measured(turn: tuple[float, float, float], shift: tuple[float, float, float]) -> tuple[HeightMap, Floats]:
    """The design with its fault, turned and shifted; and that fault, as the points have it."""
    v, u = np.mgrid[-30:30:81j, -36:36:97j]
    points = np.stack([u, v, design(u, v) + fault(u, v)]).reshape(3, -1)
    moved = rotation(*turn) @ points + np.array(shift)[:, None]
    x, y, z = (part.reshape(u.shape) for part in moved)
    return as_map(x, y, z), fault(u, v)


@pytest.mark.parametrize("suffix", [".npz", ".tif", ".stl", ".ply"])
def test_a_turned_and_shifted_mirror_is_laid_on_its_design(tmp_path: Path, suffix: str) -> None:
    path, grid = tmp_path / f"n{suffix}", nominal_grid(0.5 if suffix in (".npz", ".tif") else 1.0)
    if suffix in (".stl", ".ply"):
        pytest.importorskip("trimesh")
        x, y = np.meshgrid(grid.x, grid.y)
        as_map(x, y, grid.z).export(path)
    else:
        grid.export(path)
    height, true = measured((0.01, -0.015, 0.02), (101.0, 63.0, 2.0))
    fit = fit_nominal(height, load_nominal(path))
    found = dict(zip(fit.numbers.names, fit.numbers.values, strict=True))
    # the fault itself moves the best fit: of the height's rms by a part that a fit without motion tells
    still = fit_nominal(measured((1e-12, 0, 0), (0, 0, 0))[0], load_nominal(path))
    np.testing.assert_allclose(fit.residual, still.residual, atol=0.02 * ERROR)
    assert fit.pv == pytest.approx(true.max() - true.min(), rel=0.2)
    if suffix != ".tif":  # which has no origin
        assert [found[f"turn_{axis}"] for axis in "xyz"] == pytest.approx(
            [-np.degrees(part) for part in (0.01, -0.015, 0.02)], abs=2e-3
        )


def test_the_design_itself_leaves_nothing(tmp_path: Path) -> None:
    nominal_grid().save(tmp_path / "n.npz")
    v, u = np.mgrid[-30:30:81j, -36:36:97j]
    turned = rotation(0.003, 0.002, -0.004) @ np.stack([u, v, design(u, v)]).reshape(3, -1)
    fit = fit_nominal(as_map(*(part.reshape(u.shape) for part in turned)), load_nominal(tmp_path / "n.npz"))
    assert fit.rms < 2e-8
    assert max(fit.slope_rms) < 1e-7


def test_directions_that_change_nothing_stay(tmp_path: Path) -> None:
    """A sphere: its turns are shifts, and the turn about its axis is none."""
    axis = np.arange(-60, 60.5, 1.0)
    x, y = np.meshgrid(axis, axis)
    Grid(2000 - np.sqrt(2000**2 - x**2 - y**2), x, -60.0, -60.0, 1.0).save(tmp_path / "n.npz")
    v, u = np.mgrid[-30:30:81j, -36:36:97j]
    z = 2000 - np.sqrt(2000**2 - (u - 4) ** 2 - v**2)
    fit = fit_nominal(as_map(u, v, z), load_nominal(tmp_path / "n.npz"))
    assert fit.rms < 1e-7
    numbers = fit.numbers.to_dict()
    assert numbers["turn_z"]["value"] == 0
    assert np.isinf(numbers["turn_z"]["sigma"])
    fit.export(tmp_path / "r.npz", as_map(u, v, z))
    left = HeightMap.load(tmp_path / "r.npz")
    np.testing.assert_allclose(left.z[left.good], fit.residual[np.isfinite(fit.residual)], atol=1e-9)


@pytest.mark.daily(2)
@pytest.mark.parametrize("changed", ["noise", "figure"])
@pytest.mark.parametrize("shape", ["sphere", "design"])
def test_sigmas_of_a_motion_hold_noise_and_changed_figures(tmp_path: Path, shape: str, changed: str) -> None:
    """20 draws of slope noise, or of a bump: nothing moved. A bump on a sphere of 40 m looks like a shift
    (sigma seven times too wide, where the nominal surface's noise alone fixes it)."""
    form = design if shape == "design" else (lambda x, y: (x * x + y * y) / 8e4)
    axis = np.arange(-60, 61.0)
    x, y = np.meshgrid(axis, axis)
    own = integrate(*(3e-6 * np.random.default_rng(99).standard_normal((2, *x.shape))), spacing=1.0).z
    grid = form(x, y) + (own if shape == "sphere" else 0)
    Grid(grid, x, -60.0, -60.0, 1.0).save(tmp_path / "n.npz")
    nominal, (v, u), found = load_nominal(tmp_path / "n.npz"), np.mgrid[-30:30:61j, -40:40:81j], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        a, b = rng.uniform(-30, 30, 2)
        if changed == "noise":
            added = integrate(*(1e-5 * rng.standard_normal((2, *u.shape))), spacing=1.0).z
        else:
            added = 2e-3 * np.exp(-((u - a) ** 2 + (v - b) ** 2) / 288)
        known = Diagnostics("drawn", slope_sigma=(1e-5, 1e-5) if changed == "noise" else None)
        numbers = fit_nominal(replace(as_map(u, v, form(u, v) + added), diagnostics=known), nominal).numbers
        found.append((numbers.values, numbers.sigma))
    values, sigmas = (np.array(part)[:, [0, 1, 3, 4, 5]] for part in zip(*found, strict=True))
    error, sigma = np.sqrt(np.mean(values**2, axis=0)), np.median(sigmas, axis=0)
    fixed = np.isinf(sigma)
    assert (error[fixed] == 0).all()
    ratio = error[~fixed] / sigma[~fixed]
    assert np.all((ratio > 0.12) & (ratio < 2.5)), ratio


def test_nominal_surfaces_that_do_not_serve(tmp_path: Path, refused: Any) -> None:
    height, _ = measured((1e-3, 0, 0), (0, 0, 0))
    height.save(tmp_path / "h.npz")
    small = nominal_grid()
    Grid(small.z[:40, :40], small.z[:40, :40], 0.0, 0.0, 0.5).save(tmp_path / "small.npz")
    height.export(tmp_path / "pixels.tif")
    (tmp_path / "n.stl").write_bytes(b"solid nothing")
    (tmp_path / "n.obj").write_text("v 0 0 0")
    for name, *words in (
        ("small.npz", "covers", "must be at least 50 %"),
        ("pixels.tif", "must be 2-D with a scale"),
        ("n.stl", "n.stl: "),
        ("n.obj", "suffix '.obj', must be .npz or .tif or .tiff or .x3p or .sdf"),
    ):
        refused(["form", tmp_path / "h.npz", "--nominal", tmp_path / name], name, *words)
    np.savez(tmp_path / "no.npz", u=np.zeros(3))
    with pytest.raises(InputError, match="field 'x' is missing"):
        load_nominal(tmp_path / "no.npz")


def test_a_profile_of_a_plane() -> None:
    y, x = np.mgrid[0:40, 0:60] * 0.5
    grid = Grid(0.3 * x - 0.1 * y, x, 10.0, 20.0, 0.5)
    found = profile(grid, (12.0, 24.0), (32.0, 39.0))
    assert found.s[-1] == pytest.approx(25.0)
    np.testing.assert_allclose(np.diff(found.s), 0.5)
    np.testing.assert_allclose(found.z, 0.3 * (found.x - 10) - 0.1 * (found.y - 20), atol=1e-12)
    assert found.pv == pytest.approx(0.3 * 20 - 0.1 * 15)
    assert np.isnan(profile(grid, (-50.0, 0.0), (-40.0, 0.0)).rms)
    with pytest.raises(InputError, match="0 mm long"):
        profile(grid, (1.0, 1.0), (1.0, 1.0))


@pytest.mark.parametrize("axis", ["x", "y"])
def test_a_spectrum_of_a_wave_and_of_white_noise(axis: str) -> None:
    """a^2/2 of a wave lies at its frequency; noise of variance s^2 has the density 2 s^2 pitch."""
    rows, cols, pitch = 200, 256, 0.5
    y, x = np.mgrid[0:rows, 0:cols] * pitch
    along = x if axis == "x" else y
    noise = 1e-4 * np.random.default_rng(2).standard_normal(x.shape)
    z = 3e-3 * np.sin(2 * np.pi * along / 8 + 0.4) + noise
    z[np.hypot(x - x.mean(), y - y.mean()) > 62] = np.nan  # a round mirror
    found = spectrum(Grid(z, z, 0.0, 0.0, pitch), axis)
    near = np.abs(found.frequency - 1 / 8) < 0.05
    step = float(found.frequency[1] - found.frequency[0])
    assert found.density[near].sum() * step == pytest.approx(3e-3**2 / 2, rel=0.02)
    high = found.frequency > 0.3
    assert found.density[high].mean() == pytest.approx(2 * 1e-4**2 * pitch, rel=0.05)


def test_profiles_and_spectra_by_the_command_line(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    height, _ = measured((1e-3, 0, 0), (0, 0, 0))
    height.save(tmp_path / "h.npz")
    nominal_grid().save(tmp_path / "n.npz")
    names = ["h.npz", "--nominal", "n.npz", "--profile", "x", "--profile", "-20,-10,20,15"]
    names += ["--profiles", "p.csv", "--psd", "s.csv", "--json", "f.json"]
    assert run(["form", *(str(tmp_path / name) if "." in name else name for name in names)]) == 0
    figures = json.loads((tmp_path / "f.json").read_text())["profiles"]
    with (tmp_path / "p.csv").open() as stream:
        rows = [row for row in csv.DictReader(stream) if row["line"] == "-20,-10,20,15"]
    z = np.array([float(row["z_mm"]) for row in rows])
    assert z.std() == pytest.approx(figures["-20,-10,20,15"]["rms_mm"])
    assert float(rows[-1]["s_mm"]) == pytest.approx(np.hypot(40, 25))
    with (tmp_path / "s.csv").open() as stream:
        assert {row["axis"] for row in csv.DictReader(stream)} == {"x", "y"}
    assert "Profiles of the residual" in capfd.readouterr().out


def test_apertures_filters_limits_and_runs_by_the_command_line(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """And the wavefront: twice the surface."""
    monkeypatch.chdir(tmp_path)
    noisy = Diagnostics("drawn", slope_sigma=(1e-7, 1e-7))
    plain = measured((1e-3, 0, 0), (0, 0, 0))[0]
    plain.save("plain.npz")
    replace(plain, diagnostics=noisy).save("h.npz")
    common = ["form", "h.npz", "--remove", "power", "--json", "n.json"]

    def figures(*words: str, code: int = 0) -> dict[str, Any]:
        assert run([*common, *words]) == code
        found: dict[str, Any] = json.loads(Path("n.json").read_text())
        return found

    whole = figures("--zernike", "4:index=fringe,norm=amplitude", "--waves", "632.8")
    assert "Z9 Primary Spherical" in whole["zernike"]["coefficients_mm"]
    for name in ("rms", "pv", "pvr"):
        assert whole["waves"][name] * 632.8e-6 == pytest.approx(2 * whole[f"{name}_mm"])
    part = figures(
        "--aperture", "circle:radius=20", "--limit", f"rms={whole['rms_mm']}mm", "--limit", "pv=1nm", code=1
    )
    assert part["limits"]["rms"]["verdict"] == "pass"
    capfd.readouterr()
    assert run(["form", "plain.npz", "--remove", "power", "--limit", "pv=1nm"]) == 0
    assert "± unknown noise, at most" in capfd.readouterr().out
    assert part["rms_mm"] < whole["rms_mm"]
    high, low = (figures(f"--{name}pass", "30")["rms_mm"] for name in ("high", "low"))
    assert high < whole["rms_mm"]
    assert low < whole["rms_mm"]
    assert figures("h.npz")["mean_rms_mm"] == pytest.approx(whole["rms_mm"], rel=0.1)
    flags = plain.flags.copy()
    flags[:, :40] = 1024
    replace(plain, diagnostics=noisy, flags=flags).save("part.npz")  # the same map, a part of it
    assert max(figures("part.npz")["left_rms_mm"].values()) < 1e-9
    runs = figures("h.npz", "--rotations", "0,0", "--out", "p.npz")
    assert runs["mirror_rms_mm"] < whole["rms_mm"]  # of the square that all turns share
    assert max(runs["left_rms_mm"].values()) < 1e-9


def test_maps_of_two_mirrors_are_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    height = measured((1e-3, 0, 0), (0, 0, 0))[0]
    rows, cols = height.z.shape
    maps = {"h": height, "far": replace(height, x=height.x + 25.0), "wide": replace(height, x=1.5 * height.x)}
    files = [str(tmp_path / f"{name}.npz") for name in maps]
    for file, each in zip(files, maps.values(), strict=True):
        each.save(file)
    less = HeightMap(*(part[:-1] for part in (height.x, height.y, height.z, height.sigma, height.flags)))
    less.save(tmp_path / "less.npz")
    for file in (*files[1:], str(tmp_path / "less.npz")):
        assert run(["form", files[0], file]) == 2
        said = capfd.readouterr().err.strip()
        assert "\n" not in said
        assert "maps 1 and 2" in said
        assert f"{rows} x {cols}" in said or "mm apart" in said


def test_a_grid_of_another_program_keeps_its_ring_and_its_scale(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    x = np.tile(np.arange(20.0), (16, 1))
    z = 1e-3 * np.square(x - 9.5)  # highest on its ring
    Grid(z, np.zeros(z.shape), x0=0.3, y0=0.1, pitch=0.7).export("g.x3p")
    assert run(["form", "g.x3p", "--remove", "piston", "--json", "f.json"]) == 0
    assert json.loads(Path("f.json").read_text())["pv_mm"] == pytest.approx(np.ptp(z), rel=1e-6)
    assert run(["export", "g.x3p", "e.npz"]) == 0
    again = Grid.load("e.npz")
    assert (again.x0, again.y0, again.pitch) == pytest.approx((0.3, 0.1, 0.7))
    assert again.z == pytest.approx(z)
