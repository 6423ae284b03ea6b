"""Decoders of the table: ours, the exact correspondence as a floor, and decoders of others on our frames."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from optolever.decode import Correspondence, Flag, crossed, decode
from optolever.errors import InputError
from optolever.patterns import sequence

from ..peers import cv2_coder, cv2_decode, cv2_places, fringes_coder
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
    (white, black, *images), code = _cv2_frames(shot)
    places = np.full((*white.shape, 2), np.nan)
    lit = np.argwhere(white.astype(np.int16) - black > CV2_BLACK)
    places[tuple(lit.T)] = cv2_places(code, images, lit)
    sigma = np.full(white.shape, 1 / math.sqrt(12))
    flags = np.where(np.isfinite(places[..., 0]), 0, int(Flag.INVALID)).astype(np.uint16)
    return Correspondence(places[..., 0], places[..., 1], sigma, sigma, flags)


def _cv2_clock(shot: Shot) -> Any:
    """What to time."""
    (white, black, *images), code = _cv2_frames(shot)
    return cv2_decode(code, images, white, black)


def _cv2_frames(shot: Shot) -> tuple[Any, Any]:
    taken, shown = shot.taken()
    if shown.frames != sequence("gray", shown.rows, shown.cols).frames:
        raise InputError("cv2: takes the sequence 'gray' only (one-pixel cells, inverses, white and black)")
    if taken.frames.dtype != np.uint8:
        raise InputError("cv2: takes 8-bit frames only")
    return taken.frames, cv2_coder(shown)


DECODERS = {
    "optolever": Decoder("optolever", "own", _ours),
    "exact": Decoder("exact", "floor", lambda shot: exact(shot.place.truth)),
    "fringes": Decoder(
        "fringes", "peer", _fringes, "fringes", clock=lambda shot: _fringes(shot, verbose=False)
    ),
    "cv2": Decoder("cv2", "peer", _cv2, clock=_cv2_clock, divide=2.0),
}
