"""Frames of a mirror and their decoders: this package, the exact correspondence as a floor, and peers on the
same frames (`fringes`, GPL: run, never copied; OpenCV's structured_light, of its contrib modules).

A single shot (crossed fringes) yields the displacement from the mirror at rest. The mirror at rest is first
captured with the same frame, and with a dense sequence for its correspondence.
"""

import importlib
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from optolever.decode import Correspondence, Flag, decode
from optolever.errors import InputError
from optolever.live import crossed
from optolever.patterns import Frame, Sequence, sequence, sequence_from_text
from optolever.scene import Surface, dent

from ..arrays import Floats
from ..faults import frames_of
from ..own_images import OwnDecoder, OwnImages, image_frames, own_decoder
from ..own_sequence import own_sequence
from ..place import Place, exact
from ..timing import timed
from .cell import Cell

AT_REST = "gray+phase:steps=8"
FRINGES_MODULATION = 5.0  # levels, the minimum amplitude given to `fringes`
CV2_BLACK = 40  # levels between white and black, OpenCV's default threshold of illuminated pixels

Images = list[NDArray[np.uint8]]


@dataclass(frozen=True, slots=True)
class Shot:
    """Frames (N, H, W) of a mirror; None for the sequences 'exact' and 'lattice'; rest: for a single shot
    only, its frame and the correspondence of the mirror at rest.
    """

    place: Place
    cell: Cell
    sequence: Sequence | OwnImages | None = None
    frames: NDArray[Any] | None = None
    render_seconds: float = 0.0
    rest: tuple[NDArray[Any], Correspondence] | None = None

    def taken(self) -> tuple[NDArray[Any], Sequence]:
        """The frames and their sequence; InputError without frames, or for a user's images."""
        if self.frames is None or self.sequence is None:
            raise InputError(f"sequence {self.cell.shown!r}: no frames, this decoder needs some")
        if isinstance(self.sequence, OwnImages):
            raise InputError(f"sequence {self.cell.shown!r}: is images, name a decoder: ...@MODULE:FUNCTION")
        return self.frames, self.sequence


def shoot(place: Place, cell: Cell) -> Shot:
    """The cell's frames, with its noise."""
    if cell.shown == "exact":
        return Shot(place, cell)
    pattern = place.scene.pattern
    resized, lag = cell.size is not None, cell.faults.lag
    found = own_sequence(cell.shown, pattern.rows, pattern.cols, resized=resized)
    if isinstance(found, OwnImages):
        images, known = found, (lag, cell.noise, cell.capture_seed, cell.renderer)
        made = timed(lambda: image_frames(place.scene, place.surface, place.truth, images, *known))
        return Shot(place, cell, found, made.value, made.seconds)
    shown = axis_by_axis(found)
    if shown.name == "lattice":
        return Shot(place, cell, shown)

    def taken(surface: Surface, shown: Sequence, offset: int) -> NDArray[Any]:
        seed = cell.capture_seed + offset
        return frames_of(place.scene, surface, shown, lag, cell.noise, seed, cell.renderer)

    own, rest = timed(lambda: taken(place.surface, shown, 0)), None
    if all(frame.kind == "crossed" for frame in shown.frames):
        flat, dense = dent("flat", place.scene), sequence_from_text(AT_REST, shown.rows, shown.cols)
        rest = taken(flat, shown, 2), decode(taken(flat, dense, 1), dense)
    return Shot(place, cell, shown, own.value, own.seconds, rest)


@dataclass(frozen=True, slots=True)
class Decoder:
    """A decoder of frames to a correspondence. kind: own | floor | peer; module: required package; clock:
    function to time in place of `run`, and divide: divisor of its time, where `run` does more than a user of
    the peer would.
    """

    kind: str
    run: Callable[[Shot], Correspondence]
    module: str | None = None
    clock: Callable[[Shot], Any] | None = None
    divide: float = 1.0


def decoder(name: str) -> Decoder:
    """The decoder of this name, or a user's module:function; InputError if there is none."""
    if ":" in name:
        function = own_decoder(name)
        return Decoder("own", lambda shot: _by_user(function, shot))
    try:
        return DECODERS[name]
    except KeyError as error:
        raise InputError(f"decoder {name!r}: unknown, must be one of {', '.join(DECODERS)}") from error


def _ours(shot: Shot) -> Correspondence:
    """By this package. Single shot: displacement from the frame at rest plus the correspondence at rest."""
    frames, shown = shot.taken()
    if shot.rest is None:
        return decode(frames, shown)
    before, seen = shot.rest
    return crossed(frames, before, shown, prior=seen).added_to(seen)


def _by_user(function: OwnDecoder, shot: Shot) -> Correspondence:
    if isinstance(shot.sequence, OwnImages) and shot.frames is not None:
        return function(shot.frames, shot.sequence.levels)
    return function(*shot.taken())


def _fringes(shot: Shot) -> Correspondence:
    """`fringes` on a sequence of N-step phase frames, the same periods and steps on u and v."""
    found = _fringes_run(shot, verbose=True)
    coordinates = np.asarray(found.x, dtype=np.float64)[..., 0]
    sigma = np.broadcast_to(np.asarray(found.u, dtype=np.float64)[..., 0], coordinates.shape)
    bad = ~np.isfinite(coordinates).all(axis=0) | ~(np.isfinite(sigma) & (sigma > 0)).all(axis=0)
    flags = np.where(bad, int(Flag.INVALID), 0).astype(np.uint16)
    sigma = np.where(bad, 1.0, sigma)
    return Correspondence(coordinates[0], coordinates[1], sigma[0], sigma[1], flags)


def _fringes_run(shot: Shot, verbose: bool = False) -> Any:
    frames, shown = shot.taken()
    return fringes_coder(shown).decode(frames[..., None], bmin=FRINGES_MODULATION, verbose=verbose)


def _cv2(shot: Shot) -> Correspondence:
    """OpenCV's GrayCodePattern, pixel by pixel; it states no sigma: that of a uniform error of one pixel."""
    (white, black, *images), code = _cv2_frames(shot)
    places = np.full((*white.shape, 2), np.nan)
    lit = np.argwhere(white.astype(np.int16) - black > CV2_BLACK)
    places[tuple(lit.T)] = cv2_places(code, images, lit)
    sigma = np.full(white.shape, 1 / math.sqrt(12))
    flags = np.where(np.isfinite(places[..., 0]), 0, int(Flag.INVALID)).astype(np.uint16)
    return Correspondence(places[..., 0], places[..., 1], sigma, sigma, flags)


def _cv2_run(shot: Shot) -> Any:
    (white, black, *images), code = _cv2_frames(shot)
    return cv2_decode(code, images, white, black)


def _cv2_frames(shot: Shot) -> tuple[Any, Any]:
    frames, shown = shot.taken()
    if shown != axis_by_axis(sequence("gray", shown.rows, shown.cols)):
        raise InputError("cv2: takes the sequence 'gray' only (one-pixel cells, inverses, white and black)")
    if frames.dtype != np.uint8:
        raise InputError("cv2: takes 8-bit frames only")
    return frames, cv2_coder(shown)


DECODERS = {
    "optolever": Decoder("own", _ours),
    "exact": Decoder("floor", lambda shot: exact(shot.place.truth)),
    "fringes": Decoder("peer", _fringes, "fringes", _fringes_run),
    "cv2": Decoder("peer", _cv2, clock=_cv2_run, divide=2.0),
}


def axis_by_axis(shown: Sequence) -> Sequence:
    """The same frames in the peers' order: u before v, a fringe's shifts ascending. For a static rig and a
    display without lag the order has no effect."""
    periods = list(dict.fromkeys(frame.period_px for frame in shown.frames))

    def place(frame: Frame) -> tuple[str, int, float]:
        return frame.axis or "", periods.index(frame.period_px), frame.shift or 0.0

    return replace(shown, frames=tuple(sorted(shown.frames, key=place)))


def fringes_coder(shown: Sequence) -> Any:
    """A `fringes` coder of our frames. InputError unless all are phase frames, the same on u and v."""
    fringes: Any = importlib.import_module("fringes")
    periods, steps = _ladder(shown, "u")
    if (periods, steps) != _ladder(shown, "v") or any(f.kind != "phase" for f in shown.frames):
        raise InputError("fringes: takes phase frames of the same periods and steps on u and v only")
    coder = fringes.Fringes()
    coder.X, coder.Y = shown.cols, shown.rows
    coder.K = len(periods)
    coder.p0 = 0.0  # the crest of every fringe is at coordinate 0, as in our frames
    coder.N = [[steps] * len(periods)] * 2
    extent = max(shown.rows, shown.cols)
    coder.v = [[extent / period for period in periods]] * 2
    return coder


def _ladder(shown: Sequence, axis: str) -> tuple[list[float], int]:
    """Periods in display order, and the number of steps, 0 unless the shifts are equal."""
    frames = [frame for frame in shown.frames if frame.axis == axis and frame.kind == "phase"]
    periods = list(dict.fromkeys(float(frame.period_px or 0.0) for frame in frames))
    steps = len(frames) // max(len(periods), 1)
    even = [2 * math.pi * k / steps for _ in periods for k in range(steps)] if steps else []
    fits = len(even) == len(frames) and np.allclose([frame.shift or 0.0 for frame in frames], even)
    return periods, steps if fits else 0


def cv2_coder(shown: Sequence) -> Any:
    """OpenCV's Gray code of bits with inverses on a surface of this size."""
    return cv2.structured_light.GrayCodePattern.create(shown.cols, shown.rows)


def cv2_decode(coder: Any, images: Images, white: NDArray[np.uint8], black: NDArray[np.uint8]) -> Any:
    """OpenCV's loop over all pixels. It requires two cameras: it gets the same one twice, at twice the
    time."""
    return coder.decode([images, images], None, [black] * 2, [white] * 2)


def cv2_places(coder: Any, images: Images, pixels: NDArray[np.integer]) -> Floats:
    """u and v (N, 2) of pixels (N, 2: row, column), one by one; NaN where OpenCV rejects the pixel."""
    found = [coder.getProjPixel(images, int(col), int(row)) for row, col in pixels]
    return np.array([(math.nan, math.nan) if wrong else place for wrong, place in found], np.float64)
