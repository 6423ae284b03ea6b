"""Datasets out of other programs' HDF5 files, with errors of one line. Needs h5py (extra `sofast`)."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError

__all__ = ["load_fields"]


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
    try:
        with h5py.File(path, "r") as file:
            present = {name: file[name][()] for name in (*required, *optional) if name in file}
    except (OSError, KeyError, RuntimeError, TypeError) as error:
        raise InputError(f"{path}: not a readable HDF5 file ({error})") from error
    arrays = {}
    for name in required:
        if name not in present:
            raise InputError(f"{path}: field {name!r} is missing")
    for name, value in present.items():
        array = np.asarray(value)
        if array.dtype.kind not in "biuf" or not np.isfinite(array).all():
            raise InputError(f"{path}: field {name!r} is {array.dtype}, must be finite numbers")
        arrays[name] = array
    return arrays
