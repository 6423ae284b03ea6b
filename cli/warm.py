"""For the process from which workers are forked: what the first call of any kernel imports (.4 s)."""

import scipy.linalg
import scipy.ndimage
import scipy.special  # noqa: F401

from optolever.kernels import exact


@exact
def _nothing() -> None:
    """Called once."""


_nothing()
