"""The commands do what the library does: whole chain, files by their names, numbers within bounds."""

from pathlib import Path

import numpy as np
import pytest
import tifffile

from optolever.reconstruct import HeightMap

from .conftest import Chain, Program


def test_every_output_of_one_solve(optolever: Program, chain: Chain, tmp_path: Path) -> None:
    """By a known point. A Gaussian was made by no contact, its half-depth area is 2 pi sigma^2 ln 2, and the
    report says so."""
    names = [tmp_path / f"g.{suffix}" for suffix in ("npz", "tif", "x3p")]
    grids = [word for name in names for word in ("--grid", name)]
    with np.load(chain.capture / "truth.npz") as archive:
        truth = dict(archive)
    point = ",".join(repr(float(truth[name][48, 48])) for name in "xyz")
    out, slopes = tmp_path / "h.npz", tmp_path / "s.npz"
    done = optolever(
        *chain.solve, "--out", out, "--anchor", point, "--truth", chain.capture / "truth.npz",
        "--slopes", slopes, *grids, "--pitch", "2", "--contacts",
    )  # fmt: skip
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
