"""Compiled kernels on disk: those of the sources as they are now, and of the latest few before."""

import os
from pathlib import Path

import pytest

from optolever.kernels import cache_folder


def test_caches_of_old_sources_go(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each edit of a part makes a new cache of tens of megabytes: 751 MB were seen in a checkout."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    part = tmp_path / "part"
    part.mkdir()
    old = [part / "__pycache__" / f"kernels-{k:016x}" for k in range(8)]
    for k, folder in enumerate(old):
        folder.mkdir(parents=True)
        os.utime(folder, (1e9 + k, 1e9 + k))
    (part / "__pycache__" / "module.pyc").touch()
    cache_folder.cache_clear()
    found = cache_folder(part)
    assert found is not None
    assert found.is_dir()
    assert [one.is_dir() for one in old] == [False] * 5 + [True] * 3
    assert (part / "__pycache__" / "module.pyc").is_file()
