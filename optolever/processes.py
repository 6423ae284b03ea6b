"""Python programs that this one starts: none of them imports from the working folder."""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

__all__ = ["SAFE_PATH", "environment"]

#: Python does not look for modules in the working folder, as `python -c` does: a struct.py there would run.
SAFE_PATH = {"PYTHONSAFEPATH": "1"}


@contextmanager
def environment(values: Mapping[str, str]) -> Iterator[None]:
    """Programs that are started inside, by whomever, get these variables."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
