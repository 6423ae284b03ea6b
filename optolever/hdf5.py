"""Datasets out of other programs' HDF5 files, with errors of one line. Needs h5py (extra `sofast`)."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.memory import require_room

__all__ = ["load_fields"]

#: What deflate makes of zeros at most: https://zlib.net/zlib_tech.html
_DEFLATE = 1032


def load_fields(
    path: str | Path, required: Sequence[str], optional: Sequence[str] = ()
) -> dict[str, NDArray[Any]]:
    """Numeric datasets by their full names. InputError names the file and the field that cannot be had."""
    try:
        import h5py
    except ModuleNotFoundError as error:
        raise InputError(f"{path}: HDF5 needs h5py; pip install 'optolever[sofast]'") from error
    if not Path(path).is_file():
        raise InputError(f"{path}: no such file")
    names = [*required, *optional]
    try:
        with h5py.File(path, "r") as file:
            arrays = {
                name: _read(file[name], name, Path(path).stat().st_size) for name in names if name in file
            }
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except (OSError, KeyError, RuntimeError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{path}: not a readable HDF5 file ({error})") from error
    for name in required:
        if name not in arrays:
            raise InputError(f"{path}: field {name!r} is missing")
    return arrays


def _read(dataset: Any, name: str, file_size: int) -> NDArray[Any]:
    """A dataset, unless it claims more than its file can hold."""
    shape, dtype = getattr(dataset, "shape", None), getattr(dataset, "dtype", None)
    if shape is None or dtype is None or dtype.kind not in "biuf":
        raise InputError(f"field {name!r} is {dtype or 'no dataset'}, must be finite numbers")
    size = math.prod(shape) * dtype.itemsize
    if size > _DEFLATE * file_size:
        raise InputError(f"field {name!r} claims {size} bytes, the file has {file_size}")
    require_room(f"field {name!r}", size)
    array = np.asarray(dataset[()])
    if not np.isfinite(array).all():
        raise InputError(f"field {name!r} is not finite, must be finite numbers")
    return array
