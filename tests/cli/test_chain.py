"""The commands do what the library does: whole chain, files by their names, numbers within bounds."""

import json
import tomllib
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from optolever.reconstruct import HeightMap

from .conftest import SIZE, Chain, Program

LEVER = 16.37  # mm, a tenth of the mirror: nearer to the pattern the lever is too short for a tight bound


def test_height_matches_the_truth(chain: Chain) -> None:
    with np.load(chain.capture / "truth.npz") as truth, np.load(chain.height) as found:
        good = (found["flags"] == 0) & truth["visible"]
        assert good.sum() > 0.9 * truth["visible"].sum()
        error = found["z"] - truth["z"]
        far = good & (truth["x"] > LEVER)
    # by photon noise and one level of white noise; by white noise alone the error is 1.4 times smaller
    assert np.sqrt(np.mean(error[far] ** 2)) < 1.4e-3 * 1.3
    assert chain.numbers["reconstruct"]["height_rms_rel"] == pytest.approx(
        np.sqrt(np.mean(error[good] ** 2)) / 1.3, rel=0.01
    )


def test_every_output_of_one_solve(optolever: Program, chain: Chain, tmp_path: Path) -> None:
    """By a known point. A Gaussian was made by no contact, its half-depth area is 2 pi sigma^2 ln 2, and the
    report says so."""
    names = [tmp_path / f"g.{suffix}" for suffix in ("npz", "tif", "x3p")]
    grids = [word for name in names for word in ("--grid", name)]
    with np.load(chain.capture / "truth.npz") as archive:
        truth = dict(archive)
    point = ",".join(repr(float(truth[name][48, 48])) for name in "xyz")
    out, tiff, ply, slopes = (tmp_path / name for name in ("h.npz", "h.tif", "h.ply", "s.npz"))
    done = optolever(
        *chain.solve, "--out", out, "--anchor", point, "--truth", chain.capture / "truth.npz",
        "--tiff", tiff, "--ply", ply, "--slopes", slopes, *grids, "--pitch", "2",
    )  # fmt: skip
    assert "of the peak depth" in done.out
    assert "no contact evidence" in " ".join(done.out.split())
    (dent,) = chain.numbers["reconstruct"]["contacts"]
    assert dent["region"] == "half depth"
    assert dent["depth"] == pytest.approx(1.3, abs=4 * dent["depth_sigma"])
    assert dent["area"] == pytest.approx(2 * np.pi * 400 * np.log(2), rel=5e-3)
    with np.load(out) as height:
        error = np.abs(tifffile.imread(tiff) - height["z"])[height["flags"] == 0]
    assert error.max() < 1e-6
    assert ply.read_bytes().startswith(b"ply\n")
    with np.load(slopes) as s:
        good = (s["flags"] == 0) & truth["visible"]
        error = (s["slope_x"] + truth["normal"][..., 0] / truth["normal"][..., 2])[good]
        assert np.sqrt(np.mean(error**2)) < 1.5 * np.sqrt(np.mean(s["sigma_x"][good] ** 2))
        assert np.nanmin(s["mean"]) == pytest.approx(-1.3 / 20**2, rel=0.1)  # at the bottom
    with np.load(names[0]) as grid, tifffile.TiffFile(names[1]) as image, zipfile.ZipFile(names[2]) as x3p:
        page = image.pages[0]
        np.testing.assert_allclose(page.asarray(), grid["z"], rtol=1e-6)
        assert page.tags["XResolution"].value == (5, 1)  # per centimetre
        points = np.frombuffer(x3p.read("bindata/data.bin"), "<f8").reshape(grid["z"].shape)
        np.testing.assert_allclose(points, 1e-3 * grid["z"])
        assert np.isfinite(grid["sigma"]).mean() > 0.8


@pytest.mark.parametrize("scene", ["paper-simulation", "monitor-mirror"])
def test_a_capture_at_rest_corrects_a_wrong_scene(optolever: Program, tmp_path: Path, scene: str) -> None:
    """The pattern's pitch is 0.5 % other than the scene says: a notice, or a tenth of the error."""
    where = ["--scene", scene, "--size", SIZE]
    for name, dent in (("dented", "gaussian"), ("rest", "flat")):
        optolever("simulate", *where, "--dent", dent, "--renderer", "numpy", "--out", tmp_path / name)
        optolever("decode", tmp_path / name, "--out", tmp_path / f"{name}.npz")
    right = (tmp_path / "dented" / "scene.toml").read_text()
    pitch = str(tomllib.loads(right)["pattern"]["pitch_mm"])
    wrong, mask = tmp_path / "wrong.toml", np.zeros((96, 96), np.uint8)
    wrong.write_text(right.replace(f"pitch_mm = {pitch}", f"pitch_mm = {1.005 * float(pitch)!r}", 1))
    mask[:, :80] = 255
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    numbers, rest = {}, ["--rest", tmp_path / "rest.npz"]
    for name, words in {"raw": [], "rest": rest, "part": [*rest, "--mask", tmp_path / "mask.png"]}.items():
        done = optolever(
            "reconstruct", tmp_path / "dented.npz", "--scene", wrong, "--out", tmp_path / f"{name}-h.npz",
            "--truth", tmp_path / "dented" / "truth.npz", "--json", tmp_path / "n.json", *words,
        )  # fmt: skip
        numbers[name] = json.loads((tmp_path / "n.json").read_text())
        notices = [line for line in done.err.splitlines() if line.startswith("Notice: ")]
        assert len(notices) == len(numbers[name]["notices"])
        if name == "raw":
            assert any("contradict" in line and "--rest" in line for line in notices)
            assert numbers[name]["chi2"] > numbers[name]["notices"][-1]["limit"]
    assert numbers["rest"]["height_rms_rel"] < 0.1 * numbers["raw"]["height_rms_rel"]
    with np.load(tmp_path / "part-h.npz") as height:
        assert (height["flags"][:, 80:] != 0).all()
        assert (height["flags"][:, :80] == 0).mean() > 0.8


def test_noise_and_rig_apart_for_a_typed_scene(optolever: Program, tmp_path: Path) -> None:
    """The rig's part of a depth against a rest capture is predicted, and that capture then gives it to a
    third."""
    size = ("--scene", "prism48", "--pixels", "120x90")
    for name, shape, seed in (("press", "gaussian:peak=0.3,sigma=4", "1"), ("rest", "flat", "2")):
        drawn = ("--dent", shape, "--noise", "1", "--seed", seed, "--out", tmp_path / name)
        optolever("simulate", *size, *drawn)
        optolever("decode", tmp_path / name, "--out", tmp_path / f"{name}.npz")
    found = []
    for name, words in (("h", ()), ("r", ("--rest", tmp_path / "rest.npz"))):
        out = ("--out", tmp_path / f"{name}.npz", "--json", tmp_path / "n.json")
        printed = optolever("reconstruct", tmp_path / "press.npz", *size, *words, *out).out
        assert ("against a rest capture" in " ".join(printed.split())) == (name == "h")
        found += json.loads((tmp_path / "n.json").read_text())["contacts"]
    by_rig = [(one["depth_sigma"] ** 2 - one["depth_noise"] ** 2) ** 0.5 for one in found]
    assert found[0]["depth_rig_against_rest"] == pytest.approx(by_rig[1], rel=1 / 3)
    assert found[0]["depth_rig_against_rest"] < 0.75 * by_rig[0]
    optolever("report", tmp_path / "h.npz", "--json", tmp_path / "n.json", "--out", tmp_path / "page")
    numbers, height = json.loads((tmp_path / "n.json").read_text()), HeightMap.load(tmp_path / "h.npz")
    assert numbers["noise_mm"] == pytest.approx(np.median(height.sigma[height.good]))
    assert numbers["rig_mm"] == pytest.approx(np.median(height.calibration_sigma[height.good]))
    assert numbers["rig_mm"] > 100 * numbers["noise_mm"]
    assert 'id="rig_mm"' in (tmp_path / "page/report.html").read_text()


def test_a_page_from_saved_records(optolever: Program, chain: Chain, tmp_path: Path) -> None:
    """Shows what is in the files, and only what is given; asks the network for nothing."""
    words = ["report", chain.height, "--json", tmp_path / "r.json"]
    extra = ["--correspondence", chain.correspondence, "--capture", chain.capture]
    optolever(*words, *extra, "--out", tmp_path / "full")
    optolever(*words, "--out", tmp_path / "bare")
    bare, full = ((tmp_path / name / "report.html").read_text() for name in ("bare", "full"))
    good = HeightMap.load(chain.height).good
    assert json.loads((tmp_path / "r.json").read_text())["good_share"] == pytest.approx(good.mean())
    for name in ("height-map", "sigma-map", "flag-counts", "flags-map", "surface-data", "noise_mm"):
        assert f'id="{name}"' in bare
        assert f'id="{name}"' in full
    for name in ("notices", "rig_mm", "correspondence-maps"):  # the scene is exact
        assert f'id="{name}"' not in bare
    assert 'id="correspondence-maps"' in full
    assert "simulated, rig not given" in full
    assert "measured, rig not given" in bare
    assert full.count('alt="camera frame') == 20
    assert "https://" not in full.replace("data:", "")
