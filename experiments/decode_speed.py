"""The decoder's speed beside what memory allows and beside other decoders, on the same frames in one run; its
errors: see decode_errors.

The floor is a kernel of the same shape that reads every frame and writes as many bytes as decode, into
memory that the process has already.
Frames for others are those of an ideal surface and camera: a smooth map, noise, rounding.
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.blocks import over_rows
from optolever.decode import decode
from optolever.kernels import kernel
from optolever.patterns import Frame, Sequence, sequence
from optolever.processes import safe_path
from optolever.records import Progress, silent

from .decode_errors import decode_errors
from .figures import Figure, measured_parts
from .ideal import camera_frames
from .metrics import rms
from .peers import cv2_coder, cv2_decode, cv2_places, fringes_coder
from .speed_frames import SPEED_CODES, smooth_map, speed_frames, speed_sequence
from .timing import timed

__all__ = ["run_decode_figures"]

Stack = NDArray[np.uint8]
F64 = NDArray[np.float64]
Measure = Callable[[tuple[int, int]], Iterator[Figure]]
SIZE = (1080, 1920)
#: Turns of two that are compared, fewer where they take longer together than so many seconds.
PAIRS, FEWEST, SECONDS = 10, 3, 10.0
OFFSET, AMPLITUDE, NOISE = 110.0, 95.0, 1.5  # levels
PERIODS, STEPS = (2160.0, 48.0), 4
PARTS = ("codes", "fringes", "gray", "first calls", "errors")
_START = """
import sys, time
import numpy as np
from optolever.decode import decode
from optolever.errors import InputError
from optolever.patterns import sequence_from_text
frames = np.load(sys.argv[1])
shown = sequence_from_text(sys.argv[2], *frames.shape[1:])
start = time.perf_counter()
decode(frames, shown)
print(time.perf_counter() - start)
"""


def run_decode_figures(
    *, size: tuple[int, int] = SIZE, parts: tuple[str, ...] = PARTS, progress: Progress = silent
) -> list[Figure]:
    """Everything on frames of `size` (rows, cols), the surface's size too; peers that are missing say so.

    parts: of PARTS; "fringes" and "first calls" compile for long.
    "errors" are those of images of their own sizes.
    """
    measures: tuple[Measure, ...] = (_codes, _fringes, _gray, _starts, decode_errors)
    every = dict(zip(PARTS, measures, strict=True))
    return measured_parts({name: partial(every[name], size) for name in parts}, progress)


def _shoot(shown: Sequence, size: tuple[int, int]) -> tuple[NDArray[Any], tuple[F64, F64]]:
    """Frames of an ideal surface with a smooth map, and that."""
    truth = smooth_map(size, size)
    return camera_frames(shown, truth, (OFFSET, AMPLITUDE), NOISE, np.random.default_rng(0)), truth


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
    """The floor: read all frames; write u, v, two sigmas, amplitude, offset, order error in float32, flags,
    as decode. Into the same memory every time: clearing what is new takes longer than writing it.
    """
    size = frames.shape[1:]
    maps = tuple(np.empty(size, np.float32) for _ in range(7))
    flags = np.empty(size, np.uint16)

    def touch() -> None:
        over_rows(lambda start, stop: _touch(start, stop, frames, maps, flags), size[0], 32)

    return touch


def _codes(size: tuple[int, int]) -> Iterator[Figure]:
    """Every code with decode's default options, beside the floor of its own frames."""
    for code in SPEED_CODES:
        shown = speed_sequence(code, size)
        frames = speed_frames(shown, size, code.noise)
        found = decode(frames, shown)
        floor, ours, ratio = _pairs(toucher(frames), lambda: decode(frames, shown))  # noqa: B023
        note = (
            f"{1e9 * ours / frames.size:.2f} ns per frame and pixel; {len(shown)} frames: floor "
            f"{1e3 * floor:.1f} ms, decode {1e3 * ours:.1f} ms; good {100 * found.good.mean():.4g} %"
        )
        yield Figure(f"{code.name}, decode over floor", ratio, "times", high=code.limit, note=note)


def _pairs(one: Callable[[], Any], other: Callable[[], Any]) -> tuple[float, float, float]:
    """Seconds of each and other over one, medians over pairs of calls in turn: others may share the machine;
    the first pair warms up."""
    one(), other()
    # no value is kept, so that its memory serves the next call
    pairs = [(timed(one).seconds, timed(other).seconds)]
    count = int(np.clip(SECONDS / pairs[0][1], FEWEST, PAIRS))
    pairs += [(timed(one).seconds, timed(other).seconds) for _ in range(count - 1)]
    first, second = np.array(pairs).T
    return float(np.median(first)), float(np.median(second)), float(np.median(second / first))


def _error(name: str, u: NDArray[Any], v: NDArray[Any], truth: tuple[F64, F64], good: NDArray[Any]) -> Figure:
    distance = np.stack([u - truth[0], v - truth[1]])[:, good]
    note = f"{100 * good.mean():.3g} % of the pixels"
    return Figure(f"{name}, rms error", rms(distance), "px", note=note)


def _phase_frames(size: tuple[int, int]) -> tuple[str, Sequence, tuple[F64, F64], Stack]:
    """Two periods of four steps, both axes: name, sequence, truth, frames."""
    shown = sequence("phase", *size, periods=PERIODS, steps=STEPS)
    frames, truth = _shoot(shown, size)
    return f"{len(shown)} phase frames", shown, truth, frames


def _fringes(size: tuple[int, int]) -> Iterator[Figure]:
    """Beside decode, which gives u, v, their sigmas, flags, amplitude, offset and order error in one go; of
    ideal cosines, which is all that `fringes` knows.
    """
    name, shown, truth, frames = _phase_frames(size)
    found = decode(frames, shown, on_cells=False)
    yield _error(f"{name}, optolever", found.u, found.v, truth, found.good)
    if find_spec("fringes") is None:
        yield Figure(f"{name}, fringes", float("nan"), note="not installed")
        return
    coder, stack = fringes_coder(shown), frames[..., None]
    for label, verbose, more in (
        ("fringes", False, "no sigma, no flags"),
        ("fringes verbose", True, "uncertainty (of rounding only), residual, no flags"),
    ):
        _, theirs, ratio = _pairs(
            partial(decode, frames, shown, on_cells=False),
            partial(coder.decode, stack, verbose=verbose),
        )
        yield Figure(f"{name}, {label}", 1e3 * theirs, "ms", note=f"u, v, amplitudes, offsets; {more}")
        yield Figure(f"{name}, {label} over optolever", ratio, low=30)
    x = np.asarray(coder.decode(stack).x, np.float64)[..., 0]
    yield _error(f"{name}, fringes", x[0], x[1], truth, np.asarray(np.isfinite(x).all(axis=0)))


def _gray(size: tuple[int, int]) -> Iterator[Figure]:
    """Gray bits of both axes, each with its inverse."""
    rows, cols = size
    shown = sequence("gray", rows, cols, references=False)
    frames, truth = _shoot(shown, size)
    name = f"{len(shown)} Gray frames"
    found = decode(frames, shown)
    yield _error(f"{name}, optolever", found.u, found.v, truth, found.good)
    (white, black), _ = _shoot(Sequence((Frame("white"), Frame("black")), rows, cols), size)
    code, images = cv2_coder(shown), list(frames)
    ours, theirs, ratio = _pairs(
        lambda: decode(frames, shown), lambda: cv2_decode(code, images, white, black)
    )
    yield Figure(f"{name}, optolever", 1e3 * ours, "ms")
    yield Figure(f"{name}, cv2", 500 * theirs, "ms", note="whole u, v; half of its time for two cameras")
    yield Figure(f"{name}, cv2 over optolever", 0.5 * ratio, low=60)
    chosen = np.random.default_rng(0).integers(0, size, (2000, 2))
    u, v = cv2_places(code, images, chosen).T
    there = truth[0][tuple(chosen.T)], truth[1][tuple(chosen.T)]
    yield _error(f"{name}, cv2 (2000 pixels)", u, v, there, np.isfinite(u))


def _starts(size: tuple[int, int]) -> Iterator[Figure]:
    """The first call in a fresh process, its kernels compiled or cached."""
    for text in ("phase", "gray", "gray+phase"):
        shown = sequence(text, *size)
        frames, _ = _shoot(shown, size)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "frames.npy"
            np.save(path, frames)
            cold, warm = (_first_call(path, text, Path(folder) / "cache") for _ in range(2))
        yield Figure(f"first decode of {text}, nothing compiled", cold, "s", high=20)
        yield Figure(f"first decode of {text}, kernels cached", warm, "s", high=1)


def _first_call(path: Path, text: str, cache: Path) -> float:
    """Seconds of the first decode in a process whose compiled kernels are in `cache`."""
    with safe_path():
        run = subprocess.run(
            [sys.executable, "-c", _START, str(path), text],
            env=os.environ | {"NUMBA_CACHE_DIR": str(cache)},
            capture_output=True,
            text=True,
            check=True,
        )
    return float(run.stdout)
