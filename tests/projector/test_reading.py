"""Pictures of other programs as captures: every format, order, colour and number that people bring."""

import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from optolever import InputError
from optolever.patterns import sequence
from optolever.pictures import read_pictures
from optolever.projector import Capture

ROWS, COLS = 30, 44
SHOWN = sequence("gray+phase", ROWS, COLS)
COUNT = len(SHOWN)
Stack = NDArray[Any]


def frames(dtype: Any = np.uint8, top: int = 255, seed: int = 5) -> Stack:
    """One image (20, 28) per pattern, no two alike, in levels 0 to top."""
    values = np.random.default_rng(seed).integers(0, top, (COUNT, 20, 28))
    return values.astype(dtype)


def write(folder: Path, images: Stack, name: str = "img_{}.png", first: int = 1) -> Path:
    folder.mkdir(exist_ok=True)
    for i, image in enumerate(images):
        assert cv2.imwrite(str(folder / name.format(i + first)), image)
    return folder


def names(capture: Capture) -> list[str]:
    return [notice.name for notice in capture.notices]


def test_names_are_sorted_as_people_count(tmp_path: Path) -> None:
    images = frames()
    folder = write(tmp_path / "shots", images)
    for source in (folder, str(folder / "img_*.png"), list(folder.iterdir())):
        found = Capture.load(source, SHOWN)
        np.testing.assert_array_equal(found.frames, images)
        assert (found.sequence, found.bits, found.notices) == (SHOWN, 8, ())


@pytest.mark.parametrize("suffix", ["png", "bmp", "pgm", "tif"])
@pytest.mark.parametrize(("dtype", "bits"), [(np.uint8, 8), (np.uint16, 12), (np.uint16, 16)])
def test_lossless_formats_keep_every_level(suffix: str, dtype: Any, bits: int, tmp_path: Path) -> None:
    if suffix == "bmp" and bits > 8:
        pytest.skip("BMP holds 8 bits")
    images = frames(dtype, 2**bits - 1)
    found = Capture.load(write(tmp_path / "a", images, f"{{}}.{suffix}"), SHOWN)
    np.testing.assert_array_equal(found.frames, images)
    assert (found.bits, found.notices) == (bits, ())


@pytest.mark.parametrize(
    "options",
    [{"byteorder": "<"}, {"byteorder": ">"}, {"compression": "zlib"}, {"imagej": True}, {"lzw": 5}, None],
)
def test_one_file_of_all_frames(options: dict[str, Any] | None, tmp_path: Path) -> None:
    images, path = frames(np.uint16, 4095), tmp_path / "stack.tif"
    if options is None:
        path = tmp_path / "stack.npy"
        np.save(path, images.astype(">u2"))
    elif "lzw" in options:
        cv2.imwritemulti(str(path), list(images), [cv2.IMWRITE_TIFF_COMPRESSION, 5])
    else:
        tifffile.imwrite(path, images, photometric="minisblack", **options)
    found = Capture.load(path, SHOWN)
    np.testing.assert_array_equal(found.frames, images)
    assert found.bits == 12


def test_a_tiff_whose_0_is_white_is_turned_or_refused(tmp_path: Path) -> None:
    """OpenCV turns 8 bits and leaves 16 as they are."""
    tifffile.imwrite(tmp_path / "s.tif", 255 - frames(), photometric="miniswhite")
    np.testing.assert_array_equal(Capture.load(tmp_path / "s.tif", SHOWN).frames, frames())
    tifffile.imwrite(tmp_path / "s.tif", frames(np.uint16, 4095), photometric="miniswhite")
    with pytest.raises(InputError, match="0 is white"):
        Capture.load(tmp_path / "s.tif", SHOWN)


@pytest.mark.parametrize("codec", ["FFV1", "MJPG"])
def test_a_video_of_one_picture_per_pattern(tmp_path: Path, codec: str) -> None:
    """Grey levels as they were; a notice of a codec with loss."""
    path, images = tmp_path / "v.avi", frames()
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), 10, (28, 20), False)
    if not video.isOpened():
        pytest.skip(f"OpenCV writes no {codec} here")
    for image in images:
        video.write(image)
    video.release()
    found = Capture.load(path, SHOWN)
    if codec == "MJPG":
        assert names(found) == ["pictures compressed with loss (JPEG, video)"]
    else:
        assert not found.notices
        assert np.abs(found.frames.astype(int) - images).max() <= 1


def test_floating_point_becomes_levels_whatever_its_unit(tmp_path: Path) -> None:
    """1.0 of 0..1 is white; other units are scaled so that nothing clips; ratios stay."""
    images = frames()
    for unit, top in ((1 / 255, 65535 * (images.max() / 255)), (1.0, None), (1e6, None)):
        np.save(tmp_path / "s.npy", images * unit)
        found = Capture.load(tmp_path / "s.npy", SHOWN).frames
        np.testing.assert_allclose(found / found.max(), images / images.max(), atol=1e-4)
        assert top is None or found.max() == top
    broken = images / 255
    broken[3, 4, 5] = np.nan
    np.save(tmp_path / "s.npy", broken)
    found = Capture.load(tmp_path / "s.npy", SHOWN)
    assert not found.frames[:, 4, 5].any()
    assert names(found) == ["1 pixels are not finite in some picture"]


def test_colour_is_luminance_or_a_channel(tmp_path: Path) -> None:
    """Equal channels and alpha without a word; colours of different strength; one that is empty."""
    images = frames(top=200)
    alike = np.stack([*[images] * 3, np.full_like(images, 255)], -1)
    found = Capture.load(write(tmp_path / "grey", alike), SHOWN)
    np.testing.assert_array_equal(found.frames, images)
    assert found.notices == ()
    red, green, blue = (np.rint(images * share).astype(np.uint8) for share in (1.0, 0.8, 0.5))
    folder = write(tmp_path / "c", np.stack([blue, green, red], -1))  # OpenCV writes blue first
    whole = Capture.load(folder, SHOWN)
    exact = 0.299 * red + 0.587 * green + 0.114 * blue
    assert np.abs(whole.frames - exact).max() <= 0.5
    assert "luminance is taken" in names(whole)[0]
    for channel, levels in (("red", red), ("green", green), ("blue", blue)):
        found = Capture.load(folder, SHOWN, channel=channel)
        np.testing.assert_array_equal(found.frames, levels)
        assert found.notices == ()
    folder = write(tmp_path / "c", np.stack([0 * blue + 7, green, red], -1))
    assert "blue" in str(Capture.load(folder, SHOWN).notices[0])
    with pytest.raises(InputError, match=r"--channel blue: carries nothing .*take --channel"):
        Capture.load(folder, SHOWN, channel="blue")


def test_other_files_are_passed_over_and_said(tmp_path: Path) -> None:
    folder = write(tmp_path / "c", frames())
    for name in (".DS_Store", "._img_1.png", "Thumbs.db", "desktop.ini", "notes.txt"):
        (folder / name).write_bytes(b"\0")
    cv2.imwrite(str(folder / "preview.png"), frames()[0])
    found = Capture.load(folder, SHOWN)
    np.testing.assert_array_equal(found.frames, frames())
    passed, other = names(found)
    assert ".DS_Store" in passed
    assert "preview.png: not named as the other pictures, passed over" in other


def test_a_picture_saved_twice_and_a_counter_that_began_again(tmp_path: Path) -> None:
    images, first = frames(), 9990
    found = Capture.load(write(tmp_path / "twice", np.insert(images, 4, images[3], axis=0)), SHOWN)
    np.testing.assert_array_equal(found.frames, images)
    assert names(found) == ["img_5.png: the same as the picture before, passed over"]
    folder = write(tmp_path / "c", images[:10], "DSC_{:04}.png", first)
    found = Capture.load(write(folder, images[10:], "DSC_{:04}.png", 1), SHOWN)
    np.testing.assert_array_equal(found.frames, images)
    assert "DSC_9990.png is taken for the first" in names(found)[0]


@pytest.mark.parametrize(
    ("count", "words"),
    [
        (COUNT - 1, (f"{COUNT - 1} pictures", f"has {COUNT} frames", "1 lost")),
        (2 * COUNT, ("2 times as many", "of one exposure")),
        (COUNT + 3, ("3 too many", "another sequence or size")),
    ],
)
def test_another_number_of_pictures_says_what_would_have_it(
    count: int, words: tuple[str, ...], tmp_path: Path
) -> None:
    images = np.random.default_rng(0).integers(0, 255, (count, 9, 9), np.uint8)
    with pytest.raises(InputError) as caught:
        Capture.load(write(tmp_path / "c", images), SHOWN)
    for word in words:
        assert word in str(caught.value)


def test_what_is_no_folder_of_pictures(tmp_path: Path) -> None:
    folder = write(tmp_path / "c", frames())
    cv2.imwrite(str(folder / "img_3.png"), np.zeros((9, 9), np.uint8))
    for source, words in (
        (folder, r"img_3\.png: 9x9 of uint8, must be 20x28 of uint8"),
        (folder / "img_1.png", "one picture, must be a folder"),
        (tmp_path / "none", "no such file or folder"),
        (str(tmp_path / "none*.png"), "no pictures in this pattern"),
        (tmp_path, "no pictures in this folder"),
    ):
        with pytest.raises(InputError, match=words):
            Capture.load(source, SHOWN)


def test_a_description_without_files_takes_pictures_in_their_order(tmp_path: Path) -> None:
    folder = write(tmp_path / "c", frames(np.uint16, 1023))
    SHOWN.save(tmp_path / "sequence.toml")
    found = Capture.load(folder, tmp_path / "sequence.toml")
    np.testing.assert_array_equal(found.frames, frames(np.uint16, 1023))
    assert (found.sequence, found.bits) == (SHOWN, 10)


@pytest.mark.parametrize("tag", [2, 3, 6, 8])
@pytest.mark.parametrize("suffix", [".tif", ".png", ".jpg"])
def test_tags_of_orientation_are_ignored(suffix: str, tag: int, tmp_path: Path) -> None:
    """Frames and masks are as stored; a tagged JPEG is as the same JPEG without its tag."""
    image, path = frames()[0], tmp_path / f"a{suffix}"
    if suffix == ".tif":
        tifffile.imwrite(path, np.stack([image] * 2), extratags=[(274, "H", 1, tag, True)])
    else:
        data = cv2.imencode(suffix, image)[1]
        exif = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0" + bytes([tag]) + bytes(7)
        path.write_bytes(tagged(data.tobytes(), suffix, exif))
        image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    for found in read_pictures(path):
        np.testing.assert_array_equal(found, image[..., ::-1] if image.ndim > 2 else image)


def tagged(data: bytes, suffix: str, exif: bytes) -> bytes:
    """A PNG or JPEG with an Exif block."""
    if suffix == ".jpg":
        block = b"Exif\0\0" + exif
        return data[:2] + b"\xff\xe1" + (len(block) + 2).to_bytes(2, "big") + block + data[2:]
    chunk = b"eXIf" + exif
    block = len(exif).to_bytes(4, "big") + chunk + zlib.crc32(chunk).to_bytes(4, "big")
    return data[:33] + block + data[33:]


@pytest.mark.parametrize("suffix", [".png", ".webp"])
def test_an_animation_is_refused(suffix: str, tmp_path: Path) -> None:
    shown = cv2.Animation()
    shown.frames = [cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) for image in frames()[:3]]
    shown.durations = np.full(3, 100, np.int32)
    assert cv2.imwriteanimation(str(tmp_path / f"a{suffix}"), shown)
    with pytest.raises(InputError, match="an animation of 3 pictures"):
        read_pictures(tmp_path / f"a{suffix}")


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float16])
def test_small_tiles_and_half_precision_are_read(dtype: Any, tmp_path: Path) -> None:
    images = frames(top=200).astype(dtype)
    for more in ({"tile": (16, 16)}, {"tile": (16, 16), "compression": "zlib"}, {}):
        tifffile.imwrite(tmp_path / "a.tif", images, photometric="minisblack", **more)
        np.testing.assert_array_equal(read_pictures(tmp_path / "a.tif"), images)


def test_a_tiff_without_its_height_is_refused(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tif", frames()[0])
    with tifffile.TiffFile(tmp_path / "a.tif") as file:
        at = file.pages.first.tags["ImageLength"].offset
    damaged = bytearray((tmp_path / "a.tif").read_bytes())
    damaged[at : at + 12] = bytes(12)
    (tmp_path / "a.tif").write_bytes(damaged)
    with pytest.raises(InputError, match="its picture has no pixel"):
        read_pictures(tmp_path / "a.tif")


def test_pnm_with_numbers_as_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.pgm").write_text("P2\n2 1\n1023\n7 900\n", encoding="ascii")
    with pytest.raises(InputError, match="numbers are text; save it as PNG"):
        read_pictures(tmp_path / "a.pgm")


def test_a_file_of_another_length_than_its_header_says_is_refused(tmp_path: Path) -> None:
    """A .npy that goes on; half a JPEG with an end; both read by their libraries without a word."""
    np.save(tmp_path / "a.npy", frames())
    (tmp_path / "b.npy").write_bytes((tmp_path / "a.npy").read_bytes() + b"more")
    image = cv2.GaussianBlur(frames()[0], (0, 0), 1.0)
    data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 100])[1].tobytes()
    (tmp_path / "b.jpg").write_bytes(data[: len(data) // 2 + 150] + b"\xff\xd9")
    for name, words in (("b.npy", "its header says"), ("b.jpg", "a JPEG that is cut off")):
        with pytest.raises(InputError, match=words):
            read_pictures(tmp_path / name)
