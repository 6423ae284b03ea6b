"""The pictures of a capture, one per pattern: which files, in which order, and as which levels.

A description names the files, or the pictures of a folder, a pattern, a list or a file of several are taken
in natural order. Faults that need no decoding are reported here: other files in the folder, another number of
pictures, numbers that are missing or start again, copies, colours without contrast, lossy formats.
"""

import glob
import re
from collections import Counter
from collections.abc import Callable, Iterable
from collections.abc import Sequence as Items
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from optolever.arrays import require_room
from optolever.blocks import on_cores
from optolever.errors import InputError
from optolever.notices import Notice
from optolever.patterns import Sequence
from optolever.pictures import (
    CHANNELS,
    PICTURES,
    STACKS,
    colours_of,
    grey_of,
    is_lossy,
    read_picture,
    read_pictures,
)  # fmt: skip
from optolever.scene import Scene, load

from .folder import DESCRIPTION, Description

__all__ = ["Source", "described", "natural_key", "picture_files", "read_frames", "read_scene"]

Item = TypeVar("Item")
Levels = NDArray[np.uint8] | NDArray[np.uint16]
#: A folder, a glob pattern, a file of several pictures, or files.
Source = str | Path | Items[str | Path]

#: Share of the strongest colour's contrast below which a colour carries nothing.
_NOTHING = 0.05
#: Pixels of a picture along a side that colours are compared at.
_SAMPLED = 64
#: Level of the brightest sample of pictures in floating point, where their white is unknown: nothing clips.
_BRIGHTEST = 60000
_NONE = float("nan")
_FRAMES = "frames"
_LOSSY = Notice(
    "pictures compressed with loss (JPEG, video)", _NONE, _NONE, "sigma is larger; keep PNG or TIFF"
)


@dataclass(frozen=True, slots=True, eq=False)
class _Picture:
    """One picture: its file, levels (H, W); if it has colours, red, green, blue (n, 3) of some pixels."""

    file: str
    levels: NDArray[Any]
    colours: NDArray[Any] | None


def described(source: Source, description: str | Path | Sequence | None) -> tuple[Path, Description]:
    """The folder of a source (its first file, of several), and what its pictures show: by a sequence, a file,
    or the folder's own. InputError where there is none."""
    base = Path(source) if isinstance(source, str | Path) else Path(source[0])
    if isinstance(description, Sequence):
        return base, Description(description)
    if description is not None:
        return base, Description.load(Path(description))
    if not base.is_dir():
        one = "is no folder of frames; decode --sequence takes pictures in a file"
        raise InputError(f"{base}: {one if base.exists() else 'no such folder'}")
    if not (base / DESCRIPTION).is_file():
        raise InputError(
            f"{base}: no {DESCRIPTION} says what was shown; put the one there that optolever show wrote, or "
            "say it to optolever decode: --sequence NAME --pixels WIDTHxHEIGHT, or --description FILE"
        )
    return base, Description.load(base / DESCRIPTION)


def read_frames(
    source: Source, shown: Description, channel: str = "luminance", *, own: bool = False
) -> tuple[Levels, int, tuple[Notice, ...]]:
    """The pictures (N, H, W) in the order of showing, (N, H, W, 3) or of a mosaic where they are in colour;
    their bits; remarks on the files.

    source: where the description names no files: names are sorted as people count (img_2 before img_10);
    files that are no pictures are passed over with a notice, hidden ones as well. channel: one of CHANNELS,
    of grey ones. own: the description is the folder's own, and `frames/` must hold no other pictures. Values
    in floating point become 16-bit levels. InputError names the file or the count, its limit and a remedy.
    """
    if channel not in CHANNELS:
        raise InputError(f"channel is {channel!r}, must be one of {', '.join(CHANNELS)}")
    coloured, count = shown.sequence.packing is not None, shown.sequence.exposures
    if shown.files:
        base = Path(source) if isinstance(source, str | Path) else Path(source[0])
        files, named = [base / file for file in shown.files], str(base)
        notices = _others(base, shown.files, own)
    else:
        files, notices = _files(source)
        named = _listed([str(each) for each in source]) if isinstance(source, list | tuple) else str(source)
        if len(files) > 1:
            why = "not named as the other pictures"
            files = _only(files, count, _template, lambda path: path.name, why, notices)
            files = _from_where_numbers_start(files, notices)
    lossy = next(filter(is_lossy, files), None)
    if lossy is not None and coloured:
        why = "is compressed with loss, which mixes the colours of neighbours"
        raise InputError(f"{lossy}: {why}; save PNG or TIFF, or show grey patterns")
    pictures = _of_one_size(_read(files, "" if coloured else channel, bool(shown.files)), count, notices)
    pictures = _without_copies(pictures, count, notices)
    if len(pictures) != count:
        raise InputError(f"{named}: {_other_count(len(pictures), shown.sequence)}{_missing(files)}")
    require_room(f"{named}: {len(pictures)} pictures", 2 * len(pictures) * pictures[0].levels.nbytes)
    notices += _colour_notices(pictures, channel)
    if lossy is not None:
        notices.append(_LOSSY)
    frames = _as_levels(pictures, notices)
    return frames, _bits(frames, shown.bits, pictures), tuple(notices)


def read_scene(base: Path, shown: Description, frames: Levels) -> Scene | None:
    """The scene beside the files that a description names, if there is one; its pattern and camera must be
    those of the capture."""
    path = base / "scene.toml"
    if not (shown.files and path.is_file()):
        return None
    scene = load(path)
    size, pattern = (shown.sequence.rows, shown.sequence.cols), (scene.pattern.rows, scene.pattern.cols)
    if size != pattern:
        raise InputError(f"{path}: pattern is {_size(pattern)}, not {_size(size)} as in {DESCRIPTION}")
    mosaic = shown.sequence.packing is not None and frames.ndim == 3
    taken, camera = frames.shape[1:3], (scene.camera.rows, scene.camera.cols)
    if taken != tuple(size * (1 + mosaic) for size in camera):
        raise InputError(f"{path}: camera is {_size(camera)}, must be {_size(taken)} as the frames")
    return scene


def picture_files(folder: str | Path, description: str | Path | None = None) -> list[str]:
    """Names of a capture's pictures in the order of showing, relative to its folder; none where it is no
    folder."""
    base = Path(folder)
    if not base.is_dir():
        return []
    toml = base / DESCRIPTION if description is None else Path(description)
    named = Description.load(toml).files if toml.is_file() else ()
    return [*named] or [path.name for path in _files(base)[0]]


def _read(files: list[Path], channel: str, single: bool) -> list[_Picture]:
    """All pictures of files, in grey by a channel; single: one of each. InputError as of `read_pictures`."""

    def read(file: Path) -> list[_Picture]:
        stack, found = [read_picture(file)] if single else read_pictures(file), []
        for i, picture in enumerate(stack):
            name, colours = file.name if len(stack) == 1 else f"{file.name}[{i}]", colours_of(picture)
            if not channel:
                found.append(_Picture(name, picture[..., :3] if picture.ndim == 3 else picture, None))
                continue
            rows, cols = (max(1, size // _SAMPLED) for size in picture.shape[:2])
            some = None if colours is None else colours[::rows, ::cols].reshape(-1, 3)
            found.append(_Picture(name, grey_of(picture, channel), some))
        return found

    return [picture for part in on_cores(read, files) for picture in part]


def _bits(frames: Levels, bits: int | None, pictures: list[_Picture]) -> int:
    """Of a description, which the frames must have; else the fewest of 8, 10, 12, 14, 16 that hold them."""
    if bits is None:
        whole = (8,) if frames.dtype == np.uint8 else (10, 12, 14, 16)
        return next(each for each in whole if frames.max() < 2**each)
    expected = np.dtype(np.uint8 if bits == 8 else np.uint16)
    if frames.dtype != expected:
        cure = f"write bits = {8 * frames.dtype.itemsize}, or the camera's, first"
        raise InputError(f"{pictures[0].file}: {frames.dtype} pixels, {bits} bits need {expected}: {cure}")
    if bits < 16 and frames.max() >= 2**bits:
        worst = int(np.argmax(frames.reshape(len(frames), -1).max(axis=1)))
        wrong = f"value {frames[worst].max()}, the limit of {bits} bits is {2**bits - 1}"
        raise InputError(f"{pictures[worst].file}: {wrong}")
    return bits


def _others(base: Path, files: tuple[str, ...], own: bool) -> list[Notice]:
    """`frames/` holds the files of the description; others get a notice, pictures are refused where
    the description is the folder's own."""
    folder = base / _FRAMES
    named = [name for name in files if name.startswith(f"{_FRAMES}/")]
    present = sorted(folder.iterdir()) if named and folder.is_dir() else []
    extra = [path for path in present if f"{_FRAMES}/{path.name}" not in files]
    for path in extra if own else ():
        if path.suffix.lower() in PICTURES and not path.name.startswith("."):
            raise InputError(f"{path}: not in the description, which has {len(named)} frames")
    return [_passed_over([path.name for path in extra])] if extra else []


def natural_key(name: str) -> list[Any]:
    """By which names are sorted as people count.

    >>> sorted(["img_10.png", "IMG_2.png", "img_1.png"], key=natural_key)
    ['img_1.png', 'IMG_2.png', 'img_10.png']
    """
    return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", name.casefold())]


def _said(name: str, cure: str = "") -> Notice:
    return Notice(name, _NONE, _NONE, cure)


def _files(source: Source) -> tuple[list[Path], list[Notice]]:
    """Files of pictures in natural order."""
    if not isinstance(source, str | Path):
        if len(source) != 1:
            return _pictures_among([Path(each) for each in source], "list", "list")
        source = source[0]
    base = Path(source)
    if base.is_dir():
        return _pictures_among([path for path in base.iterdir() if path.is_file()], str(source), "folder")
    if base.is_file():
        if base.suffix.lower() not in STACKS:
            raise InputError(
                f"{source}: one picture, must be a folder, a pattern such as 'shots/*.png', or a file of "
                f"several pictures ({', '.join(STACKS)})"
            )
        return [base], []
    if glob.has_magic(str(source)):
        folder = Path(glob.escape(str(base.parent)) if base.parent.is_dir() else base.parent)
        found = [Path(name) for name in glob.glob(str(folder / base.name)) if Path(name).is_file()]
        return _pictures_among(found, str(source), "pattern")
    raise InputError(f"{source}: no such file or folder")


def _pictures_among(present: list[Path], source: str, what: str) -> tuple[list[Path], list[Notice]]:
    """Pictures in natural order, and a notice of other files."""
    known = {*PICTURES, *STACKS}
    files = [path for path in present if path.suffix.lower() in known and not path.name.startswith(".")]
    others = sorted((path.name for path in set(present) - set(files)), key=natural_key)
    foreign = [name for name in others if name not in (DESCRIPTION, "sequence.toml")]
    if not files:
        inside = f"; it holds {_listed(others)}" if others else ""
        raise InputError(f"{source}: no pictures in this {what} ({', '.join(PICTURES)}){inside}")
    notices = [_passed_over(foreign)] if foreign else []
    return sorted(files, key=lambda path: natural_key(str(path))), notices


def _passed_over(names: Items[str]) -> Notice:
    """That files are no pictures."""
    return _said(f"{_listed(names)}: no pictures, passed over")


def _listed(names: Items[str], most: int = 3) -> str:
    """Some names, and how many more."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _template(path: Path) -> str:
    return re.sub(r"\d+", "#", path.name.casefold())


def _only(
    items: list[Item], count: int, kind: Callable[[Item], Any], name: Callable[[Item], str], why: str,
    notices: list[Notice],
) -> list[Item]:  # fmt: skip
    """Of too many items those of one kind, if they alone are `count`, and a notice of the others."""
    kinds = Counter(map(kind, items))
    fitting = [each for each, number in kinds.items() if number == count]
    if len(items) <= count or len(fitting) != 1:
        return items
    others = [name(item) for item in items if kind(item) != fitting[0]]
    notices.append(_said(f"{_listed(others)}: {why}, passed over"))
    return [item for item in items if kind(item) == fitting[0]]


def _of_one_size(pictures: list[_Picture], count: int, notices: list[Notice]) -> list[_Picture]:
    """Pictures of one size and type. InputError names one that differs from most."""

    def kind(picture: _Picture) -> tuple[Any, ...]:
        return *picture.levels.shape, picture.levels.dtype.name

    why = "of another size or type"
    chosen = _only(pictures, count, kind, lambda picture: picture.file, why, notices)
    usual = Counter(map(kind, chosen)).most_common(1)[0][0]
    for picture in chosen:
        if kind(picture) != usual:
            own, most = ("{}x{} of {}".format(*each) for each in (kind(picture), usual))
            raise InputError(
                f"{picture.file}: {own}, must be {most} as most of the pictures; name those by a pattern, "
                "such as 'shots/img_*.png'"
            )
    return chosen


def _without_copies(pictures: list[_Picture], count: int, notices: list[Notice]) -> list[_Picture]:
    """Of too many pictures all that do not repeat the one before to the last bit, if they alone are
    `count`: no camera takes one twice."""
    if len(pictures) <= count:
        return pictures
    levels = [picture.levels for picture in pictures]
    copies = [i for i in range(1, len(levels)) if np.array_equal(levels[i], levels[i - 1])]
    if len(pictures) - len(copies) != count:
        return pictures
    names = [pictures[i].file for i in copies]
    notices.append(_said(f"{_listed(names)}: the same as the picture before, passed over"))
    return [picture for i, picture in enumerate(pictures) if i not in copies]


def _numbers(files: Iterable[Path]) -> list[int]:
    """The number in which the names differ, of each; none if more than one does, or the rest differs."""
    parts = [re.split(r"(\d+)", path.name.casefold()) for path in files]
    if len({len(each) for each in parts}) != 1:
        return []
    varying = [place for place, values in enumerate(zip(*parts, strict=True)) if len(set(values)) > 1]
    if len(varying) != 1 or varying[0] % 2 == 0:
        return []
    return [int(each[varying[0]]) for each in parts]


def _from_where_numbers_start(files: list[Path], notices: list[Notice]) -> list[Path]:
    """In order of taking where a camera's counter passed 9999 and began again: one gap, up to nines."""
    numbers = _numbers(files)
    gaps = [i for i in range(1, len(numbers)) if numbers[i] != numbers[i - 1] + 1]
    if len(gaps) != 1 or numbers[0] > 1 or not re.fullmatch("9+", str(numbers[-1])):
        return files
    first = gaps[0]
    text = f"{files[first].name} is taken for the first: the counter passed {numbers[-1]} and began again"
    notices.append(_said(text, "name the pictures in order where that is wrong"))
    return files[first:] + files[:first]


def _missing(files: list[Path]) -> str:
    """Numbers between the first and the last that no name has, as a sentence."""
    numbers = _numbers(files)
    steps = np.diff(numbers) if len(numbers) > 2 else np.zeros(0, np.int64)
    usual = int(np.median(steps)) if len(steps) else 0
    if usual < 1:
        return ""
    gone = [n for n in range(numbers[0], numbers[-1], usual) if n not in numbers]
    if not 0 < len(gone) <= len(numbers) // 2:
        return ""
    return f"; no picture has the number {_listed([str(n) for n in gone])}"


def _other_count(found: int, shown: Sequence) -> str:
    """The mismatch of a number of pictures, and a remedy."""
    count, what = shown.exposures, "frames" if shown.packing is None else "exposures"
    text = f"{found} pictures, {shown.name} on a display of {shown.cols}x{shown.rows} has {count} {what}"
    if found % count == 0:
        times = found // count
        return f"{text}: {times} times as many; keep one picture of each pattern, of one exposure"
    what = f"{abs(found - count)} {'lost' if found < count else 'too many'}"
    what += ", or another sequence or size of the display"
    return f"{text}: {what}; name the pictures by a pattern, such as 'shots/img_*.png'"


def _colour_notices(pictures: list[_Picture], channel: str) -> list[Notice]:
    """How much red, green and blue vary from picture to picture, if they differ. InputError if the channel
    that is asked for carries nothing."""
    coloured = [picture.colours for picture in pictures if picture.colours is not None]
    if not coloured:
        return []
    values = np.stack([each for each in coloured if each.shape == coloured[0].shape]).astype(np.float64)
    contrast = dict(zip(CHANNELS[:3], np.quantile(np.ptp(values, axis=0), 0.9, axis=0).tolist(), strict=True))
    best = max(contrast, key=contrast.__getitem__)
    empty = [name for name, size in contrast.items() if size < _NOTHING * contrast[best]]
    told = ", ".join(f"{name} {size:.3g}" for name, size in contrast.items())
    if channel in empty:
        raise InputError(
            f"decode --channel {channel}: carries nothing (contrast in levels: {told}); take --channel {best}"
        )
    if channel != CHANNELS[3]:
        return []
    cure = (
        f"{' and '.join(empty)} carry nothing, take decode --channel {best}"
        if empty
        else "decode --channel takes one of them"
    )
    return [_said(f"pictures in colour, luminance is taken (contrast in levels: {told})", cure)]


def _as_levels(pictures: list[_Picture], notices: list[Notice]) -> Levels:
    """Pictures as uint8 or uint16 (N, H, W)."""
    stack = np.stack([picture.levels for picture in pictures])
    if stack.dtype in (np.uint8, np.uint16):
        return stack
    finite = np.isfinite(stack)
    if not finite.any():
        raise InputError(f"{pictures[0].file}: no value is finite, must be light")
    least, most = float(stack[finite].min()), float(stack[finite].max())
    if not finite.all():
        whole = finite.all(axis=0)
        lost = f"{np.count_nonzero(~whole)} pixels are not finite in some picture"
        notices.append(_said(lost, "they are taken as dark"))
        stack = np.where(whole, stack, least)
    if stack.dtype.kind in "iu" and least >= 0 and most < 65536:
        return stack.astype(np.uint16)
    low = min(least, 0.0)
    scale = 65535.0 if low == 0 and 0 < most <= 1 else _BRIGHTEST / max(most - low, np.finfo(np.float64).tiny)
    return np.rint((stack.astype(np.float64) - low) * scale).astype(np.uint16)


def _size(size: tuple[int, ...]) -> str:
    return f"{size[0]}x{size[1]}"
