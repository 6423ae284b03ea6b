"""Python programs that this one starts: none of them imports from the working folder."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["safe_path"]

_VARIABLE = "PYTHONSAFEPATH"


@contextmanager
def safe_path() -> Iterator[None]:
    """Python that is started inside, by whomever, does not look for modules in the working folder.

    `python -c` does: a struct.py that lies there would be run.
    """
    before = os.environ.get(_VARIABLE)
    os.environ[_VARIABLE] = "1"
    try:
        yield
    finally:
        if before is None:
            os.environ.pop(_VARIABLE, None)
        else:
            os.environ[_VARIABLE] = before
