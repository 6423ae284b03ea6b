"""A capture as a folder: `capture.toml` says what its pictures show, `frames/*.png`, `images/*.png` in colour
hold them, beside them `scene.toml` and `truth.npz` where they are known. capture.toml:

    version = 1      2: in colour
    rows, cols       of the pattern surface
    bits             of the camera, 8 to 16 (default: the fewest that hold the levels)
    name             of the sequence (default "custom")
    nominal          true where rows and cols are only the unit of the coordinates (default false)
    [[frames]]       one per frame: the fields of patterns.Frame; in version 1 also `file`, relative to the
                     folder, and `time` in s (each in all or in none)
    [colour]         of version 2: `stripes`, order of the display's, as of patterns.Packing; `mosaic`, as the
                     camera named it: of raw pictures, 'RGGB'; 'RGB', 'YUYV': three values in every pixel
    [[images]]       of version 2, one per picture: `file`, `time`, and `frames`, numbers of the frames that
                     red, green and blue show

Others' captures are described by such a file kept elsewhere; where it names no files, the pictures of the
folder are taken in natural order, and a file that Sequence.save wrote serves as well. Nothing else is
allowed in it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import tomli_w
from numpy.typing import NDArray

from optolever.blocks import on_cores
from optolever.errors import InputError
from optolever.files import atomic_file, atomic_folder
from optolever.patterns import Sequence
from optolever.scene import Scene, Trace
from optolever.schema import built, from_table
from optolever.toml import read_toml

__all__ = ["DESCRIPTION", "Description", "in_colour", "write_description", "write_folder"]

DESCRIPTION = "capture.toml"
#: Versions of a description of grey pictures, and of three frames in a picture.
_GREY, _COLOUR = 1, 2
#: Seconds (or microseconds since 1970) at most: up to here a float holds integers.
_LATEST = 2.0**53
_TABLES = ("frames", "images")
_HEAD = ("name", "rows", "cols", "nominal")
# Noise has no repetitions to look for: on noisy fringes this beats zlib's level 3 in size and time.
_PNG_OPTIONS = (
    cv2.IMWRITE_PNG_COMPRESSION,
    1,
    cv2.IMWRITE_PNG_STRATEGY,
    cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY,
)


@dataclass(frozen=True, slots=True, eq=False)
class Description:
    """files: of the pictures, relative to their folder; none: they are taken in natural order. times: (E,) of
    the E pictures, s; bits: None where nothing is said; mosaic: as the camera named it."""

    sequence: Sequence
    files: tuple[str, ...] = ()
    times: NDArray[np.float64] | None = None
    bits: int | None = None
    mosaic: str = ""

    @classmethod
    def load(cls, path: Path) -> Description:
        """Read a capture.toml. InputError names file, field, value and limit."""
        plain = read_toml(path)
        head = from_table(_Head, {k: v for k, v in plain.items() if k not in _TABLES}, str(path))
        if head.bits is not None and not 8 <= head.bits <= 16:
            raise InputError(f"{path}: bits is {head.bits!r}, must be a whole number from 8 to 16")
        coloured = _coloured(plain)
        where = _TABLES[coloured]
        pictures = built(tuple[_Picture, ...], plain.get(where, ()), f"{path}: {where}")
        if not pictures:
            raise InputError(f"{path}: {where} is missing, must be at least one [[{where}]] table")
        files = _files(pictures, f"{path}: {where}")
        version = head.version if files or head.version is not None else _GREY
        if version != (_GREY, _COLOUR)[coloured]:
            wrong = f"version is {'missing' if version is None else version}"
            raise InputError(f"{path}: {wrong}, must be {_GREY}, in colour {_COLOUR}")
        shown = {key: plain[key] for key in (*_HEAD, "frames") if key in plain}
        mosaic = ""
        if coloured:
            colour = built(_Colour, plain.get("colour", {}), f"{path}: colour")
            exposures = [list(each.frames or ()) for each in pictures]
            mosaic = colour.mosaic
            shown["packing"] = {"stripes": colour.stripes, "exposures": exposures}
        else:
            own = ("file", "time")
            shown["frames"] = [{k: v for k, v in each.items() if k not in own} for each in shown["frames"]]
        sequence = Sequence.from_dict(shown, str(path))
        return cls(sequence, files, _times(pictures, f"{path}: {where}"), head.bits, mosaic)

    def to_dict(self) -> dict[str, Any]:
        """Plain TOML types."""
        plain, packing = self.sequence.to_dict(), self.sequence.packing
        tables: list[dict[str, Any]] = [{} for _ in range(self.sequence.exposures)]
        for k, table in enumerate(tables):
            table |= {"file": self.files[k]} if self.files else {}
            table |= {} if self.times is None else {"time": float(self.times[k])}
        head = {key: plain[key] for key in _HEAD if key in plain}
        head |= {} if self.bits is None else {"bits": self.bits}
        if packing is None:
            frames = [{**table, **frame} for table, frame in zip(tables, plain["frames"], strict=True)]
            return {"version": _GREY, **head, "frames": frames}
        pairs = zip(tables, packing.exposures, strict=True)
        images = [{**table, "frames": list(own)} for table, own in pairs]
        colour = {"stripes": packing.stripes} | ({"mosaic": self.mosaic} if self.mosaic else {})
        return {"version": _COLOUR, **head, "colour": colour, "images": images, "frames": plain["frames"]}


def write_folder(
    folder: str | Path,
    pictures: NDArray[Any],
    shown: Description,
    scene: Scene | None,
    truth: Trace | None,
) -> None:
    """Write pictures (N, H, W), or red, green and blue (N, H, W, 3), all or nothing."""
    inside = "frames" if shown.sequence.packing is None else "images"
    files = tuple(f"{inside}/{index:03d}.png" for index in range(len(pictures)))
    with atomic_folder(folder) as target:
        (target / inside).mkdir()
        on_cores(lambda index: _write_image(target / files[index], pictures[index]), range(len(pictures)))
        described = replace(shown, files=files)
        (target / DESCRIPTION).write_text(tomli_w.dumps(described.to_dict()), encoding="utf-8")
        if scene is not None:
            scene.save(target / "scene.toml")
        if truth is not None:
            truth.save(target / "truth.npz")


def in_colour(path: Path) -> bool:
    """Whether a description is of pictures in colour."""
    return path.is_file() and _coloured(read_toml(path))


def write_description(path: str | Path, sequence: Sequence, files: Iterable[str] = ()) -> None:
    """A capture.toml: the sequence, for pictures in that order, or for these files of a folder. Only the same
    description is written over; InputError names the file."""
    target, text = Path(path), tomli_w.dumps(Description(sequence, tuple(files)).to_dict())
    if target.is_file() and target.read_bytes() != text.encode():
        raise InputError(f"{path}: exists and describes something else; show --out names another file")
    with atomic_file(target) as temporary:
        temporary.write_bytes(text.encode())


def _coloured(plain: Mapping[str, Any]) -> bool:
    return "images" in plain or plain.get("version") == _COLOUR


@dataclass(frozen=True, slots=True)
class _Head:
    rows: Any = None
    cols: Any = None
    version: int | None = None
    bits: int | None = None
    name: Any = None
    nominal: Any = None
    colour: Any = None
    frames: Any = None
    images: Any = None


@dataclass(frozen=True, slots=True)
class _Colour:
    stripes: str
    mosaic: Literal["", "RGB", "YUYV", "RGGB", "GRBG", "GBRG", "BGGR"] = ""


@dataclass(frozen=True, slots=True)
class _Picture:
    file: str | None = None
    time: float | None = None
    frames: tuple[int, int, int] | None = None


def _files(pictures: tuple[_Picture, ...], where: str) -> tuple[str, ...]:
    """Names of all pictures, or none."""
    files = [each.file for each in pictures]
    if not any(files):
        return ()
    for i, file in enumerate(files):
        must = ""
        if not file:
            must = "must name an image"
        elif Path(file).is_absolute() or ".." in Path(file).parts:
            must = "must lie inside the capture's folder"
        elif files.index(file) < i:
            must = f"must be named once, is that of [{files.index(file)}]"
        if must:
            raise InputError(f"{where}[{i}]: file is {'missing' if file is None else repr(file)}, {must}")
    return tuple(Path(str(file)).as_posix() for file in files)


def _times(pictures: tuple[_Picture, ...], where: str) -> NDArray[np.float64] | None:
    times = [each.time for each in pictures]
    if all(time is None for time in times):
        return None
    for i, time in enumerate(times):
        if time is None or not abs(time) <= _LATEST:
            shown = "missing" if time is None else repr(time)
            raise InputError(f"{where}[{i}]: time is {shown}, must be seconds (in every picture or in none)")
    return np.array(times, np.float64)


def _write_image(path: Path, image: NDArray[Any]) -> None:
    done, data = cv2.imencode(".png", image if image.ndim == 2 else image[..., ::-1], _PNG_OPTIONS)
    if not done:
        raise OSError(f"{path}: OpenCV cannot encode {image.dtype} {image.shape}")
    path.write_bytes(np.asarray(data).tobytes())
