"""A user's sequences: a Python function, images with a description, a file, a name."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.patterns import Frame, Sequence, sequence_from_text, sequence_names
from optolever.pictures import read_grey
from optolever.toml import read_toml

from .own_function import imported, working_folder
from .own_images import OwnImages

__all__ = ["own_sequence"]

SLACK = 1  # grey levels by which an image may differ from its description


def own_sequence(text: str, rows: int, cols: int, *, resized: bool = False) -> Sequence | OwnImages:
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
        return _part(text, rows, cols)
    if Path(text).is_dir():
        return _from_folder(Path(text), rows, cols)
    return _from_callable(text, rows, cols)


def _part(path: str, rows: int, cols: int) -> Sequence:
    found = Sequence.load(path)
    if found.rows < rows or found.cols < cols:
        raise InputError(
            f"{path}: is for {found.rows}x{found.cols} cells, the resampled surface has {rows}x{cols}; name "
            "a smaller --pixels, or a sequence for more cells"
        )
    return replace(found, rows=rows, cols=cols)


def _from_callable(text: str, rows: int, cols: int) -> Sequence | OwnImages:
    if ":" not in text:
        raise InputError(
            f"pattern {text!r}: is no folder, no .toml, no module:function and no known sequence"
        )
    function = imported(f"pattern {text!r}", text)
    try:
        with working_folder():
            found = function(rows, cols)
    except Exception as error:  # whatever a user's function raises is a finding about that function
        raise InputError(f"pattern {text!r}: raises {type(error).__name__}: {error}") from error
    shown: Sequence | OwnImages
    if isinstance(found, np.ndarray) and found.dtype == np.uint8 and found.ndim == 3 and len(found):
        size, shown = found.shape[1:], OwnImages(found, text)
    elif isinstance(found, Sequence):
        size, shown = (found.rows, found.cols), found
    else:
        what = type(found).__name__
        raise InputError(
            f"pattern {text!r}: returns {what}, must be a Sequence or uint8 images (N, rows, cols)"
        )
    if size != (rows, cols):
        raise InputError(f"pattern {text!r}: is {size[0]}x{size[1]} cells, must be {rows}x{cols}")
    return shown


def _from_folder(folder: Path, rows: int, cols: int) -> Sequence:
    if (folder / "sequence.toml").is_file():
        return _described(folder, rows, cols)
    path = folder / "coordinates.toml"
    if not path.is_file():
        raise InputError(f"{folder}: holds neither sequence.toml nor coordinates.toml")
    tables = read_toml(path).get("frames")
    if not isinstance(tables, list) or not tables:
        raise InputError(f"{path}: frames is missing, must be at least one [[frames]] table")
    frames = tuple(_frame(path, i, table, rows, cols) for i, table in enumerate(tables))
    return Sequence(frames, rows, cols, folder.name)


def _described(folder: Path, rows: int, cols: int) -> Sequence:
    """The sequence of sequence.toml, after a check of its images."""
    found = sequence_from_text(str(folder / "sequence.toml"), rows, cols)
    for index in range(len(found)):
        path = folder / f"{index:03d}.png"
        image = _image(path, rows, cols)
        if np.abs(image.astype(np.int16) - found.render_frame(index)).max() > SLACK:
            raise InputError(f"{path}: is not the image that sequence.toml describes as frame {index}")
    return found


def _frame(path: Path, index: int, table: Any, rows: int, cols: int) -> Frame:
    where = f"{path}: frames[{index}]"
    if not isinstance(table, dict) or set(table) - {"file", "axis"}:
        raise InputError(f"{where}: is {table!r:.60}, must hold file and axis")
    axis, name = table.get("axis"), table.get("file")
    if axis not in ("u", "v", None) or not isinstance(name, str):
        raise InputError(f"{where}: file {name!r} and axis {axis!r}, must be text and 'u' or 'v'")
    image = _image(path.parent / name, rows, cols)
    if axis is None:
        level = int(image.flat[0])
        if np.ptp(image) > SLACK:
            raise InputError(f"{where}: {name} varies, axis must say along what")
        return {255: Frame("white"), 0: Frame("black")}.get(level, Frame("uniform", level=level))
    along = image if axis == "u" else image.T
    if np.ptp(along, axis=0).max() > SLACK:
        raise InputError(f"{where}: {name} varies across {axis} too, must vary along it alone")
    return Frame("levels", axis, levels=tuple(int(level) for level in along[0]))


def _image(path: Path, rows: int, cols: int) -> NDArray[np.uint8]:
    image = read_grey(path)
    if image.shape != (rows, cols):
        raise InputError(
            f"{path}: is {image.shape[0]}x{image.shape[1]} pixels, the pattern has {rows}x{cols}"
        )
    return np.asarray(image, np.uint8)
