"""Small inputs that failed once, each with its kind: files of file managers, byte order marks, masks, NumPy's
settings, units of floats, NaN, a mirror that fills a part of the image."""

import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from optolever import InputError
from optolever.decode import Correspondence, Flag, decode
from optolever.patterns import Sequence, sequence
from optolever.projector import Capture, capture
from optolever.reconstruct import reconstruct
from optolever.scene import dent, load, resize

from .conftest import Chain, Program, Refused


@pytest.fixture
def copy(chain: Chain, tmp_path: Path) -> Path:
    """A copy of the capture, to be changed."""
    shutil.copytree(chain.capture, tmp_path / "capture")
    return tmp_path / "capture"


def test_files_of_file_managers_are_passed_over(copy: Path, optolever: Program) -> None:
    names = [".DS_Store", "Thumbs.db", "._000.png"]
    for name in names:
        (copy / "frames" / name).write_bytes(b"\0\1")
    notices = optolever("decode", copy, "--out", copy.parent / "c.npz").err
    assert all(name in notices for name in names)
    assert "no pictures, passed over" in notices


def test_encodings_of_toml(copy: Path, chain: Chain, optolever: Program, refused: Refused) -> None:
    """A byte order mark is passed over, UTF-16 is named."""
    decode_it = ["decode", copy, "--out", copy.parent / "c.npz"]
    for name in ("capture.toml", "scene.toml"):
        text = (copy / name).read_text(encoding="utf-8")
        (copy / name).write_text(text, encoding="utf-8-sig")
    optolever(*decode_it)
    assert Correspondence.load(copy.parent / "c.npz") == Correspondence.load(chain.correspondence)
    (copy / "capture.toml").write_text(text, encoding="utf-16")
    refused(decode_it, "capture.toml", "UTF-16, must be UTF-8")


HALF = np.arange(96) < np.full((96, 1), 30)
WHITE = HALF.astype(np.uint8) * np.uint8(255)
OPAQUE = np.full((96, 96), 255, np.uint8)
#: How people store a mask.
MASKS: dict[str, NDArray[Any]] = {
    "0 and 1": HALF.astype(np.uint8),
    "16 bits": HALF.astype(np.uint16) * np.uint16(65535),
    "two greys": np.where(HALF, 200, 100).astype(np.uint8),
    "alpha": np.dstack([OPAQUE, OPAQUE, OPAQUE, WHITE]),
    "white on black, opaque": np.dstack([WHITE, WHITE, WHITE, OPAQUE]),
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


def test_a_mask_that_marks_nothing_is_refused(chain: Chain, tmp_path: Path, refused: Refused) -> None:
    cv2.imwrite(str(tmp_path / "mask.png"), np.zeros((96, 96), np.uint8))
    args = ["decode", chain.capture, "--mask", tmp_path / "mask.png", "--out", tmp_path / "c.npz"]
    refused(args, "mask.png", "leaves no pixel")


@pytest.fixture(scope="module")
def seen() -> tuple[NDArray[Any], Sequence]:
    rig = resize(load("monitor-mirror"), 48, 64)
    shown = sequence("gray+phase", rig.pattern.rows, rig.pattern.cols)
    taken = capture(rig, dent("gaussian", rig, peak=0.1, sigma=20.0), shown, noise=1.0, renderer="numpy")
    return taken.frames, shown


def test_the_callers_seterr_does_not_reach_inside(seen: tuple[NDArray[Any], Sequence]) -> None:
    with np.errstate(all="raise"):
        assert reconstruct(decode(*seen), resize(load("monitor-mirror"), 48, 64)).good.mean() > 0.9
        assert np.geterr()["under"] == "raise"


@pytest.mark.daily(2)
@pytest.mark.parametrize("unit", [1e6, 1 / 255, 257.0, 1e-9])
def test_answers_do_not_depend_on_the_unit(unit: float, seen: tuple[NDArray[Any], Sequence]) -> None:
    frames, shown = seen
    levels = decode(frames.astype(np.float64), shown)
    found = decode(frames * unit, shown)
    np.testing.assert_array_equal(found.flags, levels.flags)
    np.testing.assert_allclose(found.u, levels.u, atol=1e-4)
    np.testing.assert_allclose(found.sigma_u, levels.sigma_u, rtol=1e-3)
    np.testing.assert_allclose(found.amplitude, levels.amplitude * unit, rtol=1e-5)
    given = decode(frames * unit, shown, noise=1.0 * unit)
    np.testing.assert_allclose(given.sigma_u, decode(frames * 1.0, shown, noise=1.0).sigma_u, rtol=1e-3)


def test_pixels_that_are_not_finite_are_invalid(seen: tuple[NDArray[Any], Sequence]) -> None:
    frames, shown = seen
    broken = frames.astype(np.float64)
    broken[3, 10:20, 10:20] = np.nan
    broken[5, 30, 30] = np.inf
    lost = ~np.isfinite(broken).all(axis=0)
    for mask in (None, np.ones(lost.shape, np.bool_), ~lost):
        found = decode(broken, shown, mask=mask)
        np.testing.assert_array_equal(found.flags & Flag.INVALID != 0, lost)
        assert found.good[~lost].mean() > 0.95
    with pytest.raises(InputError, match="no pixel is finite"):
        decode(np.full(frames.shape, np.nan), shown)


def test_the_share_that_the_mirror_fills(optolever: Program, chain: Chain, tmp_path: Path) -> None:
    """A mirror that fills a known part of the image: the rest shows a dark room with noise of its own."""
    rng, inside = np.random.default_rng(3), np.zeros((96, 96), np.bool_)
    inside[10:80, 20:90] = True
    shots, out, report = tmp_path / "shots", tmp_path / "c.npz", tmp_path / "c.json"
    shots.mkdir()
    for path in (chain.capture / "frames").iterdir():
        room = np.clip(rng.normal(12, 1, (96, 96)), 0, 255)
        image = np.where(inside, cv2.imread(str(path), cv2.IMREAD_UNCHANGED), np.rint(room)).astype(np.uint8)
        cv2.imwrite(str(shots / path.name), image)
    Capture.load(chain.capture).sequence.save(tmp_path / "shown.toml")
    printed = optolever(
        "decode", shots, "--description", tmp_path / "shown.toml", "--out", out, "--json", report
    ).out
    numbers, good = json.loads(report.read_text()), Correspondence.load(out).good
    assert abs(numbers["mirror_share"] - inside.mean()) < 0.005
    assert abs(numbers["mirror_good_share"] - good[inside].mean()) < 0.01
    share, decoded = 100 * numbers["mirror_share"], 100 * numbers["mirror_good_share"]
    assert f"the mirror fills {share:.1f} % of the image; {decoded:.1f} % of it decoded" in printed
