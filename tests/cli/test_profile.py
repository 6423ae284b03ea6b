"""`optolever decode --save-profile`, `--profile`: a rig estimated once."""

import json
from pathlib import Path

import numpy as np
import pytest

from optolever.decode import Correspondence

from .conftest import Program, Refused


@pytest.mark.parametrize("kept", ["rig.toml", "rig.npz"])
def test_a_profile_is_kept_and_decoded_by(
    tmp_path: Path, optolever: Program, refused: Refused, kept: str
) -> None:
    """In a file of its own, or with the rig; the same frames decode to the same places by it."""
    shown = ("--scene", "monitor-mirror", "--size", "64x80", "--sequence", "gray+phase", "--noise", "1")
    optolever("capture", *shown, "--out", tmp_path / "c")
    (tmp_path / "rig.toml").write_bytes((tmp_path / "c/scene.toml").read_bytes())
    profile, out, numbers = tmp_path / kept, tmp_path / "c.npz", tmp_path / "c.json"
    decode = ["decode", tmp_path / "c", "--out", out]
    refused([*decode, "--profile", profile], kept if kept == "rig.npz" else "--save-profile")
    optolever(*decode, "--save-profile", profile, "--json", numbers)
    rows = {row["name"]: row for row in json.loads(numbers.read_text())["profile"]}
    assert rows["read noise"]["value"] == pytest.approx(1.04, abs=0.05)
    assert rows["read noise"]["sigma"] < 0.05
    alone = Correspondence.load(out)
    outcome = optolever(*decode, "--profile", profile)
    assert "profile" not in outcome.err
    np.testing.assert_array_equal(Correspondence.load(out).sigma_u, alone.sigma_u)
    refused([*decode, "--profile", profile, "--lens", "0.3"], "leave out --response, --lens")
    noisier = tmp_path / "noisier"
    optolever("capture", *shown[:-1], "3", "--out", noisier)
    outcome = optolever("decode", noisier, "--out", out, "--profile", profile)
    assert "profile no longer holds: noise" in outcome.err
