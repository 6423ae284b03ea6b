"""Single-shot crossed fringe: displacement of one frame against the rest frame, for what moves.

The frame is the mean of a fringe along u and one along v. Both are fitted at once within a Gaussian window
(crossed_fit.py) over the carriers that the map at rest predicts (the local-carrier form of Takeda, Ina,
Kobayashi 1982, doi:10.1364/JOSA.72.000156). What the fit's phase of the deformed frame has over the rest
frame's is the displacement, unwrapped by least squares (Ghiglia & Romero 1994,
doi:10.1364/JOSAA.11.000107) and made congruent.

The window smooths what it shows: of a frequency that it leaves the share g, the first pass has g. So the
next pass takes the last one's phase into its carrier and adds what is left, 1 - (1 - g)^k after k passes
(van Cittert); what the last of them still changed counts as error.
"""

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft

from optolever.errors import InputError
from optolever.patterns import Sequence

from .correspondence import Correspondence, Flag
from .crossed_fit import Fit, Window
from .guide import PatternMap, guide_map

__all__ = ["crossed"]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]
#: Rms width of the window in periods of the fringe.
_WIDTH = 0.5
#: Half amplitude over its noise below which a pixel is flagged.
_LEAST = 6.0
_PASSES = 4
#: Factor of the passes on the noise: squared 2 (2 H(k) - H(2 k)), H(k) = 1 + 1/2 + ... + 1/k.
_GROWTH = math.sqrt(
    4 * sum(1 / k for k in range(1, _PASSES + 1)) - 2 * sum(1 / k for k in range(1, 2 * _PASSES + 1))
)
#: Largest of the noise within a window's width, over its rms.
_LARGEST = 2.5
#: Change in the last pass, turns, above which a pixel is flagged.
_SETTLED = 0.02
#: Turns over a window's rms width above which a pixel is flagged: a step of one turn looks like 0.4.
_STEEPEST = 0.3
#: Pattern pixels inside its outline that a camera pixel may see mixed with what lies beside it.
_MARGIN = 1.0


def crossed(
    frame: ArrayLike, rest: ArrayLike, sequence: Sequence, *, guide: PatternMap | None = None
) -> Correspondence:
    """Displacement u, v (pattern pixels, deformed minus rest) of one crossed-fringe frame.

    frame, rest  (H, W), or (N, H, W) as the sequence describes them
    guide        where the camera looked at rest, to a fraction of a period across the fringe's own width
                 (a trace, a decoded capture); default: the surface fills the frame

    Whole periods follow from continuity, the median displacement being within half a period: what is cut off
    from the largest connected part is flagged. sigma holds noise, smoothing and the frame's edge. Flagged
    are pixels where the fringe is lost (LOW_CONTRAST), where the displacement is too steep to tell a slope
    from a step by a period, does not settle, or has no connection (ORDER_DOUBTFUL), and what was moved off
    the pattern (OFF_PATTERN).
    """
    number, period = _crossed_frame(sequence)
    now, still = (
        _image(stack, number, len(sequence), name) for stack, name in ((frame, "frame"), (rest, "rest"))
    )
    if now.shape != still.shape:
        raise InputError(f"crossed: frame is {now.shape}, rest is {still.shape}, must be equal")
    at_rest = guide_map(guide, sequence, still.shape, "crossed")
    shot = _Shot(now, still, at_rest, (sequence.rows, sequence.cols), period)
    axes = _followed(shot)
    flags = _flags(shot, axes)
    (u, sigma_u), (v, sigma_v) = (
        (period * axis.turn, period * np.hypot(axis.random, axis.change)) for axis in axes
    )
    offset = np.asarray(cv2.GaussianBlur(now, (0, 0), 8.0), np.float64)
    amplitude = 2.0 * np.minimum(axes[0].height, axes[1].height)
    return Correspondence(u, v, sigma_u, sigma_v, flags, amplitude, offset)


class _Shot:
    """Both frames (H, W), where they looked at rest on a pattern of a shape; window and noise, from these."""

    def __init__(
        self, now: F32, still: F32, at_rest: tuple[F64, F64], pattern: tuple[int, int], period: float
    ) -> None:
        self.now, self.still, self.at_rest, self.pattern, self.period = now, still, at_rest, pattern, period
        self.width = _WIDTH * period / max(min(_steepness(coord) for coord in at_rest), 1e-3)
        # of white noise the window leaves sigma / (2 sqrt(pi) width), 1 / sqrt(2) of it in each quadrature
        self.noise = _noise(now) / (2 * np.sqrt(np.pi) * self.width) / np.sqrt(2)

    def inside(self, turns: list[F64] | None, margin: float) -> Mask:
        """Pixels that look further than margin (pattern pixels) inside the pattern; None: at rest."""
        rows, cols = self.pattern
        low, high = margin - 0.5, -margin - 0.5
        moved = turns or [np.zeros(self.now.shape)] * 2
        u, v = (c + self.period * t for c, t in zip(self.at_rest, moved, strict=True))
        return np.asarray((u > low) & (u < cols + high) & (v > low) & (v < rows + high))


@dataclass(frozen=True, slots=True)
class _Axis:
    """Along one axis, (H, W): displacement, its noise, what the last pass changed (turns); half amplitude."""

    turn: F64
    random: F64
    change: F64
    height: F64


def _flags(shot: _Shot, axes: list[_Axis]) -> NDArray[np.uint16]:
    """What cannot be told, and what hangs together with nothing."""
    known = np.isfinite(shot.at_rest[0]) & np.isfinite(shot.at_rest[1])
    beside = known & ~shot.inside([axis.turn for axis in axes], 0.0)
    flags = np.where(known, 0, int(Flag.INVALID)) | np.where(beside, int(Flag.OFF_PATTERN), 0)
    for axis in axes:
        lost = axis.height <= _LEAST * shot.noise
        doubtful = (_steep(axis.turn, shot.width) | (axis.change > _SETTLED)) & ~lost
        flags |= np.where(lost, int(Flag.LOW_CONTRAST), 0) | np.where(doubtful, int(Flag.ORDER_DOUBTFUL), 0)
    flags |= np.where(_connected(flags == 0), 0, int(Flag.ORDER_DOUBTFUL))
    return flags.astype(np.uint16)


def _followed(shot: _Shot) -> list[_Axis]:
    """Displacement along u and v."""
    usable = shot.inside(None, _MARGIN)
    window = Window.over(usable, shot.width)
    carrier = [2 * np.pi / shot.period * np.where(usable, coord, 0.0) for coord in shot.at_rest]
    before, after = (window.fit(image, *_wrapped(carrier), cut=False) for image in (shot.still, shot.now))
    rested, pressed = _added(carrier, before), []
    for k in (0, 1):
        clear = _height(before, after, k) > _LEAST * shot.noise
        turn = _unwrapped(after.phase[k] - before.phase[k], clear)
        pressed.append(rested[k] + 2 * np.pi * window.extended(turn))
    changes = []
    for _ in range(_PASSES - 1):
        lit = usable & shot.inside(_turns(rested, pressed), _MARGIN)
        before = window.fit(shot.still, *_wrapped(rested))
        after = Window.over(lit, shot.width).fit(shot.now, *_wrapped(pressed))
        rested, pressed = _added(rested, before), _added(pressed, after)
        changes.append([_around(after.phase[k] - before.phase[k], shot.width) for k in (0, 1)])
    turns = _turns(rested, pressed)
    return [_axis(before, after, k, turns[k], changes, shot.noise) for k in (0, 1)]


def _axis(before: Fit, after: Fit, k: int, turn: F64, changes: list[list[F64]], noise: float) -> _Axis:
    height = _height(before, after, k)
    # what one pass leaves of the noise; pass i changes 1 / sqrt(i (2 i - 1)) of it
    random = noise * np.hypot(before.growth[k], after.growth[k]) / np.maximum(height, 1e-9) / (2 * np.pi)
    last, change = (
        np.sqrt(np.maximum(changes[i - 2][k] ** 2 - (_LARGEST * random) ** 2 / (i * (2 * i - 1)), 0))
        for i in (_PASSES, _PASSES - 1)
    )
    # what further passes would change, at least what the last one did: a geometric series
    ratio = np.minimum(last / np.maximum(change, 1e-9), 0.9)
    return _Axis(turn, _GROWTH * random, last * np.maximum(1.0, ratio / (1.0 - ratio)), height)


def _added(phases: list[F64], fit: Fit) -> list[F64]:
    return [phase + more for phase, more in zip(phases, fit.phase, strict=True)]


def _turns(rested: list[F64], pressed: list[F64]) -> list[F64]:
    return [(after - before) / (2 * np.pi) for before, after in zip(rested, pressed, strict=True)]


def _wrapped(phases: list[F64]) -> tuple[F32, F32]:
    """Within half a turn of 0, where float32 is good to 1e-7."""
    u, v = (_wrap(phase).astype(np.float32) for phase in phases)
    return u, v


def _height(before: Fit, after: Fit, k: int) -> F64:
    return np.asarray(np.minimum(before.height[k], after.height[k]), np.float64)


def _around(change: F32, width: float) -> F64:
    """The largest change within a window's width, turns, smoothed: solvers weigh by sigma."""
    size = 2 * math.ceil(width) + 1
    largest = cv2.dilate(np.abs(change) / np.float32(2 * np.pi), np.ones((size, size), np.uint8))
    return np.asarray(cv2.GaussianBlur(largest, (0, 0), width), np.float64)


def _connected(good: Mask) -> Mask:
    """The largest connected part."""
    count, labels = cv2.connectedComponents(good.astype(np.uint8), connectivity=4)
    if count < 2:
        return good
    return np.asarray(labels == 1 + np.argmax(np.bincount(labels.ravel())[1:]))


def _crossed_frame(sequence: Sequence) -> tuple[int, float]:
    for i, frame in enumerate(sequence.frames):
        if frame.kind == "crossed":
            return i, frame.period_px or 1.0
    raise InputError(f"crossed: sequence {sequence.name} has no frame of kind 'crossed'")


def _image(stack: ArrayLike, number: int, count: int, name: str) -> F32:
    array = np.asarray(stack)
    if array.ndim == 3 and len(array) == count:
        array = array[number]
    if array.ndim != 2 or min(array.shape) < 16:
        raise InputError(f"crossed: {name} has shape {array.shape}, must be (H, W), at least 16 x 16")
    if not np.isfinite(array).all():
        raise InputError(f"crossed: {name} holds values that are not finite")
    return array.astype(np.float32)


def _steepness(coord: F64) -> float:
    """Median gradient of the map, pattern pixels per camera pixel."""
    slope = np.hypot(*np.gradient(coord))
    return float(np.median(slope[np.isfinite(slope)])) if np.isfinite(slope).any() else 1.0


def _noise(image: F32) -> float:
    """Immerkaer's estimate; its mask is blind to fringes along either axis (doi:10.1006/cviu.1996.0060)."""
    across = image[:, :-2] - 2 * image[:, 1:-1] + image[:, 2:]
    second = (across[:-2] - 2 * across[1:-1] + across[2:]) / 6
    return max(1.4826 * float(np.median(np.abs(second))), 12**-0.5)


def _unwrapped(phase: F32, usable: Mask) -> F64:
    """A phase (radians) unwrapped, in turns, its median within half a turn of 0."""
    wrapped = np.where(usable, _wrap(phase), 0.0)
    down, along = (_wrap(np.diff(wrapped, axis=axis)) for axis in (0, 1))
    source = np.zeros(wrapped.shape)
    source[:-1] += down
    source[1:] -= down
    source[:, :-1] += along
    source[:, 1:] -= along
    rows, cols = (2 * np.cos(np.pi * np.arange(size) / size) - 2 for size in wrapped.shape)
    spectrum = np.asarray(fft.dctn(source, norm="ortho"))
    scale = rows[:, None] + cols[None, :]
    scale[0, 0] = 1.0
    spectrum[0, 0] = 0.0
    smooth = np.asarray(fft.idctn(spectrum / scale, norm="ortho"))
    smooth += np.angle(np.mean(np.exp(1j * (wrapped - smooth))[usable])) if usable.any() else 0.0
    turns = (smooth + _wrap(wrapped - smooth)) / (2 * np.pi)
    turns -= np.rint(np.median(turns[usable])) if usable.any() else 0.0
    return np.asarray(turns)


def _steep(turns: F64, width: float) -> Mask:
    """True where a window does not tell a slope from a step by a whole turn, nor its neighbours."""
    slope = np.hypot(*np.gradient(turns)).astype(np.float32)
    size = 2 * math.ceil(width / 2) + 1
    return np.asarray(cv2.dilate(slope, np.ones((size, size), np.uint8)) * width > _STEEPEST)


def _wrap(angle: Any) -> F64:
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)
