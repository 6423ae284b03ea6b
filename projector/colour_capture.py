"""Pictures of a sequence in colour as the camera took them, and their folder.

    version = 2
    rows, cols, bits, name, nominal     as of version 1 (`folder`)
    [colour]         stripes: order of the display's, 'rgb', 'bgr', 'none' or 'unknown'; mosaic, as the
                     camera named it: of raw pictures, 'RGGB'; 'RGB', 'YUYV': three values in every pixel
    [[images]]       one per picture: `file` and `time` as of frames of version 1, `frames`: numbers of the
                     frames that red, green and blue show
    [[frames]]       the fields of patterns.Frame

Levels are kept as taken: frames are made of them on reading, by the colours' response of the rig.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import tomli_w
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.files import atomic_folder
from optolever.patterns import Sequence
from optolever.pictures import is_lossy, read_pictures
from optolever.scene import MOSAICS, Scene, Trace, load
from optolever.schema import from_table
from optolever.toml import read_toml

from .capture import Capture
from .folder import COLOURED_VERSION, bits_of, colour_description
from .incoming import Source, pictures_of
from .unmixing import ColourResponse, unmixed

__all__ = ["ColourCapture", "in_colour", "load_capture"]

_DESCRIPTION, _SCENE = "capture.toml", "scene.toml"
_HEAD = ("name", "rows", "cols", "nominal")


@dataclass(frozen=True, slots=True, eq=False)
class ColourCapture:
    """Pictures (E, H, W, 3), or (E, 2 H, 2 W) of a mosaic, of the E exposures of `sequence`; scene: the known
    rig, whose camera has H x W pixels; timestamps (E,), s; bits: of the camera; mosaic: as it named it,
    empty: unknown."""

    images: NDArray[np.uint8] | NDArray[np.uint16]
    sequence: Sequence
    scene: Scene | None = None
    timestamps: NDArray[np.float64] | None = None
    bits: int = 8
    mosaic: str = ""

    @property
    def raw(self) -> str | None:
        """One of MOSAICS, of raw pictures; None: three values in every pixel, or unknown."""
        return self.mosaic if self.mosaic in MOSAICS else None

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of the pictures."""
        return int(self.images.shape[1]), int(self.images.shape[2])

    def unmixed(self, response: ColourResponse) -> Capture:
        """The frames of a grey camera, by a measured response. InputError where that is of other pictures."""
        if self.mosaic and self.raw != response.mosaic:
            kind, cure = response.mosaic or "RGB", "measure it again: optolever response --colour"
            raise InputError(f"colour: pictures are {self.mosaic}, the response is of {kind}; {cure}")
        found = unmixed(self.images, self.sequence, response, bits=self.bits)
        return replace(found, scene=self.scene)

    def save(self, folder: str | Path, truth: Trace | None = None) -> None:
        """Write `capture.toml` and `images/*.png`, with `scene.toml` and `truth.npz` where they are known."""
        with atomic_folder(folder) as target:
            (target / "images").mkdir()
            files = [f"images/{index:03d}.png" for index in range(len(self.images))]
            for file, image in zip(files, self.images, strict=True):
                _, data = cv2.imencode(".png", image[..., ::-1] if image.ndim == 3 else image)
                (target / file).write_bytes(data.tobytes())
            plain = colour_description(self.sequence, files) | {"bits": self.bits}
            if self.mosaic:
                plain["colour"]["mosaic"] = self.mosaic
            if self.timestamps is not None:
                for table, time in zip(plain["images"], self.timestamps.tolist(), strict=True):
                    table["time"] = time
            (target / _DESCRIPTION).write_text(tomli_w.dumps(plain), encoding="utf-8")
            if self.scene is not None:
                self.scene.save(target / _SCENE)
            if truth is not None:
                truth.save(target / "truth.npz")

    @classmethod
    def load(cls, folder: Source, description: str | Path | None = None) -> ColourCapture:
        """Read a folder of `save`, or the pictures of a folder, pattern, file or list in natural order, by a
        description. InputError names file, field, value and limit."""
        base = Path(folder) if isinstance(folder, str | Path) else Path(folder[0])
        toml = base / _DESCRIPTION if description is None else Path(description)
        sequence, files, times, bits, mosaic = _read(toml)
        paths = [base / file for file in files] or pictures_of(folder)
        lossy = next((path for path in paths if is_lossy(path)), None)
        if lossy is not None:
            why = "is compressed with loss, which mixes the colours of neighbours"
            raise InputError(f"{lossy}: {why}; save PNG or TIFF, or show grey patterns")
        stacks = [read_pictures(path) for path in paths]
        pictures = [picture for stack in stacks for picture in stack]
        if len(pictures) != sequence.exposures:
            wanted = f"{toml} describes {sequence.exposures} exposures"
            raise InputError(f"{base}: {len(pictures)} pictures, {wanted}; keep one picture of each")
        for picture in pictures:
            if picture.shape != pictures[0].shape or picture.dtype not in (np.uint8, np.uint16):
                found = f"a picture is {picture.dtype} {picture.shape}"
                raise InputError(
                    f"{base}: {found}, must be 8 or 16 bits and {pictures[0].shape} as the first"
                )
        images = np.stack(pictures)
        images = images[..., :3] if images.ndim == 4 and images.shape[-1] > 2 else images
        scene = load(base / _SCENE) if (base / _SCENE).is_file() else None
        return cls(images, sequence, scene, times, bits or bits_of(images), mosaic)


def in_colour(toml: Path) -> bool:
    """Whether a description is of pictures in colour."""
    plain = read_toml(toml) if toml.is_file() else {}
    return "images" in plain or plain.get("version") == COLOURED_VERSION


def load_capture(
    folder: Source,
    description: str | Path | None = None,
    channel: str = "luminance",
    colours: ColourResponse | None = None,
) -> Capture:
    """`Capture.load`, or the frames of pictures in colour, by the colours' response of their rig."""
    base = Path(folder) if isinstance(folder, str | Path) else Path(folder[0])
    toml = base / _DESCRIPTION if description is None else Path(description)
    if not in_colour(toml):
        return Capture.load(folder, description, channel)
    taken = ColourCapture.load(folder, description)
    if colours is None:
        cure = "name the rig (decode --response RIG.toml) in which optolever response --colour stored it"
        raise InputError(f"{toml}: three frames in a picture need the response of the colours; {cure}")
    return taken.unmixed(colours)


@dataclass(frozen=True, slots=True)
class _Colour:
    stripes: str
    mosaic: Literal["", "RGB", "YUYV", "RGGB", "GRBG", "GBRG", "BGGR"] = ""


@dataclass(frozen=True, slots=True)
class _Image:
    frames: tuple[int, int, int]
    file: str | None = None
    time: float | None = None


@dataclass(frozen=True, slots=True)
class _Description:
    version: int
    rows: Any
    cols: Any
    colour: _Colour
    images: tuple[_Image, ...]
    frames: Any
    bits: int | None = None
    name: Any = "custom"
    nominal: Any = False


def _read(path: Path) -> tuple[Sequence, list[str], NDArray[np.float64] | None, int | None, str]:
    """Sequence, file of each picture (none: it names no files), times or None, bits or None, mosaic."""
    table = read_toml(path)
    found = from_table(_Description, table, str(path))
    if found.version != COLOURED_VERSION:
        raise InputError(f"{path}: version is {found.version}, must be {COLOURED_VERSION}")
    if found.bits is not None and not 8 <= found.bits <= 16:
        raise InputError(f"{path}: bits is {found.bits}, must be a whole number from 8 to 16")
    files = [image.file for image in found.images if image.file is not None]
    times = [image.time for image in found.images if image.time is not None]
    for name, own in (("file", files), ("time", times)):
        if own and len(own) != len(found.images):
            raise InputError(f"{path}: images: {name} must be in every table or in none")
    for file in files:
        if Path(file).is_absolute() or ".." in Path(file).parts:
            raise InputError(f"{path}: file is {file!r}, must lie inside the capture's folder")
    packing = {"stripes": found.colour.stripes, "exposures": [list(one.frames) for one in found.images]}
    outer = {key: table[key] for key in (*_HEAD, "frames") if key in table}
    sequence = Sequence.from_dict({**outer, "packing": packing}, str(path))
    times_s = np.array(times, np.float64) if times else None
    return sequence, files, times_s, found.bits, found.colour.mosaic
