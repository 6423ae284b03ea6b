"""`optolever decode --save-profile`, `--profile`: a rig estimated once."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from optolever.camera import Timing
from optolever.decode import Correspondence
from optolever.projector import Capture
from optolever.scene import write_sections

from .conftest import Program, Refused


@pytest.mark.parametrize("kept", ["rig.toml", "rig.npz"])
def test_a_profile_is_kept_and_decoded_by(
    tmp_path: Path, optolever: Program, refused: Refused, kept: str
) -> None:
    """In a file of its own, or with the rig; the same frames decode to the same places by it."""
    shown = ("--scene", "monitor-mirror", "--pixels", "80x64", "--sequence", "gray+phase", "--noise", "1")
    optolever("simulate", *shown, "--out", tmp_path / "c")
    (tmp_path / "rig.toml").write_bytes((tmp_path / "c/scene.toml").read_bytes())
    profile, out, numbers = tmp_path / kept, tmp_path / "c.npz", tmp_path / "c.json"
    decode = ["decode", tmp_path / "c", "--out", out]
    refused([*decode, "--profile", profile], kept if kept == "rig.npz" else "--save-profile")
    optolever(*decode, "--save-profile", profile, "--json", numbers)
    rows = {row["name"]: row for row in json.loads(numbers.read_text())["profile"]}
    assert rows["read noise"]["sigma"] < 0.05
    alone = Correspondence.load(out)
    assert "profile" not in optolever(*decode, "--profile", profile).err
    np.testing.assert_array_equal(Correspondence.load(out).sigma_u, alone.sigma_u)
    refused([*decode, "--profile", profile, "--lens", "0.3"], "leave out --response, --lens")
    optolever("simulate", *shown[:-1], "3", "--out", tmp_path / "noisier")
    outcome = optolever("decode", tmp_path / "noisier", "--out", out, "--profile", profile)
    assert "profile no longer fits, noise" in outcome.err


def test_the_lag_that_sync_measured_is_taken_off(tmp_path: Path, optolever: Program) -> None:
    """Frames with half a level of the frame before, too little for the decoder's estimate; by [sync] and the
    times of the capture it is taken off."""
    shown = ("--scene", "prism48", "--pixels", "128x96", "--sequence", "micro-phase", "--renderer", "numpy")
    optolever("simulate", *shown, "--out", tmp_path / "c")
    clean, rig, out = Capture.load(tmp_path / "c"), tmp_path / "c/scene.toml", tmp_path / "c.npz"
    timing = Timing(0.01, 0, 0.1, 0.1, 0, 0, 0.1, 0.005)  # slow cells, a short exposure
    write_sections(rig, {"sync": timing.to_table()})
    waited, light = timing.ready_s(), clean.frames.astype(float)
    light[1:] += timing.lag(waited) * (light[:-1] - light[1:])
    noisy = np.rint(light + np.random.default_rng(0).normal(0, 1, light.shape)).clip(0, 255).astype(np.uint8)
    for path, frame in zip(sorted((tmp_path / "c/frames").iterdir()), noisy, strict=True):
        cv2.imwrite(str(path), frame)
    bias, truth = [], np.load(tmp_path / "c/truth.npz")
    optolever("decode", tmp_path / "c", "--out", out, "--save-profile", rig)
    times = "\n".join([json.dumps({"swapped_s": 7.0, "stamp_s": 7.0 + waited + 1e-9})] * len(clean))
    for log in ("", times):
        if log:
            (tmp_path / "c/acquisition.jsonl").write_text(log)
        optolever("decode", tmp_path / "c", "--out", out, "--profile", rig)
        found = Correspondence.load(out)
        off = np.stack([found.u - truth["u"], found.v - truth["v"]])[:, found.good]
        bias.append(float(np.abs(np.median(off, axis=1)).max()))
    assert bias[0] > 1e-3
    assert bias[1] < bias[0] / 3
