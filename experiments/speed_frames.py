"""Frames on which the decoder's speed is measured: every code that `optolever lab codes` compares, and more,
as a display of cells with a blur shows them and a camera's pixels see them; the map is smooth.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from optolever.blocks import on_cores
from optolever.patterns import Frame, Sequence, sequence_from_text
from optolever.projector import Footprints, light_of

__all__ = ["SPEED_CODES", "SpeedCode", "smooth_map", "speed_frames", "speed_sequence"]

Stack = NDArray[np.uint8]
F64 = NDArray[np.float64]
OFFSET, AMPLITUDE = 120.0, 100.0  # levels
BLUR = 0.5  # cells, rms, between display and camera
_PLACES = 128  # per cell, at which a pixel may look
#: Free levels: frames of an axis, cells of the display that share a grey value.
_FREE_FRAMES, _FREE_CELL = 12, 2.0


@dataclass(frozen=True, slots=True)
class SpeedCode:
    """text: of the sequence, or "levels": random grey values; limit: times the floor that decoding may take;
    noise: grey levels; extent: surface, cells along either axis at most (0: as many as the camera has
    pixels)."""

    text: str
    limit: float = 5.0
    noise: float = 1.0
    extent: int = 0

    @property
    def name(self) -> str:
        """Of its row in the table."""
        name = "free levels" if self.text == "levels" else self.text
        return name + (f" on {self.extent} cells" if self.extent else "") + f", noise {self.noise:g}"


SPEED_CODES = (
    SpeedCode("gray"),
    SpeedCode("gray:inverses=false"),
    SpeedCode("long-run-gray"),
    SpeedCode("phase:steps=4"),
    SpeedCode("phase:steps=8"),
    SpeedCode("phase:steps=3,periods=8.73782/8.05745/8", 8.0),
    SpeedCode("phase:steps=4,periods=20/22/25", 8.0, extent=1100),
    SpeedCode("phase:counts=1/40"),
    SpeedCode("phase"),
    SpeedCode("phase:steps=3,periods=576/64/7", extent=576),
    SpeedCode("micro-phase", 15.0),
    SpeedCode("micro-phase", 25.0, noise=2.0),
    SpeedCode("gray+phase"),
    SpeedCode("stripe:step=16", 10.0),
    SpeedCode("stripe:step=8", 10.0),
    SpeedCode("levels", 40.0),
)


def speed_sequence(code: SpeedCode, size: tuple[int, int]) -> Sequence:
    """On a surface of `size` (rows, cols), or as much of it as the code tells apart."""
    rows, cols = (min(extent, code.extent or extent) for extent in size)
    if code.text != "levels":
        return sequence_from_text(code.text, rows, cols)
    rng = np.random.default_rng(0)
    frames = []
    for axis, extent in (("u", cols), ("v", rows)):
        for levels in rng.integers(0, 256, (_FREE_FRAMES, int(np.ceil(extent / _FREE_CELL)))).tolist():
            frames.append(Frame("levels", axis, levels=tuple(levels), cell_px=_FREE_CELL))
    return Sequence(tuple(frames), rows, cols)


def smooth_map(size: tuple[int, int], surface: tuple[int, int]) -> tuple[F64, F64]:
    """u and v of every pixel: within the surface, with a gradient that changes."""
    row, col = np.mgrid[: size[0], : size[1]].astype(np.float64)
    x, y = col / size[1], row / size[0]
    u = surface[1] * (0.03 + 0.93 * x + 0.005 * np.sin(9 * y))
    return u, surface[0] * (0.03 + 0.93 * y + 0.005 * np.cos(9 * x))


def speed_frames(shown: Sequence, size: tuple[int, int], noise: float) -> Stack:
    """Images (N, *size) of a surface with smooth_map, white noise of `noise` levels."""
    maps = [np.rint(place * _PLACES).astype(np.intp) for place in smooth_map(size, (shown.rows, shown.cols))]
    lines = [_line(shown, axis, 0.93 / pixels) for axis, pixels in enumerate(size[::-1])]
    stack = np.empty((len(shown), *size), np.uint8)

    def fill(i: int) -> None:
        frame = shown.frames[i]
        axis = int(frame.axis == "v")
        (light,) = light_of(lines[axis], replace(shown, frames=(frame,)), None, BLUR)
        level = np.float32(OFFSET - AMPLITUDE) + np.float32(2 * AMPLITUDE) * light[maps[axis]]
        level += np.float32(noise) * np.random.default_rng(i).standard_normal(size, dtype=np.float32)
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
