"""Where the camera looked at rest, for decoders of a single frame: a map from elsewhere, or a default."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.patterns import Frame, Sequence

from ..correspondence import Correspondence
from ..displacement import Displacement

__all__ = ["PatternMap", "frame_pair", "prior_map"]

F64 = NDArray[np.float64]


class PatternMap(Protocol):
    """u and v (H, W), pattern pixels, of camera pixels at rest: a Correspondence, a trace; NaN: unknown."""

    @property
    def u(self) -> NDArray[Any]: ...
    @property
    def v(self) -> NDArray[Any]: ...


def prior_map(prior: PatternMap | None, sequence: Sequence, shape: tuple[int, ...]) -> tuple[F64, F64]:
    """u and v at rest (H, W), NaN where they are unknown or flagged.

    Without a prior the surface fills the frame, u along columns, v along rows.
    """
    if prior is None:
        row, col = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
        u = (col + 0.5) * sequence.cols / shape[1] - 0.5
        return u, (row + 0.5) * sequence.rows / shape[0] - 0.5
    if isinstance(prior, Displacement):
        raise InputError(f"{sequence.name}: prior is a Displacement; give where the camera looked at rest")
    u, v = np.asarray(prior.u, np.float64), np.asarray(prior.v, np.float64)
    if u.shape != tuple(shape) or v.shape != tuple(shape):
        raise InputError(f"{sequence.name}: prior is {u.shape}, rest is {tuple(shape)}, must be equal")
    if isinstance(prior, Correspondence):
        return np.where(prior.good, u, np.nan), np.where(prior.good, v, np.nan)
    return u, v


def frame_pair(
    now: Any, rest: Any, sequence: Sequence, kind: str
) -> tuple[Frame, NDArray[Any], NDArray[Any]]:
    """The frame of this kind that a sequence describes, and both its images (H, W)."""
    number = next((i for i, frame in enumerate(sequence.frames) if frame.kind == kind), None)
    if number is None:
        raise InputError(f"{kind}: sequence {sequence.name} has no frame of kind {kind!r}")
    images = [_image(stack, sequence, number, name) for stack, name in ((now, "frame"), (rest, "rest"))]
    if images[0].shape != images[1].shape:
        raise InputError(f"{kind}: frame is {images[0].shape}, rest is {images[1].shape}, must be equal")
    return sequence.frames[number], images[0], images[1]


def _image(stack: Any, sequence: Sequence, number: int, name: str) -> NDArray[Any]:
    """One image (H, W) of a stack that the sequence describes, or that image alone."""
    array, kind = np.asarray(stack), sequence.frames[number].kind
    if array.ndim == 3:
        if len(array) != len(sequence):
            raise InputError(f"{kind}: {name} has {len(array)} images, sequence describes {len(sequence)}")
        array = array[number]
    if array.ndim != 2 or min(array.shape) < 16:
        raise InputError(f"{kind}: {name} has shape {array.shape}, must be (H, W), at least 16 x 16")
    if not np.isfinite(array).all():
        raise InputError(f"{kind}: {name} holds values that are not finite")
    return array
