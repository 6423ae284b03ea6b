"""The record itself: built from seven arrays, saved, loaded, refused."""

from pathlib import Path

import numpy as np
import pytest

from optolever import InputError
from optolever.decode import Correspondence


def record() -> Correspondence:
    rng = np.random.default_rng(0)
    maps = rng.normal(size=(6, 5, 7))
    return Correspondence(*maps[:4], np.arange(35, dtype=np.uint16).reshape(5, 7), *maps[4:])


def test_comes_back(tmp_path: Path) -> None:
    record().save(tmp_path / "c.npz")
    loaded = Correspondence.load(tmp_path / "c.npz")
    for name in ("u", "v", "sigma_u", "sigma_v", "flags", "amplitude", "offset"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(record(), name))
    assert loaded.order_error is None
    assert loaded.good.sum() == 1


def test_missing_field_and_file_are_named(tmp_path: Path) -> None:
    np.savez(tmp_path / "c.npz", u=np.zeros((2, 2)))
    with pytest.raises(InputError, match=r"c\.npz: field 'v' is missing"):
        Correspondence.load(tmp_path / "c.npz")
    with pytest.raises(InputError, match="no such file"):
        Correspondence.load(tmp_path / "d.npz")


def test_shapes_and_types_are_checked() -> None:
    flat = np.zeros((3, 4))
    with pytest.raises(InputError, match="sigma_u has shape"):
        Correspondence(flat, flat, flat[:2], flat, flat.astype(np.uint16))
    with pytest.raises(InputError, match="flags is float64"):
        Correspondence(flat, flat, flat, flat, flat)
