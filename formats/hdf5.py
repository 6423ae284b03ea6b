"""Datasets out of other programs' HDF5 files, with errors of one line. Needs h5py (extra `sofast`)."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError, require_file
from optolever.memory import require_room

__all__ = ["load_fields", "names_in"]

#: What deflate makes of zeros at most: https://zlib.net/zlib_tech.html
_DEFLATE = 1032


def load_fields(
    path: str | Path, required: Sequence[str], optional: Sequence[str] = ()
) -> dict[str, NDArray[Any]]:
    """Numeric datasets by their full names. InputError names the file and the field that cannot be had, or
    says that all together claim more than the file can hold or fits in memory: before any is read.
    """
    try:
        import h5py
    except ModuleNotFoundError as error:
        raise InputError(f"{path}: HDF5 needs h5py; pip install 'optolever[sofast]'") from error
    require_file(path)
    names = [*required, *optional]
    try:
        with h5py.File(path, "r") as file:
            missing = [name for name in required if name not in file]
            if missing:
                raise InputError(f"field {missing[0]!r} is missing")
            datasets = {name: file[name] for name in names if name in file}
            if not datasets:
                return {}
            sizes = {name: _claimed_size(dataset, name) for name, dataset in datasets.items()}
            claimed, held = sum(sizes.values()), Path(path).stat().st_size
            what = f"{len(sizes)} fields, the largest {max(sizes, key=sizes.__getitem__)!r}"
            if claimed > _DEFLATE * held:
                raise InputError(f"{what} claim {claimed} bytes, the file has {held}")
            require_room(what, claimed)
            return {name: _read(dataset, name) for name, dataset in datasets.items()}
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except (OSError, KeyError, RuntimeError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{path}: not a readable HDF5 file ({error})") from error


def names_in(path: str | Path, group: str) -> list[str]:
    """Names in a group of a readable file; none if there is no such group."""
    import h5py

    with h5py.File(path, "r") as file:
        return list(file[group]) if isinstance(file.get(group), h5py.Group) else []


def _claimed_size(dataset: Any, name: str) -> int:
    """Bytes of a dataset's array. InputError if it is none of real numbers."""
    shape, dtype = getattr(dataset, "shape", None), getattr(dataset, "dtype", None)
    if shape is None or dtype is None or dtype.kind not in "biuf":
        raise InputError(f"field {name!r} is {dtype or 'no dataset'}, must be finite numbers")
    return int(math.prod(shape) * dtype.itemsize)


def _read(dataset: Any, name: str) -> NDArray[Any]:
    array = np.asarray(dataset[()])
    if not np.isfinite(array).all():
        raise InputError(f"field {name!r} is not finite, must be finite numbers")
    return array
