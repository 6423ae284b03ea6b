"""Decoders of the table: ours, the exact correspondence as a floor, and decoders of others on our frames.

`fringes` (GPL) is run, never copied; OpenCV's structured_light comes with OpenCV's contrib modules.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from optolever.decode import Correspondence, Flag, crossed, decode
from optolever.errors import InputError
from optolever.patterns import sequence

from ..fringes_coder import fringes_coder
from ..place import exact
from .shot import Rest, Shot

__all__ = ["DECODERS", "Decoder", "decoder"]

FRINGES_MODULATION = 5.0  # levels, the least amplitude that `fringes` is told to take
CV2_BLACK = 40  # levels between white and black, OpenCV's own default for what is lit


@dataclass(frozen=True, slots=True)
class Decoder:
    """A way from frames to correspondence. kind: own | floor | peer; module: what must be installed;
    clock: what to time in place of `run` and by how much to divide it, where `run` does more than the
    peer's user would.
    """

    name: str
    kind: str
    run: Callable[[Shot], Correspondence]
    module: str | None = None
    clock: Callable[[Shot], Any] | None = None
    divide: float = 1.0


def decoder(name: str) -> Decoder:
    """The decoder of this name; InputError if there is none."""
    try:
        return DECODERS[name]
    except KeyError as error:
        raise InputError(f"decoder {name!r}: unknown, must be one of {', '.join(DECODERS)}") from error


def _ours(shot: Shot) -> Correspondence:
    taken, shown = shot.taken()
    return decode(taken.frames, shown) if shot.rest is None else _single(shot, shot.rest)


def _single(shot: Shot, rest: Rest) -> Correspondence:
    """One frame: displacement from the frame at rest, added to where the pixels looked then."""
    taken, shown = shot.taken()
    return crossed(taken.frames, rest.capture.frames, shown, prior=rest.seen).added_to(rest.seen)


def _fringes(shot: Shot, verbose: bool = True) -> Any:
    """`fringes` on a sequence of N-step phase frames, the same periods and steps on u and v."""
    taken, shown = shot.taken()
    found = fringes_coder(shown).decode(taken.frames[..., None], bmin=FRINGES_MODULATION, verbose=verbose)
    if not verbose:
        return found
    coordinates = np.asarray(found.x, dtype=np.float64)[..., 0]
    sigma = np.broadcast_to(np.asarray(found.u, dtype=np.float64)[..., 0], coordinates.shape)
    bad = ~np.isfinite(coordinates).all(axis=0) | ~(np.isfinite(sigma) & (sigma > 0)).all(axis=0)
    flags = np.where(bad, int(Flag.INVALID), 0).astype(np.uint16)
    sigma = np.where(bad, 1.0, sigma)
    return Correspondence(coordinates[0], coordinates[1], sigma[0], sigma[1], flags)


def _cv2(shot: Shot) -> Correspondence:
    """OpenCV's GrayCodePattern, pixel by pixel; it states no sigma: that of a uniform error of one pixel."""
    frames, code = _cv2_frames(shot)
    rows, cols = frames.shape[1:]
    images = list(frames[2:])
    lit = frames[0].astype(np.int16) - frames[1] > CV2_BLACK
    u, v = np.full((rows, cols), np.nan), np.full((rows, cols), np.nan)
    for row, col in np.argwhere(lit):
        wrong, pixel = code.getProjPixel(images, int(col), int(row))
        if not wrong:
            u[row, col], v[row, col] = pixel
    sigma = np.full((rows, cols), 1 / math.sqrt(12))
    flags = np.where(np.isfinite(u), 0, int(Flag.INVALID)).astype(np.uint16)
    return Correspondence(u, v, sigma, sigma, flags)


def _cv2_clock(shot: Shot) -> Any:
    """OpenCV's own loop over all pixels, which wants two cameras: it is given the same one twice."""
    frames, code = _cv2_frames(shot)
    images = list(frames[2:])
    return code.decode([images, images], None, [frames[1]] * 2, [frames[0]] * 2)


def _cv2_frames(shot: Shot) -> tuple[Any, Any]:
    taken, shown = shot.taken()
    if shown.frames != sequence("gray", shown.rows, shown.cols).frames:
        raise InputError("cv2: takes the sequence 'gray' only (one-pixel cells, inverses, white and black)")
    if taken.frames.dtype != np.uint8:
        raise InputError("cv2: takes 8-bit frames only")
    code = cv2.structured_light.GrayCodePattern.create(shown.cols, shown.rows)
    return taken.frames, code


DECODERS = {
    "optolever": Decoder("optolever", "own", _ours),
    "exact": Decoder("exact", "floor", lambda shot: exact(shot.place.truth)),
    "fringes": Decoder(
        "fringes", "peer", _fringes, "fringes", clock=lambda shot: _fringes(shot, verbose=False)
    ),
    "cv2": Decoder("cv2", "peer", _cv2, clock=_cv2_clock, divide=2.0),
}
