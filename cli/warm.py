"""For the process from which workers are forked: what the first call of any kernel imports (.3 s)."""

import gc
import os
import signal

signal.signal(signal.SIGINT, lambda *_: os._exit(130))  # of Ctrl-C the first process alone says something
gc.disable()  # a seventh of the time of imports, which make no garbage

import scipy.linalg  # noqa: E402
import scipy.special  # noqa: E402, F401

from optolever.kernels import exact  # noqa: E402


@exact
def _nothing() -> None:
    """Called once."""


_nothing()
