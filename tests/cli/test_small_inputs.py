"""Inputs as they come: byte order marks, masks, light that is too weak."""

import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.decode import Correspondence, Flag

from .conftest import Chain, Program, Refused


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
