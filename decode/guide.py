"""Where the camera looked at rest, for decoders that follow one frame: a map from elsewhere, or a default."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.patterns import Sequence

__all__ = ["PatternMap", "guide_map"]

F64 = NDArray[np.float64]


class PatternMap(Protocol):
    """Anything that tells where camera pixels look on the pattern: a Correspondence, a trace."""

    @property
    def u(self) -> NDArray[Any]: ...
    @property
    def v(self) -> NDArray[Any]: ...


def guide_map(
    guide: PatternMap | None, sequence: Sequence, shape: tuple[int, ...], where: str
) -> tuple[F64, F64]:
    """u and v at rest (H, W); without a guide the surface fills the frame, u along columns, v along rows."""
    if guide is None:
        row, col = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
        u = (col + 0.5) * sequence.cols / shape[1] - 0.5
        return u, (row + 0.5) * sequence.rows / shape[0] - 0.5
    u, v = np.asarray(guide.u, np.float64), np.asarray(guide.v, np.float64)
    if u.shape != tuple(shape) or v.shape != tuple(shape):
        raise InputError(f"{where}: guide is {u.shape}, rest is {tuple(shape)}, must be equal")
    return u, v
