"""Python programs that this one starts: none of them imports from the working folder."""

import os
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager

__all__ = ["environment", "safe_path"]


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


def safe_path() -> AbstractContextManager[None]:
    """Python that is started inside does not look for modules in the working folder.

    `python -c` does: a struct.py that lies there would be run.
    """
    return environment({"PYTHONSAFEPATH": "1"})
