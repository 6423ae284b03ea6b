"""The commands do what the library does: files by their names, numbers within bounds; inputs as they come."""

import json
import re
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from optolever.decode import Correspondence, Flag
from optolever.maps import read_grid
from optolever.reconstruct import HeightMap

from .conftest import Chain, Program, Refused


def test_every_output_of_one_solve(optolever: Program, chain: Chain, tmp_path: Path) -> None:
    """By a known point. A Gaussian was made by no contact, its half-depth area is 2 pi sigma^2 ln 2, and the
    report says so."""
    names = [tmp_path / f"g.{suffix}" for suffix in ("npz", "tif", "x3p")]
    with np.load(chain.capture / "truth.npz") as archive:
        truth = dict(archive)
    point = ",".join(repr(float(truth[name][48, 48])) for name in "xyz")
    out, slopes = tmp_path / "h.npz", tmp_path / "s.npz"
    done = optolever(
        *chain.solve, "--out", out, "--anchor", point, "--truth", chain.capture / "truth.npz",
        "--slopes", slopes, "--contacts",
    )  # fmt: skip
    optolever("export", out, *names, "--pitch", "2")
    assert "of the peak depth" in done.out
    assert chain.numbers["reconstruct"]["contacts"] == []  # in open air, if asked for
    height = HeightMap.load(chain.height)
    error = (height.z - truth["z"])[height.good & truth["visible"]]
    rms = chain.numbers["reconstruct"]["height_rms_rel"]
    assert rms == pytest.approx(np.sqrt(np.mean(error**2)) / 1.3, rel=0.01)
    assert rms < 2e-3
    (dent,) = (one.to_dict() for one in HeightMap.load(out).contacts or ())
    assert dent["depth"] == pytest.approx(1.3, abs=4 * dent["depth_sigma"])
    assert dent["area"] == pytest.approx(2 * np.pi * 400 * np.log(2), rel=5e-3)
    with np.load(slopes) as s:
        good = (s["flags"] == 0) & truth["visible"]
        error = (s["slope_x"] + truth["normal"][..., 0] / truth["normal"][..., 2])[good]
        assert np.sqrt(np.mean(error**2)) < 1.5 * np.sqrt(np.mean(s["sigma_x"][good] ** 2))
        assert np.nanmin(s["mean"]) == pytest.approx(-1.3 / 20**2, rel=0.1)  # at the bottom
    assert all(path.is_file() for path in names)
    with np.load(names[0]) as grid:
        np.testing.assert_allclose(tifffile.imread(names[1]), grid["z"], rtol=1e-6)
        assert np.isfinite(grid["sigma"]).mean() > 0.8


def test_formats_that_cannot_hold_a_grid_are_named_and_the_others_written(
    optolever: Program, refused: Refused, chain: Chain, tmp_path: Path
) -> None:
    """A disc, a grid that is too fine, heights of 0.2 m (the scene, 50 times as large), of which DAT holds
    165."""
    out, disc_file = tmp_path / "h.npz", tmp_path / "g.wft"
    optolever(*chain.solve, "--out", out)
    refused(["export", out, disc_file], "g.wft: ", "no disc", "circle")
    refused(["export", out, tmp_path / "g.npz", "--pitch", "1e-5"], "pitch = 1e-05 mm")
    others = [tmp_path / f"g.{suffix}" for suffix in ("npz", "tif", "x3p", "sdf", "csv")]
    done = optolever("export", out, disc_file, *others, "--json", tmp_path / "e.json")
    assert [line.split(":")[1].strip() for line in done.err.splitlines()] == [str(disc_file)]
    assert json.loads((tmp_path / "e.json").read_text()) == {"files": [str(path) for path in others]}
    assert all(path.is_file() for path in others)
    assert not disc_file.exists()
    with np.load(chain.capture / "truth.npz") as archive:
        x, y, z = (archive[name].astype(float) for name in "xyz")
    lines, large = (chain.capture / "scene.toml").read_text().splitlines(), tmp_path / "large.toml"
    by_50 = [re.sub("[0-9.]+", lambda at: str(50 * float(at[0])), each) for each in lines]
    large.write_text("\n".join(b if "_mm = " in a else a for a, b in zip(lines, by_50, strict=True)))
    point = f"{50 * x[48, 48]},{50 * y[48, 48]},200"
    optolever(*chain.solve[:-1], large, "--anchor", point, "--out", tmp_path / "large.npz")
    exported = ["export", tmp_path / "large.npz", tmp_path / "h.dat"]
    refused(exported, "h.dat: heights up to 2")
    assert "h.dat: heights up to 2" in optolever(*exported, tmp_path / "h.csv").err
    assert (tmp_path / "h.csv").is_file()
    assert not (tmp_path / "h.dat").exists()
    disc = np.hypot(x - x[48, 48], y - y[48, 48]) < 40
    cv2.imwrite(str(tmp_path / "disc.png"), np.where(disc, 255, 0).astype(np.uint8))
    masked = ("--anchor", f"{x[48, 48]},{y[48, 48]},{z[48, 48]}", "--mask", tmp_path / "disc.png")
    optolever(*chain.solve, *masked, "--out", tmp_path / "disc.npz")
    assert not optolever("export", tmp_path / "disc.npz", disc_file).err
    written = read_grid(disc_file).z
    assert np.nanmax(written) == pytest.approx(z[disc].max(), rel=1e-3)


@pytest.fixture
def copy(chain: Chain, tmp_path: Path) -> Path:
    """A copy of the capture, to be changed."""
    shutil.copytree(chain.capture, tmp_path / "capture")
    return tmp_path / "capture"


def test_encodings_of_toml(copy: Path, chain: Chain, optolever: Program, refused: Refused) -> None:
    """A byte order mark is passed over, UTF-16 is refused."""
    decode_it = ["decode", copy, "--out", copy.parent / "c.npz"]
    for name in ("capture.toml", "scene.toml"):
        text = (copy / name).read_text(encoding="utf-8")
        (copy / name).write_text(text, encoding="utf-8-sig")
    optolever(*decode_it)
    assert Correspondence.load(copy.parent / "c.npz") == Correspondence.load(chain.correspondence)
    (copy / "capture.toml").write_text(text, encoding="utf-16")
    refused(decode_it, "capture.toml", "not readable as TOML", "save it as text in UTF-8")


HALF = np.arange(96) < np.full((96, 1), 30)
WHITE = HALF.astype(np.uint8) * np.uint8(255)
OPAQUE = np.full((96, 96), 255, np.uint8)
#: How people store a mask.
MASKS: dict[str, NDArray[Any]] = {
    "0 and 1": HALF.astype(np.uint8),
    "16 bits": HALF.astype(np.uint16) * np.uint16(65535),
    "two greys": np.where(HALF, 200, 100).astype(np.uint8),
    "alpha": np.dstack([OPAQUE, OPAQUE, OPAQUE, WHITE]),
    "soft edges": cv2.blur(WHITE, (3, 1)),
}


@pytest.mark.parametrize("kind", MASKS)
def test_two_values_are_a_mask(kind: str, chain: Chain, tmp_path: Path, optolever: Program) -> None:
    cv2.imwrite(str(tmp_path / "mask.png"), MASKS[kind])
    out = tmp_path / "c.npz"
    optolever("decode", chain.capture, "--out", out, "--mask", tmp_path / "mask.png")
    found, unmasked = Correspondence.load(out), Correspondence.load(chain.correspondence)
    np.testing.assert_array_equal(found.flags & Flag.INVALID == 0, HALF)
    assert found.good[HALF].mean() > 0.9 * unmasked.good[HALF].mean()


def test_light_that_is_too_weak_is_named(copy: Path, chain: Chain, optolever: Program) -> None:
    """A mirror of a few per cent; well lit, there is no such notice."""
    assert chain.numbers["decode"]["faults"] == []
    rng = np.random.default_rng(3)
    for path in (copy / "frames").iterdir():
        frame = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        light = 3 + 0.04 * frame + 1.5 * rng.standard_normal(frame.shape)
        cv2.imwrite(str(path), np.clip(np.rint(light), 0, 255).astype(np.uint8))
    said = optolever("decode", copy, "--out", copy.parent / "c.npz", code=2).err
    assert "too weak" in said
    assert "most likely the display" not in said
