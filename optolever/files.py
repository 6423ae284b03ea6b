"""Files that are whole or absent (written beside, then renamed), and array records as .npz."""

import os
import shutil
import tempfile
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError

__all__ = ["atomic_file", "atomic_folder", "load_arrays", "save_arrays"]


@contextmanager
def atomic_file(path: str | Path) -> Iterator[Path]:
    """Yield a path beside `path` (same suffix) to write to; it replaces `path` only if the block succeeds."""
    target = Path(path)
    _require_parent(target)
    handle, name = tempfile.mkstemp(prefix=".", suffix=target.suffix, dir=target.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        temporary.chmod(0o666 & ~_umask())
        temporary.replace(target)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def atomic_folder(path: str | Path) -> Iterator[Path]:
    """Yield a folder beside `path` that becomes `path` if the block succeeds; `path` must hold no files."""
    target = Path(path)
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise InputError(f"{target}: exists and is no empty folder; nothing is written over, name another")
    _require_parent(target)
    temporary = Path(tempfile.mkdtemp(prefix=f".{target.name}.", dir=target.parent))
    try:
        yield temporary
        temporary.chmod(0o777 & ~_umask())
        if target.exists():
            target.rmdir()
        temporary.replace(target)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def save_arrays(path: str | Path, arrays: Mapping[str, Any]) -> None:
    """Write arrays as an uncompressed .npz; None values are left out."""
    with atomic_file(path) as temporary, temporary.open("wb") as stream:
        present = {name: np.asarray(value) for name, value in arrays.items() if value is not None}
        np.savez(stream, allow_pickle=False, **present)


def load_arrays(path: str | Path, required: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Read an .npz. InputError if the file is missing, unreadable or lacks a required field."""
    if not Path(path).is_file():
        raise InputError(f"{path}: no such file")
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile, AttributeError, TypeError) as error:
        raise InputError(f"{path}: not a readable .npz ({error})") from error
    missing = [name for name in required if name not in arrays]
    if missing:
        raise InputError(f"{path}: field {missing[0]!r} is missing (has {', '.join(sorted(arrays))})")
    return arrays


def _require_parent(target: Path) -> None:
    parent = target.parent
    if not parent.is_dir():
        raise InputError(f"{target}: folder {parent} does not exist")


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
