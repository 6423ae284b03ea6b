"""A user's patterns and decoders: a Python function, images with a description, a file, a name."""

import importlib
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.decode import Correspondence
from optolever.errors import InputError
from optolever.patterns import Frame, Sequence, sequence_from_text, sequence_names
from optolever.pictures import grey_of, read_picture
from optolever.toml import read_toml

__all__ = ["UserDecoder", "UserImages", "user_decoder", "user_sequence"]

SLACK = 1  # grey levels by which an image may differ from its description
Levels = NDArray[np.uint8]
#: From frames (N, H, W) and their Sequence or images (N, rows, cols) to a correspondence.
UserDecoder = Callable[[NDArray[Any], Sequence | Levels], Correspondence]


@dataclass(frozen=True, slots=True, eq=False)
class UserImages:
    """Images (N, rows, cols) uint8 for a surface of rows x cols cells, and their name."""

    levels: Levels
    name: str

    def __len__(self) -> int:
        return len(self.levels)


def user_sequence(text: str, rows: int, cols: int, *, resized: bool = False) -> Sequence | UserImages:
    """The sequence behind 'module:function', a folder, a .toml file or a name.

    The module is in the working folder or installed. The function is called with rows and cols and returns a
    Sequence of that size, or images (N, rows, cols) uint8 for a user's decoder. A folder holds
    `sequence.toml` as Sequence.save_png writes it, or `coordinates.toml`:

        [[frames]]
        file = "a.png"
        axis = "u"        # the coordinate along which the image varies

    Each image has the size of the pattern and varies along its axis alone; it becomes a frame of free levels.
    resized: rows x cols belong to a scene with a resampled camera; a .toml file is cropped to its first rows
    and columns. InputError names the error.
    """
    if text.partition(":")[0] in sequence_names() or (text.endswith(".toml") and not resized):
        return sequence_from_text(text, rows, cols)
    if text.endswith(".toml"):
        return _cropped(text, rows, cols)
    if Path(text).is_dir():
        return _from_folder(Path(text), rows, cols)
    return _from_function(text, rows, cols)


def user_decoder(text: str) -> UserDecoder:
    """The function behind 'module:function'. InputError where there is none, where it raises, and where it
    returns anything but a Correspondence of the frames' size."""
    function = _imported(f"decoder {text!r}", text)

    def decode(frames: NDArray[Any], pattern: Sequence | Levels) -> Correspondence:
        found = function(frames, pattern)
        if not isinstance(found, Correspondence):
            raise InputError(f"decoder {text!r}: returns {type(found).__name__}, must be a Correspondence")
        if found.u.shape != frames.shape[1:]:
            raise InputError(f"decoder {text!r}: returns {found.u.shape} pixels, must be {frames.shape[1:]}")
        return found

    return decode


@contextmanager
def _working_folder() -> Iterator[None]:
    """Modules of the working folder can be imported; it comes last, so that it hides no other module."""
    before = list(sys.path)
    sys.path.append(str(Path.cwd()))
    try:
        yield
    finally:
        sys.path[:] = before


def _imported(what: str, text: str) -> Callable[..., Any]:
    """The function behind 'module:function'. InputError, which begins with `what`, if it cannot be imported,
    and where it raises."""
    module, _, name = text.partition(":")
    with _working_folder():
        try:
            function = getattr(importlib.import_module(module), name)
        except (ImportError, AttributeError, ValueError) as error:
            raise InputError(f"{what}: cannot be imported ({error})") from error
    if not callable(function):
        raise InputError(f"{what}: is {type(function).__name__}, must be a function")

    def called(*arguments: Any) -> Any:
        try:
            with _working_folder():
                return function(*arguments)
        except Exception as error:  # whatever a user's function raises is a finding about that function
            raise InputError(f"{what}: raises {type(error).__name__}: {error}") from error

    return called


def _from_function(text: str, rows: int, cols: int) -> Sequence | UserImages:
    what = f"pattern {text!r}"
    if ":" not in text:
        raise InputError(f"{what}: is no folder, no .toml, no module:function and no known sequence")
    found = _imported(what, text)(rows, cols)
    pattern: Sequence | UserImages
    if isinstance(found, np.ndarray) and found.dtype == np.uint8 and found.ndim == 3 and len(found):
        size, pattern = found.shape[1:], UserImages(found, text)
    elif isinstance(found, Sequence):
        size, pattern = (found.rows, found.cols), found
    else:
        kind = f"{found.dtype} {found.shape}" if isinstance(found, np.ndarray) else type(found).__name__
        raise InputError(f"{what}: returns {kind}, must be a Sequence or uint8 images (N, rows, cols)")
    if size != (rows, cols):
        raise InputError(f"{what}: is {size[0]}x{size[1]} cells, must be {rows}x{cols}")
    return pattern


def _cropped(path: str, rows: int, cols: int) -> Sequence:
    found = Sequence.load(path)
    if found.rows < rows or found.cols < cols:
        raise InputError(
            f"{path}: is for {found.rows}x{found.cols} cells, the resampled surface has {rows}x{cols}; name "
            "a smaller size (design --pixels), or a sequence for more cells"
        )
    return replace(found, rows=rows, cols=cols)


def _from_folder(folder: Path, rows: int, cols: int) -> Sequence:
    if (folder / "sequence.toml").is_file():
        found = sequence_from_text(str(folder / "sequence.toml"), rows, cols)
        for index in range(len(found)):
            path = folder / f"{index:03d}.png"
            image = _image(path, rows, cols).astype(np.int16)
            if np.abs(image - found.render_frame(index)).max() > SLACK:
                raise InputError(f"{path}: is not the image that sequence.toml describes as frame {index}")
        return found
    path = folder / "coordinates.toml"
    if not path.is_file():
        raise InputError(f"{folder}: holds neither sequence.toml nor coordinates.toml")
    tables = read_toml(path).get("frames")
    if not isinstance(tables, list) or not tables:
        raise InputError(f"{path}: frames is missing, must be at least one [[frames]] table")
    frames = tuple(_frame(path, i, table, rows, cols) for i, table in enumerate(tables))
    return Sequence(frames, rows, cols, folder.name)


def _frame(path: Path, index: int, table: Any, rows: int, cols: int) -> Frame:
    where = f"{path}: frames[{index}]"
    if not isinstance(table, dict) or set(table) - {"file", "axis"}:
        raise InputError(f"{where}: is {table!r:.60}, must hold file and axis")
    axis, name = table.get("axis"), table.get("file")
    if axis not in ("u", "v") or not isinstance(name, str):
        raise InputError(f"{where}: file {name!r} and axis {axis!r}, must be text and 'u' or 'v'")
    image = _image(path.parent / name, rows, cols)
    along = image if axis == "u" else image.T
    if np.ptp(along, axis=0).max() > SLACK:
        raise InputError(f"{where}: {name} varies across {axis} too, must vary along it alone")
    return Frame("levels", axis, levels=tuple(int(level) for level in along[0]))


def _image(path: Path, rows: int, cols: int) -> Levels:
    image = grey_of(read_picture(path))
    if image.shape != (rows, cols):
        raise InputError(
            f"{path}: is {image.shape[0]}x{image.shape[1]} pixels, the pattern has {rows}x{cols}"
        )
    return np.asarray(image, np.uint8)
