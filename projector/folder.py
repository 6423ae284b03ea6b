"""A capture as a folder: `capture.toml` describes every frame, `frames/*.png` hold them without loss.

    version = 1
    rows, cols       of the pattern surface
    bits             of the camera, 8 to 16 (default 8)
    name             of the sequence (default "custom")
    nominal          true where rows and cols are only the unit of the coordinates (default false)
    [[frames]]       one per frame: `file`, relative to the folder, and `time` in s (each in all or in none),
                     and the fields of patterns.Frame

Others' captures are described by such a file kept elsewhere; where it names no files, the pictures of the
folder are taken in natural order, and a file that Sequence.save wrote serves as well. Nothing else is
allowed in it, and `frames/` holds no other pictures.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tomli_w
from numpy.typing import NDArray

from optolever.blocks import on_cores
from optolever.errors import InputError
from optolever.files import atomic_file, atomic_folder
from optolever.notices import Notice
from optolever.patterns import Sequence
from optolever.pictures import CHANNELS, PICTURES, is_lossy
from optolever.scene import Scene, Trace, load
from optolever.toml import read_toml

from .incoming import COLOURED, LOSSY, Source, incoming, passed_over, pictures_of, read_files

__all__ = [
    "COLOURED_VERSION", "bits_of", "colour_description", "picture_files", "read_description", "read_folder",
    "write_description", "write_folder",
]  # fmt: skip

Image = NDArray[np.uint8] | NDArray[np.uint16]

#: Versions of a description of grey pictures, and of three frames in a picture (`colour_capture`).
_VERSION, COLOURED_VERSION = 1, 2
#: Seconds (or microseconds since 1970) at most: up to here a float holds integers.
_LATEST = 2.0**53
_DESCRIPTION, _FRAMES, _SCENE, _TRUTH = "capture.toml", "frames", "scene.toml", "truth.npz"
_KEYS = ("version", "rows", "cols", "bits", "name", "nominal", "frames")
# Noise has no repetitions to look for: on noisy fringes this beats zlib's level 3 in size and time.
_PNG_OPTIONS = (
    cv2.IMWRITE_PNG_COMPRESSION,
    1,
    cv2.IMWRITE_PNG_STRATEGY,
    cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY,
)


def picture_files(folder: str | Path, description: str | Path | None = None) -> list[str]:
    """Names of a capture's pictures in the order of showing, relative to its folder; none where it is no
    folder."""
    base = Path(folder)
    if not base.is_dir():
        return []
    toml = base / _DESCRIPTION if description is None else Path(description)
    named = read_description(toml)[1] if toml.is_file() else []
    return named or [path.name for path in pictures_of(base)]


def write_folder(
    folder: str | Path,
    frames: Image,
    sequence: Sequence,
    times: NDArray[np.float64] | None,
    bits: int,
    scene: Scene | None,
    truth: Trace | None,
) -> None:
    """Write the fields of a Capture, and where known its scene and truth, all or nothing."""
    with atomic_folder(folder) as target:
        (target / _FRAMES).mkdir()
        files = [f"{_FRAMES}/{index:03d}.png" for index in range(len(frames))]
        on_cores(lambda index: _write_image(target / files[index], frames[index]), range(len(frames)))
        description = tomli_w.dumps(_described(sequence, times, bits, files))
        (target / _DESCRIPTION).write_text(description, encoding="utf-8")
        if scene is not None:
            scene.save(target / _SCENE)
        if truth is not None:
            truth.save(target / _TRUTH)


def read_folder(
    folder: Source, description: str | Path | None = None, channel: str = "luminance"
) -> dict[str, Any]:
    """The fields of a Capture, checked. InputError names file, field, value and limit."""
    if description is not None:
        sequence, files, times, bits = read_description(Path(description))
        if not files:
            frames, notices = incoming(folder, sequence, channel)
            own = {"frames": frames, "bits": bits or bits_of(frames), "notices": notices}
            return {**own, "sequence": sequence, "timestamps": times}
    base = Path(folder) if isinstance(folder, str | Path) else Path(folder[0])
    if not base.is_dir():
        what = (
            "is no folder of frames; decode --sequence takes pictures in a file"
            if base.exists()
            else "no such folder"
        )
        raise InputError(f"{base}: {what}")
    toml = base / _DESCRIPTION if description is None else Path(description)
    if description is None and not toml.is_file():
        raise InputError(
            f"{base}: no {_DESCRIPTION} says what was shown; put the one there that optolever show wrote, or "
            "say it to optolever decode: --sequence NAME --pixels WIDTHxHEIGHT, or --description FILE"
        )
    sequence, files, times, bits = read_description(toml)
    if not files:
        return read_folder(base, toml, channel)
    bits = bits or 8
    notices = _passed_over(base, files, own=description is None)
    pictures = read_files([base / file for file in files], channel)
    if len(pictures) != len(files):
        several = next(picture.file for picture in pictures if picture.file.endswith("]"))
        raise InputError(f"{base}: {several.rpartition('[')[0]} holds several pictures, must be one")
    images = [picture.levels for picture in pictures]
    for file, image in zip(files, images, strict=True):
        _require_image(base / file, image, bits)
        if image.shape != images[0].shape:
            raise InputError(
                f"{base / file}: {_size(image)} pixels, must be {_size(images[0])} as {files[0]}"
            )
    if channel == CHANNELS[-1] and any(picture.colours is not None for picture in pictures):
        notices += (COLOURED,)
    if any(is_lossy(base / file) for file in files):
        notices += (LOSSY,)
    return {
        "frames": np.stack(images),
        "sequence": sequence,
        "scene": _read_scene(base / _SCENE, sequence, images[0]),
        "timestamps": times,
        "bits": bits,
        "notices": notices,
    }


def bits_of(frames: Image) -> int:
    """The fewest of 8, 10, 12, 14 and 16 bits that hold frames."""
    if frames.dtype == np.uint8:
        return 8
    return next(bits for bits in (10, 12, 14, 16) if frames.max() < 2**bits)


def read_description(path: Path) -> tuple[Sequence, list[str], NDArray[np.float64] | None, int | None]:
    """A capture.toml: sequence, file of each frame (none: it names no files), time of each frame (s) or None,
    bits or None."""
    plain = read_toml(path)
    if plain.get("version") == COLOURED_VERSION:
        cure = "optolever decode DIR --response RIG.toml makes frames of them"
        raise InputError(f"{path}: pictures of three frames each (version 2); {cure}")
    for key in plain:
        if key not in _KEYS:
            raise InputError(f"{path}: unknown field {key!r}, known are {', '.join(_KEYS)}")
    bits = plain.get("bits")
    if bits is not None and (not isinstance(bits, int) or isinstance(bits, bool) or not 8 <= bits <= 16):
        raise InputError(f"{path}: bits is {bits!r}, must be a whole number from 8 to 16")
    tables = plain.get("frames")
    if not isinstance(tables, list) or not tables or not all(isinstance(table, dict) for table in tables):
        raise InputError(f"{path}: frames is {tables!r:.40}, must be at least one [[frames]] table")
    named = any("file" in table for table in tables)
    version = plain.get("version", "missing" if named else _VERSION)
    if version != _VERSION:
        raise InputError(f"{path}: version is {version!r}, must be {_VERSION}")
    files = [_file(table, f"{path}: frames[{i}]") for i, table in enumerate(tables)] if named else []
    if len(set(files)) != len(files):
        twice = next(file for file in files if files.count(file) > 1)
        raise InputError(f"{path}: file {twice!r} is named {files.count(twice)} times, must be named once")
    times = _times(tables, path)
    shown = [{key: value for key, value in table.items() if key not in ("file", "time")} for table in tables]
    outer: dict[str, Any] = {key: plain[key] for key in ("name", "rows", "cols", "nominal") if key in plain}
    return Sequence.from_dict({**outer, "frames": shown}, str(path)), files, times, bits


def _require_image(path: Path, image: NDArray[Any], bits: int) -> None:
    """InputError unless it holds values below 2^bits in the type of so many."""
    expected = np.dtype(np.uint8 if bits == 8 else np.uint16)
    if image.dtype != expected:
        cure = f"{bits} bits need {expected}: write bits = {8 * image.dtype.itemsize}, or the camera's, first"
        raise InputError(f"{path}: {image.dtype} pixels, {cure}")
    if image.max() > 2**bits - 1:
        raise InputError(f"{path}: value {image.max()}, the limit of {bits} bits is {2**bits - 1}")


def _read_scene(path: Path, sequence: Sequence, image: Image) -> Scene | None:
    """The scene next to the frames, if there is one; its pattern and camera must be those of the capture."""
    if not path.is_file():
        return None
    scene = load(path)
    shown, pattern = (sequence.rows, sequence.cols), (scene.pattern.rows, scene.pattern.cols)
    if shown != pattern:
        raise InputError(
            f"{path}: pattern is {pattern[0]}x{pattern[1]}, not {shown[0]}x{shown[1]} as in {_DESCRIPTION}"
        )
    if image.shape != (scene.camera.rows, scene.camera.cols):
        raise InputError(
            f"{path}: camera is {scene.camera.rows}x{scene.camera.cols}, must be {_size(image)} as the frames"
        )
    return scene


def write_description(path: str | Path, sequence: Sequence, files: Iterable[str] = ()) -> None:
    """A capture.toml: the sequence, for pictures in that order, or for these files of a folder. Only the same
    description is written over; InputError names the file."""
    if sequence.packing is None:
        plain: dict[str, Any] = {"version": _VERSION, **sequence.to_dict()}
        named = [{"file": file} for file in files] or [{} for _ in sequence.frames]
        plain["frames"] = [{**file, **table} for file, table in zip(named, plain["frames"], strict=True)]
    else:
        plain = colour_description(sequence, files)
    target, text = Path(path), tomli_w.dumps(plain)
    if target.is_file() and target.read_bytes() != text.encode():
        raise InputError(f"{path}: exists and describes something else; show --out names another file")
    with atomic_file(target) as temporary:
        temporary.write_bytes(text.encode())


def colour_description(sequence: Sequence, files: Iterable[str] = ()) -> dict[str, Any]:
    """A capture.toml of a sequence in colour, for pictures in that order, or for these files of a folder."""
    packing, plain = sequence.packing, sequence.to_dict()
    if packing is None:
        raise InputError(f"sequence {sequence.name}: is in grey; patterns.packed puts it into colour")
    named = [{"file": file} for file in files] or [{} for _ in packing.exposures]
    images = [{**file, "frames": list(own)} for file, own in zip(named, packing.exposures, strict=True)]
    head = {"version": COLOURED_VERSION, **{key: plain[key] for key in _KEYS[1:-1] if key in plain}}
    return {**head, "colour": {"stripes": packing.stripes}, "images": images, "frames": plain["frames"]}


def _described(
    sequence: Sequence, times: NDArray[np.float64] | None, bits: int, files: list[str]
) -> dict[str, Any]:
    plain = sequence.to_dict()
    tables = [{"file": file, **table} for file, table in zip(files, plain["frames"], strict=True)]
    if times is not None:
        for table, time in zip(tables, times.tolist(), strict=True):
            table["time"] = time
    head: dict[str, Any] = {key: plain[key] for key in ("name", "rows", "cols", "nominal") if key in plain}
    return {"version": _VERSION, **head, "bits": bits, "frames": tables}


def _write_image(path: Path, image: Image) -> None:
    done, data = cv2.imencode(".png", image, _PNG_OPTIONS)
    if not done:
        raise OSError(f"{path}: OpenCV cannot encode {image.dtype} {image.shape}")
    path.write_bytes(data.tobytes())


def _file(table: Mapping[str, Any], where: str) -> str:
    file = table.get("file")
    if not isinstance(file, str) or not file:
        raise InputError(f"{where}: file is {'missing' if file is None else repr(file)}, must name an image")
    if Path(file).is_absolute() or ".." in Path(file).parts:
        raise InputError(f"{where}: file is {file!r}, must lie inside the capture's folder")
    return Path(file).as_posix()


def _times(tables: list[Mapping[str, Any]], path: Path) -> NDArray[np.float64] | None:
    times = [table.get("time") for table in tables]
    if all(time is None for time in times):
        return None
    for i, time in enumerate(times):
        if not isinstance(time, int | float) or isinstance(time, bool) or not abs(time) <= _LATEST:
            shown = "missing" if time is None else repr(time)
            raise InputError(
                f"{path}: frames[{i}]: time is {shown}, must be seconds (in every frame or in none)"
            )
    return np.array(times, np.float64)


def _passed_over(base: Path, files: list[str], *, own: bool) -> tuple[Notice, ...]:
    """`frames/` holds the files of the description; others get a notice, pictures are refused where
    the description is the folder's own."""
    folder = base / _FRAMES
    present = sorted(folder.iterdir()) if folder.is_dir() else []
    extra = [path for path in present if f"{_FRAMES}/{path.name}" not in files]
    named = [name for name in files if name.startswith(f"{_FRAMES}/")]
    if not extra or not named:
        return ()
    for path in extra if own else ():
        if path.suffix.lower() in PICTURES and not path.name.startswith("."):
            raise InputError(f"{path}: not in the description, which has {len(named)} frames")
    return (passed_over([path.name for path in extra]),)


def _size(image: Image) -> str:
    return f"{image.shape[0]}x{image.shape[1]}"
