"""The one place where outputs are opened: whole or absent (written beside, then renamed); array records as
.npz.
"""

import csv
import errno
import io
import json
import math
import os
import secrets
import shutil
import stat
import tempfile
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from optolever.arrays import require_room
from optolever.errors import InputError, damage_of, reason_of, require_file

__all__ = [
    "MARK", "aside", "atomic_file", "atomic_folder", "growing_file", "latest", "load_arrays", "plain", "put",
    "read_lines", "require_folder", "require_new_folder", "require_writable", "save_arrays", "stamps",
    "together", "write_csv", "write_json", "write_rows",
]  # fmt: skip

#: In pictures and .npz of this program.
MARK = b"optolever"
_FAILED = "cannot be written"


@dataclass(frozen=True, slots=True)
class _Output:
    """What was asked for, what a link leads to there, and where it is written before it takes that place."""

    asked: Path
    target: Path
    temporary: Path

    def take_place(self) -> None:
        """Become what was asked for. A device or a pipe is written through; a file keeps its mode."""
        with self.blamed():
            if _is_stream(self.target):
                self.target.write_bytes(self.temporary.read_bytes())
                return
            if self.target.is_file():
                self.temporary.chmod(stat.S_IMODE(self.target.stat().st_mode))
            elif self.target.is_dir():
                _fill(self.temporary, self.target)
                return
            self.temporary.replace(self.target)

    def discard(self) -> None:
        """Leave nothing behind."""
        shutil.rmtree(self.temporary, ignore_errors=True)
        with suppress(OSError):
            self.temporary.unlink(missing_ok=True)

    @contextmanager
    def blamed(self) -> Iterator[None]:
        """Failures to write are one line about the file that was asked for, not about where it is written."""
        here, asked = str(self.temporary), str(self.asked)
        try:
            yield
        except InputError as error:
            raise InputError(str(error).replace(here, asked)) from error
        except OSError as error:
            where, reason = str(error.filename or here), reason_of(error)
            if here not in where:
                raise
            reason = reason if reason.startswith(_FAILED) else f"{_FAILED} ({reason})"
            raise OSError(error.errno or errno.EIO, reason, where.replace(here, asked)) from error


_waiting: ContextVar[tuple[list[_Output], ...]] = ContextVar("outputs that wait, block by block", default=())


@contextmanager
def together() -> Iterator[None]:
    """What is written inside takes its place when the block (or the outer one) succeeds: all or nothing."""
    outputs: list[_Output] = []
    outer = _waiting.get()
    before = _waiting.set((*outer, outputs))
    try:
        yield
        if outer:
            outer[-1].extend(outputs)
            outputs = []
        # renaming does not fail for want of room, writing to a device may: so devices come first
        for output in sorted(outputs, key=lambda output: not _is_stream(output.target)):
            output.take_place()
    finally:
        _waiting.reset(before)
        for output in outputs:
            output.discard()


@contextmanager
def _placed(output: _Output, make: Callable[[Path], None]) -> Iterator[Path]:
    """Yield where to write; at the end the output takes its place, or waits for the others of `together`."""
    waiting = _waiting.get()
    before = _waiting.set(())  # what is written into a folder is in its place at once
    try:
        with output.blamed():
            make(output.temporary)
            yield output.temporary
        if waiting:
            waiting[-1].append(output)
        else:
            output.take_place()
    finally:
        _waiting.reset(before)
        if not waiting or output not in waiting[-1]:
            output.discard()


def latest(path: str | Path) -> Path:
    """Where a file's newest content lies: beside it while it waits for others of `together`."""
    target = _target(Path(path))
    waiting = (output for outputs in _waiting.get() for output in outputs)
    return ([Path(path)] + [output.temporary for output in waiting if output.target == target])[-1]


def atomic_file(path: str | Path) -> AbstractContextManager[Path]:
    """Yield a path (same suffix) to write to; `path` becomes what it holds only if the block succeeds.

    Of a link the target is replaced; a device or a pipe is written through; a file keeps its mode.
    InputError where it may not be written; OSError of `path` where that fails, as on a full disk.
    """
    asked = Path(path)
    require_writable(asked)
    target = _target(asked)
    folder = Path(tempfile.gettempdir()) if _is_stream(target) else target.parent
    output = _Output(asked, target, folder / f".{secrets.token_hex(8)}{target.suffix}")
    mode = 0o600 if target.exists() else 0o666
    return _placed(output, lambda temporary: temporary.touch(mode, exist_ok=False))


def atomic_folder(path: str | Path) -> AbstractContextManager[Path]:
    """Yield a folder beside `path` that becomes `path` if the block succeeds; `path` must hold no files.
    Errors as of atomic_file.
    """
    asked, target = Path(path), _target(Path(path))
    require_new_folder(asked)
    _require_parent(asked, target)
    output = _Output(asked, target, target.parent / f".{target.name}.{secrets.token_hex(8)}")
    return _placed(output, Path.mkdir)


def growing_file(path: str | Path, mode: str = "w") -> IO[Any]:
    """A file, open, that grows as its content comes: a killed process leaves the flushed part. InputError
    where it cannot be opened."""
    require_writable(path)
    if Path(path).is_file():  # as a new file: other names of the old one, hard links, keep its content
        with atomic_file(path):
            pass
    try:
        return Path(path).open(mode, encoding=None if "b" in mode else "utf-8")
    except OSError as error:
        raise InputError(f"{path}: {reason_of(error)}") from error


def stamps(path: Path) -> dict[str, list[int]]:
    """Size and time, ns, of a file, or of all files of a folder by their names in it; of nothing: none."""
    files = (
        [each for each in path.rglob("*") if each.is_symlink() or not each.is_dir()] if path.is_dir() else []
    )
    about = {str(each.relative_to(path)): each.lstat() for each in files} if path.is_dir() else {}
    about |= {"": path.stat()} if path.is_file() else {}
    return {name: [each.st_size, each.st_mtime_ns] for name, each in sorted(about.items())}


def aside(path: Path) -> Path:
    """Rename what lies there to NAME.aside1, or the first number that is free; that name, of nothing, too."""
    names = (path.with_name(f"{path.name}.aside{number}") for number in count(1))
    other = next(each for each in names if not os.path.lexists(each))
    if os.path.lexists(path):
        path.rename(other)
    return other


def put(new: Path, target: Path, older: Mapping[str, Any]) -> None:
    """Rename a file or a folder to its place; an empty folder there is filled. What lies there is set aside,
    and deleted once the new one is there if its `stamps` are these."""
    if target.is_dir() and not any(target.iterdir()):
        _fill(new, target)
        return
    before = aside(target)
    new.rename(target)
    if os.path.lexists(before) and stamps(before) == older:
        shutil.rmtree(before) if before.is_dir() and not before.is_symlink() else before.unlink()


def _fill(new: Path, target: Path) -> None:
    """Move the content of a folder into an empty one, folders first: the files describe them."""
    require_new_folder(target)
    for each in sorted(new.iterdir(), key=Path.is_file):
        shutil.move(each, target / each.name)  # a link may lead to another disk
    new.rmdir()


def require_writable(path: str | Path) -> None:
    """InputError unless a file can be written there: for before the work, not after."""
    asked = Path(path)
    if asked.is_dir():
        raise InputError(f"{asked}: is a folder, a file is to be written here")
    if asked.exists():
        _require_permission(asked, asked)
    target = _target(asked)
    if not _is_stream(target):
        _require_parent(asked, target)


def require_new_folder(folder: Path) -> None:
    """InputError unless it is absent or empty."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder}: exists and is no empty folder; nothing is written over, name another")


def require_folder(path: str | Path, *files: str) -> None:
    """InputError unless such files can be written into a folder, which may be absent."""
    folder = Path(path)
    there = next(each for each in (folder, *folder.absolute().parents) if each.exists() or each.is_symlink())
    if not there.is_dir():
        raise InputError(f"{there}: is a file, a folder is to be made here")
    _require_permission(there, folder)
    for name in files if there == folder else ():
        require_writable(folder / name)


def save_arrays(path: str | Path, arrays: Mapping[str, Any], compressed: bool = False) -> None:
    """Write arrays as an .npz; None values are left out. compressed: by zlib's fastest level."""
    method = zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED
    with atomic_file(path) as temporary, zipfile.ZipFile(temporary, "w", method, compresslevel=1) as archive:
        archive.comment = MARK
        for name, value in arrays.items():
            if value is not None:
                with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:
                    np.lib.format.write_array(stream, np.asarray(value), allow_pickle=False)


#: A record's file by a field that it alone has.
_KINDS = {
    "u": "a correspondence, by `optolever decode`",
    "slope_x": "a slope map, by `reconstruct --slopes`",
    "diagnostics": "a height map, by `optolever reconstruct`",
    "z": "a surface",
}


def load_arrays(
    path: str | Path,
    required: Sequence[str],
    texts: Sequence[str] = ("notices", "diagnostics"),
    scalars: Sequence[str] = (),
) -> dict[str, NDArray[Any]]:
    """Read an .npz. InputError if the file is missing or unreadable, lacks a required field, holds other than
    real numbers in a field that is not one of `texts`, more than one in one of `scalars`, or more than fits
    in memory: by the headers of the fields, before any is unpacked.
    """
    newest = latest(path)
    require_file(newest)
    try:
        with zipfile.ZipFile(newest) as archive:
            members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            missing = [name for name in required if name not in members]
            if missing:
                kind = next((f"; it is {text}" for name, text in _KINDS.items() if name in members), "")
                raise InputError(f"field {missing[0]!r} is missing (has {', '.join(sorted(members))}){kind}")
            for name, info in members.items():
                with archive.open(info) as stream:
                    _require_field(name, stream, info.file_size, name in texts, name in scalars)
            require_room(f"{len(members)} fields", sum(info.file_size for info in members.values()))
        with np.load(newest, allow_pickle=False) as archived:
            return {name: np.asarray(archived[name]) for name in members}
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except Exception as error:  # a damaged file: unknown methods, encryption, lies
        raise InputError(
            f"{path}: not a readable .npz ({damage_of(error)}); give a file that optolever wrote"
        ) from error


def _require_field(name: str, stream: IO[bytes], size: int, text: bool, scalar: bool) -> None:
    """InputError unless the header of an array of `size` bytes says as many, of the right kind and shape."""
    read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    shape, _, dtype = read[np.lib.format.read_magic(stream)](stream)
    if dtype.kind not in ("U" if text else "biuf"):
        raise InputError(f"field {name!r} is {dtype}, must be {'text' if text else 'real numbers'}")
    if scalar and shape != ():
        raise InputError(f"field {name!r} has shape {shape}, must be ()")
    if stream.tell() + dtype.itemsize * math.prod(shape) != size:
        raise InputError(f"field {name!r} is {dtype} of shape {shape}, not the {size} bytes that are there")


def read_lines(path: Path, is_whole: Callable[[Any], bool]) -> list[dict[str, Any]]:
    """The lines of a log, JSON each. A broken last line, of a process that was killed, is left out;
    InputError names any other that is damaged, by `is_whole` too (KeyError, AttributeError: it is not)."""
    try:
        texts = path.read_bytes().rstrip(b"\n").split(b"\n")
    except OSError as error:
        raise InputError(f"{path}: not readable ({error.strerror})") from error
    lines: list[dict[str, Any]] = []
    for number, text in enumerate(texts, 1):
        try:
            line = json.loads(text.decode("ascii"))
            whole = is_whole(line)
        except (ValueError, KeyError, AttributeError, TypeError, RecursionError):
            whole = False
        if whole:
            lines.append(line)
        elif number < len(texts):
            raise InputError(f"{path}: line {number} is damaged, {len(texts) - number} lines follow")
    return lines


def write_json(path: str | Path, values: Mapping[str, Any]) -> None:
    """Write a record as JSON, whole or not at all; NaN and infinities become null."""
    with atomic_file(path) as temporary:
        temporary.write_text(json.dumps(plain(values), indent=2, allow_nan=False) + "\n", encoding="utf-8")


def write_csv(path: str | Path, values: Mapping[str, Any]) -> None:
    """Write a record as lines `figure,value`, whole or not at all; the names of nested records are joined by
    points, entries of lists are counted from 0, NaN and infinities are empty.
    """
    write_rows(path, ("figure", "value"), _flat("", plain(values)))


def write_rows(path: str | Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write a table as CSV, whole or not at all."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    with atomic_file(path) as temporary:
        temporary.write_text(text.getvalue(), encoding="utf-8")


def _flat(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Every number and text of a record, by its full name."""
    if isinstance(value, Mapping | list):
        for key, item in value.items() if isinstance(value, Mapping) else enumerate(value):
            yield from _flat(f"{name}.{key}" if name else str(key), item)
    else:
        yield name, value


def plain(value: Any) -> Any:
    """The value by what JSON has: lists, no NaN or infinities."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value


def _require_parent(asked: Path, target: Path) -> None:
    parent = target.parent
    if not parent.is_dir():
        raise InputError(f"{asked}: folder {parent} does not exist")
    _require_permission(parent, asked)


def _require_permission(path: Path, asked: Path) -> None:
    """InputError unless this process may write there, and unless nobody may, root neither."""
    mode = path.stat().st_mode
    if not (mode & 0o222 and os.access(path, os.W_OK)):
        what = "" if path == asked else f"folder {path}: "
        raise InputError(f"{asked}: {what}no permission to write (mode {stat.S_IMODE(mode):04o})")


def _target(asked: Path) -> Path:
    """What a link leads to; a device stays as it was asked for (those in /proc lead to no name)."""
    return asked if _is_stream(asked) else Path(os.path.realpath(asked))


def _is_stream(path: Path) -> bool:
    """Whether it is a device or a pipe, which is written through and never replaced."""
    return path.exists() and not path.is_dir() and not path.is_file()
