"""Unusable input: exit code 2, one line that names file, field, value and limit, nothing written."""

import shlex
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from .conftest import SCENE, Chain, Program, Refused

#: Command lines and words of what they answer. {out} may be written; an older result stands in {out}.npz.
REFUSED = [
    ("captur", "captur"),
    ("decode x --outt y", "--outt"),
    ("decode {out}/nowhere --out {out}.npz", "nowhere", "no such"),
    ("decode {capture} --out {folder}", "is a folder"),
    ("capture --scene paper-simulatoin --out {out}", "paper-simulatoin"),
    ("capture --scene paper-simulation --size 9by9 --out {out}", "--size", "9by9"),
    ("capture --scene paper-simulation --size 20000x20000 {many} --out {out}", "GiB"),
    ("capture --scene paper-simulation --size 65536x65536 {many} --out {out}", "GiB"),
    ("capture {scene}", "--out"),
    ("capture {scene} --dent dint --out {out}", "dint", "gaussian"),
    ("capture {scene} --sequence grey --out {out}", "grey", "gray"),
    ("capture {scene} --noise -1 --out {out}", "--noise", "-1"),
    ("capture {scene} --out {out}/deeper/still", "deeper", "does not exist"),
    ("capture {scene} --out {out} --json {out}/none/n.json", "n.json"),
    ("reconstruct {c} --scene paper-simulation --out {out}.npz", "c.npz", "96", "1637"),
    ("{solve} --method magic", "magic"),
    ("{solve} --grid {out}.obj", ".obj", ".x3p"),
    ("{solve} --anchor corner", "corner"),
    ("{solve} --anchor none", "anchor"),
    ("{solve} --mask {small}", "8x8"),
    ("{solve} --mask none.png", "none.png"),
    ("{solve} --rest none.npz", "none.npz"),
    ("{solve} --rest {h}", "field"),
]


@pytest.mark.parametrize(("line", "words"), [(line, words) for line, *words in REFUSED])
def test_refused(line: str, words: list[str], refused: Refused, chain: Chain, tmp_path: Path) -> None:
    out, small = tmp_path / "out", tmp_path / "small.png"
    out.with_suffix(".npz").write_bytes(b"an older result")
    cv2.imwrite(str(small), np.full((8, 8), 255, np.uint8))
    known = {
        "out": out,
        "small": small,
        "folder": tmp_path,
        "capture": chain.capture,
        "c": chain.correspondence,
        "h": chain.height,
        "scene": shlex.join(SCENE),
        "solve": shlex.join(map(str, [*chain.solve, "--out", f"{out}.npz"])),
        "many": "--sequence phase:steps=64,periods=9/10/11",
    }
    refused(shlex.split(line.format(**known)), *words)


def test_a_capture_is_never_written_over(refused: Refused, chain: Chain) -> None:
    args = ["capture", *SCENE, "--out", chain.capture]
    refused(args, chain.capture, "no empty folder", folder=chain.capture)


@pytest.mark.parametrize("level", [0, 255, 128])
def test_flat_grey_frames_are_a_result_with_flags(
    level: int, optolever: Program, chain: Chain, tmp_path: Path
) -> None:
    """A lens cap or a lamp in the camera is no crash: every pixel is flagged."""
    folder = tmp_path / "capture"
    shutil.copytree(chain.capture, folder)
    for path in (folder / "frames").iterdir():
        cv2.imwrite(str(path), np.full((96, 96), level, np.uint8))
    optolever("decode", folder, "--out", tmp_path / "c.npz")
    with np.load(tmp_path / "c.npz") as found:
        assert (found["flags"] != 0).all()
