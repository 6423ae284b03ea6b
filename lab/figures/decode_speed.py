"""The decoder's speed beside what memory allows and beside OpenCV's, on the same frames in one run.

The floor is a kernel of the same shape that reads every frame and writes as many bytes as decode, into
memory that the process has already.
Frames for OpenCV are those of an ideal surface and camera: a smooth map, noise, rounding.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any
from unittest import mock

import cv2
import numpy as np
from numpy.typing import NDArray

from optolever.arrays import Floats
from optolever.blocks import blas_on_one, on_cores, over_rows
from optolever.decode import Decoder, decode, estimate_profile
from optolever.kernels import kernel
from optolever.patterns import Frame, Sequence, sequence
from optolever.projector import Footprints, light_of
from optolever.samples.metrics import rms
from optolever.timing import timed

from .figures import Figure
from .ideal import camera_frames

SMALL, LARGE = (480, 640), (1080, 1920)
SPEED_CODES = ("gray+phase", "phase", "gray")
MOST = {SMALL: 8.0, LARGE: 5.5}  # floors with a profile
TURNS = 12  # of calls that are compared, after one that warms up
#: Frames for OpenCV, levels.
OFFSET, AMPLITUDE, NOISE = 110.0, 95.0, 1.5
#: Frames of every code, levels.
DARK, BRIGHT = 20.0, 220.0
BLUR = 0.5  # cells, rms, between display and camera
_PLACES = 128  # per cell, at which a pixel may look


def smooth_map(size: tuple[int, int]) -> tuple[Floats, Floats]:
    """u and v of every pixel, on a surface of as many cells: within it, with a gradient that changes."""
    row, col = np.mgrid[: size[0], : size[1]].astype(np.float64)
    x, y = col / size[1], row / size[0]
    u = size[1] * (0.03 + 0.93 * x + 0.005 * np.sin(9 * y))
    return u, size[0] * (0.03 + 0.93 * y + 0.005 * np.cos(9 * x))


def speed_frames(shown: Sequence, size: tuple[int, int]) -> NDArray[np.uint8]:
    """Images (N, *size) of a surface with smooth_map, white noise of a level."""
    maps = [np.rint(place * _PLACES).astype(np.intp) for place in smooth_map(size)]
    lines = [_line(shown, axis, 0.93 / pixels) for axis, pixels in enumerate(size[::-1])]
    stack = np.empty((len(shown), *size), np.uint8)

    def fill(i: int) -> None:
        frame = shown.frames[i]
        axis = int(frame.axis == "v")
        (light,) = light_of(lines[axis], replace(shown, frames=(frame,)), None, BLUR)
        level = np.float32(DARK) + np.float32(BRIGHT - DARK) * light[maps[axis]]
        level += np.random.default_rng(i).standard_normal(size, dtype=np.float32)
        stack[i] = np.clip(np.rint(level), 0, 255)

    on_cores(fill, range(len(shown)))
    return stack


def _line(shown: Sequence, axis: int, width: float) -> Footprints:
    """Pixels of a width (share of the surface) at every place along u (axis 0) or v, amid the other."""
    extent = (shown.cols, shown.rows)[axis]
    place = np.arange(extent * _PLACES) / _PLACES
    box, none = np.tile([width * extent, 0.0], (place.size, 1)), np.zeros((place.size, 2))
    across = np.full(place.size, 0.5 * (shown.cols, shown.rows)[1 - axis])
    at, boxes = (place, across), (box, none)
    return Footprints(at[axis], at[1 - axis], np.ones(place.size), boxes[axis], boxes[1 - axis])


def decode_figures() -> Iterator[Figure]:
    """Codes of small frames and one of large ones, and OpenCV on the small."""
    for text in SPEED_CODES:
        yield from _of_code(text, SMALL)
    yield from _of_code("gray+phase", LARGE)
    yield from _cv2(SMALL)


def _shoot(shown: Sequence, size: tuple[int, int]) -> tuple[NDArray[Any], tuple[Floats, Floats]]:
    """Frames of an ideal surface with a smooth map, and that."""
    truth = smooth_map(size)
    return camera_frames(shown, truth, (OFFSET, AMPLITUDE), NOISE, np.random.default_rng(0)), truth


def _of_code(text: str, size: tuple[int, int]) -> Iterator[Figure]:
    """By a profile of the rig from another capture, and without one: processor time, minima in one run with
    the floor's."""
    shown = sequence(text, *size)
    frames = speed_frames(shown, size)
    decoder = Decoder(shown, estimate_profile(frames, shown))
    calls = {"with a profile": partial(decoder.decode, frames), "without": partial(decode, frames, shown)}
    floor, bare, *times = _minima(toucher(frames), partial(_untested, decoder, frames), *calls.values())
    name = f"{text}, {size[1]} x {size[0]}"
    for (what, seconds), limit in zip(zip(calls, times, strict=True), (MOST[size], None), strict=True):
        note = f"{1e3 * seconds:.1f} ms, {len(shown)} frames"
        yield Figure(f"{name}, {what}", seconds / floor, "floors", high=limit, note=note)
    note = f"{1e3 * (times[0] - bare):.1f} ms, with a profile"
    yield Figure(f"{name}, tests over the rest", times[0] / bare - 1, high=0.2, note=note)


def _untested(decoder: Decoder, frames: NDArray[np.uint8]) -> None:
    """Decode without the tests of a capture."""
    none = mock.Mock(wrong=np.zeros(frames.shape[1:], np.bool_), notices=(), tests=())
    with mock.patch("optolever.decode.pipeline.judged", return_value=none):
        decoder.decode(frames)


def _minima(*calls: Callable[[], Any]) -> list[float]:
    """Least processor seconds of each on one thread, in turn: others may share the machine."""
    with blas_on_one():  # a second thread of BLAS mostly waits, and its waiting counts
        turns = [[timed(call).processor for call in calls] for _ in range(1 + TURNS)]
    return [min(turn[k] for turn in turns[1:]) for k in range(len(calls))]


@kernel
def _touch(start: int, stop: int, frames: Any, maps: Any, flags: Any) -> None:
    """Read every frame, write outputs of the same size."""
    cols = frames.shape[2]
    total = np.empty(cols, np.float32)
    for row in range(start, stop):
        total[:] = 0
        for i in range(frames.shape[0]):
            for x in range(cols):
                total[x] += np.float32(frames[i, row, x])
        for chart in maps:
            for x in range(cols):
                chart[row, x] = total[x]
        for x in range(cols):
            flags[row, x] = np.uint16(total[x])


def toucher(frames: NDArray[Any]) -> Callable[[], None]:
    """The floor of a decoder's time: read all frames; write u, v, two sigmas, amplitude, offset, order error
    in float32, and flags. The outputs are reused: clearing new memory takes longer than writing to it.
    """
    size = frames.shape[1:]
    maps = tuple(np.empty(size, np.float32) for _ in range(7))
    flags = np.empty(size, np.uint16)

    def touch() -> None:
        over_rows(lambda start, stop: _touch(start, stop, frames, maps, flags), size[0], 32)

    return touch


def _error(
    name: str, u: NDArray[Any], v: NDArray[Any], truth: tuple[Floats, Floats], good: NDArray[Any]
) -> Figure:
    distance = np.stack([u - truth[0], v - truth[1]])[:, good]
    note = f"{100 * good.mean():.3g} % of the pixels"
    return Figure(f"{name}, rms error", rms(distance), "px", note=note)


def _cv2(size: tuple[int, int]) -> Iterator[Figure]:
    """Gray bits of both axes, each with its inverse, u before v as OpenCV has them: it requires two cameras,
    gets the same one twice, and takes twice the time."""
    rows, cols = size
    shown = sequence("gray", rows, cols, references=False)
    shown = replace(shown, frames=tuple(sorted(shown.frames, key=lambda frame: frame.axis or "")))
    frames, truth = _shoot(shown, size)
    name = f"{len(shown)} Gray frames"
    found = decode(frames, shown)
    yield _error(f"{name}, optolever", found.u, found.v, truth, found.good)
    (white, black), _ = _shoot(Sequence((Frame("white"), Frame("black")), rows, cols), size)
    code: Any = cv2.structured_light.GrayCodePattern.create(cols, rows)
    images, decoder = list(frames), Decoder(shown, estimate_profile(frames, shown))
    ours, known, theirs = _minima(
        partial(decode, frames, shown), partial(decoder.decode, frames),
        partial(code.decode, [images, images], None, [black] * 2, [white] * 2),
    )  # fmt: skip
    yield Figure(f"{name}, cv2", 500 * theirs, "ms", note="whole u, v; half of its time for two cameras")
    for what, seconds, low in (("with a profile", known, 10), ("without", ours, 2)):
        note = f"{1e3 * seconds:.1f} ms"
        yield Figure(f"{name}, cv2 over optolever {what}", 0.5 * theirs / seconds, "times", low, note=note)
    chosen = np.random.default_rng(0).integers(0, size, (2000, 2))
    places = [code.getProjPixel(images, int(col), int(row)) for row, col in chosen]
    u, v = np.array([(np.nan, np.nan) if wrong else place for wrong, place in places], np.float64).T
    there = truth[0][tuple(chosen.T)], truth[1][tuple(chosen.T)]
    yield _error(f"{name}, cv2 (2000 pixels)", u, v, there, np.isfinite(u))
