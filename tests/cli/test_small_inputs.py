"""Small inputs that failed once, each with its kind: files of file managers, byte order marks, masks, alpha,
NumPy's numbers, masked arrays, np.seterr, units of floats, NaN, sequences of another size, two OpenCV wheels.
"""

import json
import shutil
from collections.abc import Iterator
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
def own(chain: Chain, tmp_path: Path) -> Path:
    """A copy of the capture, to be spoilt."""
    shutil.copytree(chain.capture, tmp_path / "capture")
    return tmp_path / "capture"


def decoded(optolever: Program, folder: Path, *args: object) -> Correspondence:
    out = folder.parent / "c.npz"
    optolever("decode", folder, "--out", out, *args)
    return Correspondence.load(out)


@pytest.mark.parametrize("name", [".DS_Store", "Thumbs.db", "desktop.ini", "._000.png", "notes.txt"])
def test_files_of_file_managers_are_passed_over(name: str, own: Path, optolever: Program) -> None:
    (own / "frames" / name).write_bytes(b"\0\1")
    told = optolever("decode", own, "--out", own.parent / "c.npz").err
    assert f"{name}: no pictures, passed over" in told


def test_toml_with_a_byte_order_mark(own: Path, chain: Chain, optolever: Program, tmp_path: Path) -> None:
    """capture.toml, scene.toml, a sequence and a grid."""
    for name in ("capture.toml", "scene.toml"):
        text = (own / name).read_text(encoding="utf-8")
        (own / name).write_text(text, encoding="utf-8-sig")
    assert decoded(optolever, own) == Correspondence.load(chain.correspondence)
    assert load(own / "scene.toml") == load(chain.capture / "scene.toml")
    shown = sequence("gray", 24, 32)
    shown.save(tmp_path / "s.toml")
    (tmp_path / "s.toml").write_text((tmp_path / "s.toml").read_text(), encoding="utf-8-sig")
    assert Sequence.load(tmp_path / "s.toml") == shown


@pytest.mark.parametrize("name", ["capture.toml", "scene.toml"])
def test_toml_in_utf_16_is_named(name: str, own: Path, refused: Refused) -> None:
    text = (own / name).read_text(encoding="utf-8")
    (own / name).write_text(text, encoding="utf-16")
    refused(["decode", own, "--out", own.parent / "c.npz"], name, "UTF-16, must be UTF-8")


def _half() -> NDArray[np.bool_]:
    inside = np.zeros((96, 96), np.bool_)
    inside[:, :30] = True
    return inside


#: How people store a mask: the picture, and whether it is alpha.
MASKS = {
    "0 and 255": _half().astype(np.uint8) * np.uint8(255),
    "0 and 1": _half().astype(np.uint8),
    "16 bits": _half().astype(np.uint16) * np.uint16(65535),
    "16 bits of 255": _half().astype(np.uint16) * np.uint16(255),
    "two greys": np.where(_half(), 200, 100).astype(np.uint8),
    "alpha": np.dstack([*[np.full((96, 96), 255, np.uint8)] * 3, _half().astype(np.uint8) * np.uint8(255)]),
    "white on black, opaque": np.dstack(
        [*[_half().astype(np.uint8) * np.uint8(255)] * 3, np.full((96, 96), 255)]
    ),
    "soft edges": cv2.blur(_half().astype(np.uint8) * np.uint8(255), (3, 1)),
}


@pytest.mark.parametrize("kind", MASKS)
def test_two_values_are_a_mask_whatever_they_are(
    kind: str, chain: Chain, own: Path, optolever: Program
) -> None:
    path = own.parent / "mask.png"
    cv2.imwrite(str(path), MASKS[kind])
    found, whole = decoded(optolever, own, "--mask", path), Correspondence.load(chain.correspondence)
    np.testing.assert_array_equal(found.flags & Flag.INVALID == 0, _half())
    assert found.good[_half()].mean() > 0.9 * whole.good[_half()].mean()


def test_a_mask_that_says_nothing_is_refused(own: Path, refused: Refused) -> None:
    path = own.parent / "mask.png"
    cv2.imwrite(str(path), np.zeros((96, 96), np.uint8))
    refused(["decode", own, "--mask", path, "--out", own.parent / "c.npz"], "mask.png", "leaves no pixel")


@pytest.fixture
def strict() -> Iterator[None]:
    with np.errstate(all="raise"):
        yield


@pytest.mark.usefixtures("strict")
def test_the_callers_seterr_does_not_reach_inside() -> None:
    rig = resize(load("prism48"), 60, 80)
    shown = sequence("gray+phase", rig.pattern.rows, rig.pattern.cols)
    taken = capture(rig, dent("gaussian", rig, peak=0.2, sigma=6.0), shown, noise=1.0, renderer="numpy")
    assert reconstruct(decode(taken.frames, shown), rig).good.mean() > 0.9
    assert np.geterr()["under"] == "raise"


@pytest.fixture(scope="module")
def seen() -> tuple[NDArray[Any], Sequence]:
    rig = resize(load("monitor-mirror"), 48, 64)
    shown = sequence("gray+phase", rig.pattern.rows, rig.pattern.cols)
    taken = capture(rig, dent("gaussian", rig, peak=0.1, sigma=20.0), shown, noise=1.0, renderer="numpy")
    return taken.frames, shown


@pytest.mark.daily(2)
@pytest.mark.parametrize("unit", [1e6, 1 / 255, 257.0, 1e-9])
def test_answers_do_not_depend_on_the_unit(unit: float, seen: tuple[NDArray[Any], Sequence]) -> None:
    frames, shown = seen
    whole = decode(frames.astype(np.float64), shown)
    found = decode(frames * unit, shown)
    np.testing.assert_array_equal(found.flags, whole.flags)
    np.testing.assert_allclose(found.u, whole.u, atol=1e-4)
    np.testing.assert_allclose(found.sigma_u, whole.sigma_u, rtol=1e-3)
    np.testing.assert_allclose(found.amplitude, whole.amplitude * unit, rtol=1e-5)
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


def test_words_after_decoding_say_how_much_the_mirror_fills(
    optolever: Program, chain: Chain, tmp_path: Path
) -> None:
    """A mirror that fills a known part of the image: the rest shows a dark room with noise of its own."""
    rng, inside = np.random.default_rng(3), np.zeros((96, 96), np.bool_)
    inside[10:80, 20:90] = True
    folder = tmp_path / "shots"
    folder.mkdir()
    for path in (chain.capture / "frames").iterdir():
        room = np.clip(rng.normal(12, 1, (96, 96)), 0, 255)
        image = np.where(inside, cv2.imread(str(path), cv2.IMREAD_UNCHANGED), np.rint(room)).astype(np.uint8)
        cv2.imwrite(str(folder / path.name), image)
    Capture.load(chain.capture).sequence.save(tmp_path / "shown.toml")
    args = [
        "--description",
        tmp_path / "shown.toml",
        "--out",
        tmp_path / "c.npz",
        "--json",
        tmp_path / "c.json",
    ]
    out = optolever("decode", folder, *args).out
    numbers = json.loads((tmp_path / "c.json").read_text())
    assert abs(numbers["mirror_share"] - inside.mean()) < 0.005
    good = Correspondence.load(tmp_path / "c.npz").good
    assert abs(numbers["mirror_good_share"] - good[inside].mean()) < 0.01
    share, decoded_share = 100 * numbers["mirror_share"], 100 * numbers["mirror_good_share"]
    assert f"the mirror fills {share:.1f} % of the image; {decoded_share:.1f} % of it decoded" in out
